"""The physics scene of a trial: a hand whose palm frame is the world frame, and one free object."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..hands import HandDescription, load_spec
from ..objects import DENSITY_KG_M3, GraspObject
from .outcomes import TOUCH_COLUMNS
from .pairs import declare, digit_of_geoms, digit_pairs, reachable
from .protocol import Protocol

OBJECT = "object"
_OVERLAP_SENSOR = "overlap"
_FOUND, _DISTANCE = 1 << 0, 1 << 3  # data fields of MuJoCo's contact sensor
_NEAREST = 1  # its reduction to the contact of smallest distance


@dataclass(frozen=True)
class Scene:
    """Hold a compiled scene and where to find things in its state.

    Attributes:
        model: the compiled MuJoCo model.
        joints: ``(J',)`` places of the scene's joints among the hand's J, all of them unless digits are left out.
        joint_qpos: ``(J',)`` addresses of these joints in qpos.
        object_qpos: address of the object's seven numbers (position, wxyz) in qpos.
        control_map: ``(J, n_actuators)``; posture times this gives the actuators' targets (a tendon takes its joints'
            sum).
        touch_sensors: for each of `TOUCH_COLUMNS` the addresses of its contact counters in sensordata.
        overlap_sensor: address of the count and the smallest signed distance of hand-object contacts.
    """

    model: Any
    joints: NDArray[np.int64]
    joint_qpos: NDArray[np.int64]
    object_qpos: int
    control_map: NDArray[np.float64]
    touch_sensors: tuple[tuple[int, ...], ...]
    overlap_sensor: int


def build_scene(
    hand: HandDescription,
    obj: GraspObject,
    protocol: Protocol,
    *,
    reduced: bool = True,
    without: Collection[str] = (),
) -> Scene:
    """Compile the trial scene of one object.

    Args:
        hand: the hand to test with.
        obj: the object to hold.
        protocol: friction, gains, time step.
        reduced: remove the wrist joints, which trials hold at zero, and keep only the collision pairs that matter
            (object with hand; thumb with fingers and neighbouring fingers where they can reach each other). False keeps
            all joints and pairs.
        without: digits to leave out.
    """
    spec = load_spec(hand)
    _set_physics(spec, protocol)
    if reduced:
        _remove_wrist(spec, hand)
    _remove_digits(spec, hand, without)
    _palm_to_world(spec, hand)
    _add_object(spec, obj, protocol)
    slide, turn, roll = protocol.friction, protocol.torsional_friction_m, 0.0001
    contact = {
        "condim": 4,
        "solref": [protocol.contact_time_constant_s, 1.0],
        "solimp": [0.9, 0.95, 0.001, 0.5, 2.0],
    }
    for geom in spec.geoms:
        geom.friction = [slide, turn, roll]
        for name, value in contact.items():
            setattr(geom, name, value)
    if reduced:
        _limit_collisions(spec, hand, without, contact | {"friction": [slide, slide, turn, roll, roll]})
    _add_sensors(spec, hand)
    return _locate(spec.compile(), hand)


def _set_physics(spec: Any, protocol: Protocol) -> None:
    option = spec.option
    option.timestep = protocol.time_step_s
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = protocol.impratio
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.gravity = [0.0, 0.0, 0.0]
    # A diverged state must stay visible instead of being reset to a healthy one.
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for joint in spec.joints:
        joint.frictionloss = 0.0
    for actuator in spec.actuators:
        actuator.gainprm[0] *= protocol.gain_factor
        actuator.biasprm[1] *= protocol.gain_factor


def _remove_wrist(spec: Any, hand: HandDescription) -> None:
    wrist = {hand.prefix + name for name in hand.wrist_joints}
    for actuator in [a for a in spec.actuators if a.target in wrist]:
        spec.delete(actuator)
    for joint in [j for j in spec.joints if j.name in wrist]:
        spec.delete(joint)


def _remove_digits(spec: Any, hand: HandDescription, digits: Collection[str]) -> None:
    roots = [spec.body(hand.prefix + hand.digit_roots[digit]) for digit in digits]
    bodies = {body.name for root in roots for body in [root, *root.find_all(mujoco.mjtObj.mjOBJ_BODY)]}
    joints = {joint.name for joint in spec.joints if joint.parent.name in bodies}
    tendons = [t for t in spec.tendons if joints & {t.path[i].target.name for i in range(len(t.path))}]
    driven = joints | {tendon.name for tendon in tendons}
    for element in [a for a in spec.actuators if a.target in driven] + tendons:
        spec.delete(element)
    for root in roots:
        spec.delete(root)


def _palm_to_world(spec: Any, hand: HandDescription) -> None:
    """Move the hand's base so that the palm frame at zero is the world frame."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    palm = model.body(hand.prefix + hand.hand_body).id
    base = int(model.body_rootid[palm])
    inverse_quat, inverse_pos = np.zeros(4), np.zeros(3)
    mujoco.mju_negPose(inverse_pos, inverse_quat, data.xpos[palm], data.xquat[palm])
    position, quat = np.zeros(3), np.zeros(4)
    mujoco.mju_mulPose(position, quat, inverse_pos, inverse_quat, data.xpos[base], data.xquat[base])
    body = spec.body(model.body(base).name)
    body.pos, body.quat = position, quat


def object_geom(obj: GraspObject) -> tuple[Any, list[float]]:
    """Give the type and the three sizes, metres, of the engine's geom of an object."""
    x, y, z = (extent / 2 for extent in obj.extents_m)
    shapes: dict[str, tuple[Any, list[float]]] = {
        "box": (mujoco.mjtGeom.mjGEOM_BOX, [x, y, z]),
        "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, [x, z, 0.0]),
        "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, [x, 0.0, 0.0]),
    }
    return shapes[obj.shape]


def _add_object(spec: Any, obj: GraspObject, protocol: Protocol) -> None:
    body = spec.worldbody.add_body(name=OBJECT)
    body.add_freejoint(name=OBJECT)
    kind, size = object_geom(obj)
    density = DENSITY_KG_M3 * protocol.density_factor
    body.add_geom(name=OBJECT, type=kind, size=size, density=density, rgba=[0.85, 0.45, 0.2, 1.0])


def _limit_collisions(spec: Any, hand: HandDescription, without: Collection[str], contact: Mapping[str, Any]) -> None:
    """Test only the object with the hand, and digits that can reach each other."""
    solid = _solid_geoms(spec)
    obj = solid.pop(OBJECT)
    touching = _touching_digits(hand, tuple(without))
    declare(spec, [(obj, geom) for geom in solid.values()] + [(solid[a], solid[b]) for a, b in touching], contact)


def _solid_geoms(spec: Any) -> dict[str, Any]:
    """Find the geoms that can touch something, and name those that have no name."""
    solid = [geom for geom in spec.geoms if geom.contype or geom.conaffinity]
    for number, geom in enumerate(solid):
        geom.name = geom.name or f"solid_{number}"
    return {geom.name: geom for geom in solid}


@lru_cache(maxsize=32)
def _touching_digits(hand: HandDescription, without: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Name the pairs of the hand's own geoms that can touch; the object has no say in it."""
    spec = load_spec(hand)
    _remove_wrist(spec, hand)
    _remove_digits(spec, hand, without)
    names = _solid_geoms(spec).keys()
    model = spec.compile()
    digit = digit_of_geoms(model, hand)
    digits = {geom: int(digit[geom]) for geom in (int(model.geom(name).id) for name in names) if digit[geom] >= 0}
    pairs = reachable(model, digit_pairs(digits, list(hand.digit_roots).index("thumb")))
    return tuple((model.geom(a).name, model.geom(b).name) for a, b in pairs)


def _add_sensors(spec: Any, hand: HandDescription) -> None:
    def add(name: str, kind: Any, body: str, fields: int, reduction: int = 0) -> None:
        spec.add_sensor(
            name=name,
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=kind,
            objname=body,
            reftype=mujoco.mjtObj.mjOBJ_GEOM,
            refname=OBJECT,
            intprm=[fields, reduction, 1],
        )

    whole_body, this_body = mujoco.mjtObj.mjOBJ_XBODY, mujoco.mjtObj.mjOBJ_BODY
    for digit, root in hand.digit_roots.items():
        if spec.body(hand.prefix + root) is not None:
            add(f"touch_{digit}", whole_body, hand.prefix + root, _FOUND)
    for body in hand.palm_bodies:
        add(f"touch_palm_{body}", this_body, hand.prefix + body, _FOUND)
    root = spec.body(hand.prefix + hand.hand_body)
    while root.parent is not None and root.parent.name != "world":
        root = root.parent
    add(_OVERLAP_SENSOR, whole_body, root.name, _FOUND | _DISTANCE, _NEAREST)


def _locate(model: Any, hand: HandDescription) -> Scene:
    present = {model.joint(i).name: i for i in range(model.njnt)}
    column = {
        present[hand.prefix + name]: place
        for place, name in enumerate(hand.joint_names)
        if hand.prefix + name in present
    }
    control_map = np.zeros((len(hand.joint_names), model.nu))
    for actuator in range(model.nu):
        target = model.actuator_trnid[actuator, 0]
        if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT:
            if target in column:
                control_map[column[target], actuator] = model.actuator_gear[actuator, 0]
            continue
        first = model.tendon_adr[target]
        for wrap in range(first, first + model.tendon_num[target]):
            control_map[column[model.wrap_objid[wrap]], actuator] = model.wrap_prm[wrap]
    sensor = {model.sensor(i).name: int(model.sensor_adr[i]) for i in range(model.nsensor)}
    touch = tuple(
        tuple(adr for name, adr in sensor.items() if name == f"touch_{column}" or name.startswith(f"touch_{column}_"))
        for column in TOUCH_COLUMNS
    )
    return Scene(
        model=model,
        joints=np.array(list(column.values()), dtype=np.int64),
        joint_qpos=model.jnt_qposadr[list(column)].astype(np.int64),
        object_qpos=int(model.joint(OBJECT).qposadr[0]),
        control_map=control_map,
        touch_sensors=touch,
        overlap_sensor=sensor[_OVERLAP_SENSOR],
    )
