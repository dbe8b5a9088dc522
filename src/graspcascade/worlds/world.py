"""`World`: a hand whose frame is the world frame, and one free object, as a compiled MuJoCo model."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import lru_cache
from threading import Lock
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.objects import Box, Cylinder, GraspObject, Shape, Sphere
from ..core.outcomes import PALM
from ..core.protocols import Physics
from ..hands import Hand, read_spec
from .pairs import declare, digit_of_geoms, digit_pairs, reachable

OBJECT = "object"
_OVERLAP_SENSOR = "overlap"
_FOUND, _DISTANCE = 1 << 0, 1 << 3  # data fields of MuJoCo's contact sensor
_NEAREST = 1  # its reduction to the contact of smallest distance


@dataclass(frozen=True, eq=False)
class World:
    """Hold a compiled world and where to find things in its state.

    Attributes:
        model: the compiled MuJoCo model.
        joints: ``(J',)`` places of the world's joints among the hand's J, all of them unless digits are left out.
        joint_qpos: ``(J',)`` addresses of these joints in qpos.
        object_qpos: address of the object's seven numbers (position, wxyz) in qpos.
        control_map: ``(J, n_actuators)``; posture times this gives the actuators' targets (a tendon takes its joints'
            weighted sum).
        control_range: ``(n_actuators, 2)`` least and greatest target, infinite where the model sets no range.
        touch_sensors: for each digit and the palm the addresses of its contact counters in sensordata.
        overlap_sensor: address of the count and the smallest signed distance of hand-object contacts.
    """

    model: Any
    joints: NDArray[np.int64]
    joint_qpos: NDArray[np.int64]
    object_qpos: int
    control_map: NDArray[np.float64]
    control_range: NDArray[np.float64]
    touch_sensors: tuple[tuple[int, ...], ...]
    overlap_sensor: int

    def controls(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute the actuators' targets ``(..., n_actuators)``, within their ranges, for angles ``(..., J)``."""
        return np.asarray(np.clip(angles @ self.control_map, *self.control_range.T))


def build_world(
    hand: Hand, obj: GraspObject, physics: Physics, *, reduced: bool = True, without: Collection[str] = ()
) -> World:
    """Compile the world of one hand and one object, without gravity.

    Args:
        hand: the hand.
        obj: the object to hold.
        physics: friction, gains, density, time step.
        reduced: remove the wrist joints, which trials hold at zero, and keep only the collision pairs that matter
            (object with hand; thumb with fingers and neighbouring fingers where they can reach each other). False keeps
            all joints and pairs.
        without: digits to leave out.

    Raises:
        InputError: the hand has no model.
    """
    spec = read_spec(hand)
    _set_physics(spec, physics)
    if reduced:
        _remove_wrist(spec, hand)
    _remove_digits(spec, hand, without)
    hand_to_world(spec, hand)
    _add_object(spec, obj, physics.density_factor, mass_kg=physics.object_mass_kg)
    slide, turn, roll = physics.friction, physics.torsional_friction_m, 0.0001
    contact = {"condim": 4, "solref": [physics.contact_time_constant_s, 1.0], "solimp": [0.9, 0.95, 0.001, 0.5, 2.0]}
    for geom in spec.geoms:
        geom.friction = [slide, turn, roll]
        for name, value in contact.items():
            setattr(geom, name, value)
    if reduced:
        _limit_collisions(spec, hand, without, contact | {"friction": [slide, slide, turn, roll, roll]})
    touch = _add_sensors(spec, hand)
    return _locate(spec.compile(), hand, touch)


_compiling = Lock()


def shared_world(hand: Hand, obj: GraspObject, physics: Physics, reduced: bool, without: tuple[str, ...] = ()) -> World:
    """Build a world, or take the one built before from the same arguments."""
    # Threads start together and need the same worlds: the second waits for what the first compiles.
    with _compiling:
        return _world(hand, obj, physics, reduced, without)


@lru_cache(maxsize=64)
def _world(hand: Hand, obj: GraspObject, physics: Physics, reduced: bool, without: tuple[str, ...]) -> World:
    return build_world(hand, obj, physics, reduced=reduced, without=without)


def _set_physics(spec: Any, physics: Physics) -> None:
    option = spec.option
    option.timestep = physics.time_step_s
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio, option.noslip_iterations = physics.impratio, physics.noslip_iterations
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.gravity = [0.0, 0.0, 0.0]
    # A diverged state must stay visible instead of being reset to a healthy one.
    option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for joint in spec.joints:
        joint.frictionloss = physics.joint_friction_nm or 0.0
    for actuator in spec.actuators:
        if physics.gain_nm_per_rad is not None:
            actuator.gainprm[0], actuator.biasprm[1] = physics.gain_nm_per_rad, -physics.gain_nm_per_rad
        actuator.gainprm[0] *= physics.gain_factor
        actuator.biasprm[1] *= physics.gain_factor
        if physics.force_limit_nm is not None:
            actuator.forcelimited, actuator.forcerange = 1, [-physics.force_limit_nm, physics.force_limit_nm]


def _remove_wrist(spec: Any, hand: Hand) -> None:
    wrist = {hand.prefix + name for name in hand.wrist_joints}
    for actuator in [a for a in spec.actuators if a.target in wrist]:
        spec.delete(actuator)
    for joint in [j for j in spec.joints if j.name in wrist]:
        spec.delete(joint)


def _remove_digits(spec: Any, hand: Hand, digits: Collection[str]) -> None:
    roots = [spec.body(hand.prefix + hand.digits[digit].root) for digit in digits]
    bodies = {body.name for root in roots for body in [root, *root.find_all(mujoco.mjtObj.mjOBJ_BODY)]}
    joints = {joint.name for joint in spec.joints if joint.parent.name in bodies}
    tendons = [t for t in spec.tendons if joints & {t.path[i].target.name for i in range(len(t.path))}]
    driven = joints | {tendon.name for tendon in tendons}
    equalities = [e for e in spec.equalities if {e.name1, e.name2} & joints]
    for element in [a for a in spec.actuators if a.target in driven] + equalities + tendons:
        spec.delete(element)
    for root in roots:
        spec.delete(root)


def hand_to_world(spec: Any, hand: Hand) -> None:
    """Move the hand's base so that the hand frame at zero is the world frame."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    palm = model.body(hand.prefix + hand.body).id
    base = int(model.body_rootid[palm])
    hand_pos, hand_quat = np.zeros(3), np.zeros(4)
    mujoco.mju_mulPose(
        hand_pos, hand_quat, data.xpos[palm], data.xquat[palm], hand.X_body_hand.position_m, hand.X_body_hand.quat_wxyz
    )
    inverse_quat, inverse_pos = np.zeros(4), np.zeros(3)
    mujoco.mju_negPose(inverse_pos, inverse_quat, hand_pos, hand_quat)
    position, quat = np.zeros(3), np.zeros(4)
    mujoco.mju_mulPose(position, quat, inverse_pos, inverse_quat, data.xpos[base], data.xquat[base])
    body = spec.body(model.body(base).name)
    body.pos, body.quat = position, quat
    # An orientation that the model gives in another way, such as Euler angles, would win over the quaternion.
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def object_geom(shape: Shape) -> tuple[Any, list[float]]:
    """Look up the type and the three sizes, metres, of the engine's geom of a shape."""
    x, y, z = (extent / 2 for extent in shape.extents_m)
    kind = mujoco.mjtGeom
    match shape:
        case Box():
            return kind.mjGEOM_BOX, [x, y, z]
        case Cylinder():
            return kind.mjGEOM_CYLINDER, [x, z, 0.0]
        case Sphere():
            return kind.mjGEOM_SPHERE, [x, 0.0, 0.0]
    raise NotImplementedError(f"no geom for a {type(shape).__name__}")


def _add_object(
    spec: Any, obj: GraspObject, density_factor: float, size_error_m: float = 0.0, mass_kg: float | None = None
) -> None:
    body = spec.worldbody.add_body(name=OBJECT)
    body.add_freejoint(name=OBJECT)
    kind, size = object_geom(obj.shape)
    size = [half + size_error_m / 2 if half > 0.0 else half for half in size]
    weight = {"density": obj.density_kg_m3 * density_factor} if mass_kg is None else {"mass": mass_kg * density_factor}
    body.add_geom(name=OBJECT, type=kind, size=size, rgba=[0.85, 0.45, 0.2, 1.0], **weight)


OBJECT_FIELDS: Mapping[str, str] = {
    name: part
    for part, names in {
        "body": ("body_inertia", "body_invweight0", "body_mass", "body_subtreemass"),
        "box": ("bvh_aabb",),
        "freedom": ("dof_M0", "dof_invweight0", "dof_length"),
        "geom": ("geom_aabb", "geom_rbound", "geom_size", "geom_type"),
    }.items()
    for name in names
}
"""Fields of a compiled model in which worlds of different primitives differ, by what of the object has rows in them."""


@lru_cache(maxsize=4096)
def object_fields(
    obj: GraspObject, density_factor: float, size_error_m: float = 0.0, mass_kg: float | None = None
) -> Mapping[str, NDArray[Any]]:
    """Compute the object's rows of `OBJECT_FIELDS`: of its body, of its geom, or of its six degrees of freedom.

    An object that floats alone has the same rows as in a world with a hand, and compiles in a fraction of the time.
    With a mass it weighs that, times the density factor, whatever its size. One that is too small or too light for the
    engine is an InputError.
    """
    spec = mujoco.MjSpec()
    _add_object(spec, obj, density_factor, size_error_m, mass_kg)
    try:
        model = spec.compile()
    except ValueError as error:
        with_these = f"{obj.name} of {obj.density_kg_m3 * density_factor:g} kg/m3, {size_error_m:g} m larger,"
        raise InputError(f"{with_these} cannot be simulated: {' '.join(str(error).split())}") from error
    rows = {"body": slice(1, 2), "box": slice(0, 1), "geom": slice(0, 1), "freedom": slice(0, 6)}
    return {name: np.array(getattr(model, name)[rows[part]]) for name, part in OBJECT_FIELDS.items()}


def object_rows(model: Any) -> dict[str, slice]:
    """Locate the object's rows of `OBJECT_FIELDS` in a world's model.

    With explicit contact pairs the engine keeps no bounding boxes to search by: that slice is empty.
    """
    body, geom, dof = model.body(OBJECT).id, model.geom(OBJECT).id, int(model.joint(OBJECT).dofadr[0])
    rows = {"body": slice(body, body + 1), "geom": slice(geom, geom + 1), "freedom": slice(dof, dof + 6)}
    boxes = int(model.body_bvhadr[body])
    rows["box"] = slice(boxes, boxes + int(model.body_bvhnum[body]))
    return {name: rows[part] for name, part in OBJECT_FIELDS.items()}


def _limit_collisions(spec: Any, hand: Hand, without: Collection[str], contact: Mapping[str, Any]) -> None:
    """Test only the object with the hand, and digits that can reach each other."""
    solid = _solid_geoms(spec)
    obj = solid.pop(OBJECT)
    touching = _touching_digits(hand, tuple(without))
    declare(spec, [(obj, geom) for geom in solid.values()] + [(solid[a], solid[b]) for a, b in touching], contact)


def _solid_geoms(spec: Any) -> dict[str, Any]:
    """List the geoms that can touch something by name, naming those that have none."""
    solid = [geom for geom in spec.geoms if geom.contype or geom.conaffinity]
    for number, geom in enumerate(solid):
        geom.name = geom.name or f"solid_{number}"
    return {geom.name: geom for geom in solid}


@lru_cache(maxsize=32)
def _touching_digits(hand: Hand, without: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Name the pairs of the hand's own geoms that can touch; the object has no say in it."""
    spec = read_spec(hand)
    _remove_wrist(spec, hand)
    _remove_digits(spec, hand, without)
    names = _solid_geoms(spec).keys()
    model = spec.compile()
    digit = digit_of_geoms(model, hand)
    digits = {geom: int(digit[geom]) for geom in (int(model.geom(name).id) for name in names) if digit[geom] >= 0}
    pairs = reachable(model, digit_pairs(digits, list(hand.digits).index("thumb")))
    return tuple((model.geom(a).name, model.geom(b).name) for a, b in pairs)


def _add_sensors(spec: Any, hand: Hand) -> list[list[str]]:
    """Add the sensors of contact; returns the names of those of each digit and of the palm."""

    def add(name: str, kind: Any, body: str, fields: int, reduction: int = 0) -> str:
        spec.add_sensor(
            name=name,
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=kind,
            objname=body,
            reftype=mujoco.mjtObj.mjOBJ_GEOM,
            refname=OBJECT,
            intprm=[fields, reduction, 1],
        )
        return name

    whole_body, this_body = mujoco.mjtObj.mjOBJ_XBODY, mujoco.mjtObj.mjOBJ_BODY
    touch = []
    for name, digit in hand.digits.items():
        first = hand.prefix + digit.root
        touch.append([add(f"touch_{name}", whole_body, first, _FOUND)] if spec.body(first) is not None else [])
    touch.append([add(f"touch_{PALM}_{body}", this_body, hand.prefix + body, _FOUND) for body in hand.palm_bodies])
    root = spec.body(hand.prefix + hand.body)
    while root.parent is not None and root.parent.name != "world":
        root = root.parent
    add(_OVERLAP_SENSOR, whole_body, root.name, _FOUND | _DISTANCE, _NEAREST)
    return touch


def _locate(model: Any, hand: Hand, touch: list[list[str]]) -> World:
    present = {model.joint(i).name: i for i in range(model.njnt)}
    names = [hand.prefix + name for name in hand.joint_names]
    column = {present[name]: place for place, name in enumerate(names) if name in present}
    weights = {hand.prefix + actuator.name: actuator for actuator in hand.actuators}
    control_map = np.zeros((len(hand.joint_names), model.nu))
    control_range = np.tile([-np.inf, np.inf], (model.nu, 1))
    for number in range(model.nu):
        actuator = weights[model.actuator(number).name]
        control_range[number] = actuator.low, actuator.high
        for joint, weight in actuator.weights.items():
            if joint in hand.joint_names:
                control_map[hand.joint_names.index(joint), number] = weight
    return World(
        model=model,
        joints=np.array(list(column.values()), dtype=np.int64),
        joint_qpos=model.jnt_qposadr[list(column)].astype(np.int64),
        object_qpos=int(model.joint(OBJECT).qposadr[0]),
        control_map=control_map,
        control_range=control_range,
        touch_sensors=tuple(tuple(int(model.sensor(name).adr[0]) for name in names) for names in touch),
        overlap_sensor=int(model.sensor(_OVERLAP_SENSOR).adr[0]),
    )
