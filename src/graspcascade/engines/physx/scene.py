"""`Scene`: a hand and one object in PhysX, converted from the compiled MuJoCo world that holds the same two."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from math import pi, sqrt
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...core.errors import InputError
from ...core.poses import quat_conjugate, quat_multiply, rotate
from ...core.protocols import Physics
from ...hands import Hand
from ...worlds.pairs import digit_of_geoms
from ...worlds.world import OBJECT, World

Array = NDArray[np.float64]
CYLINDER_SIDES = 64
"""Sides of the prism that stands for a cylinder, which PhysX lacks: they lie up to 0.12 % of its radius too deep."""
_POSITION_ITERATIONS = 32
"""Of PhysX's solver in a step: with 16 a held object turns by degrees in the grip, 64 take twice as long."""
_CONTACT_OFFSET_M = 0.001
"""Contacts are prepared up to twice this distance ahead, farther than a closing finger comes in a step."""
_HULL_POINTS = 120
"""Most vertices of a convex hull: PhysX takes 255 faces, of which a hull of so many triangles has 236."""
_COOKED = 100.0
"""Hulls are handed over this much larger and scaled back: PhysX merges vertices that it takes to be too near."""
_IDENTITY = (1.0, 0.0, 0.0, 0.0)
_X_TO_Z = (sqrt(0.5), 0.0, -sqrt(0.5), 0.0)
"""Turns x, the axis of capsules and hinges in PhysX, into z, that of capsules in MuJoCo."""


def load_sapien() -> Any:
    """Import the package that brings PhysX; an InputError says how to install it."""
    try:
        with warnings.catch_warnings():
            # It warns where there is no display driver, which nothing here needs.
            warnings.simplefilter("ignore")
            import sapien
    except ImportError as error:
        how = "install the extra 'physx', in a checkout: pip install '.[physx]'"
        raise InputError(f"engine physx needs sapien: {how} ({error})") from error
    return sapien


class Scene:
    """Hold the hand and the object of one trial, and step them.

    Every trial has a scene of its own, so that none can see what another left behind.

    Args:
        world: the world to convert, but for its object.
        hand: the hand of that world.
        physics: time step and torsional friction.
        object_fields: the object (see `worlds.world.object_fields`).
        friction: coefficient of every contact.
        gain_factor: position gains as a multiple of the world's.
        gravity: acceleration that `step` finds ready when it is given the same, m/s2; others take longer.

    Raises:
        InputError: the hand has parts without counterpart in PhysX, or PhysX is not installed.
    """

    def __init__(
        self,
        world: World,
        hand: Hand,
        physics: Physics,
        object_fields: Mapping[str, NDArray[Any]],
        *,
        friction: float,
        gain_factor: float = 1.0,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        self._sapien = load_sapien()
        self._physx = self._sapien.physx
        self._model, self._gravity = world.model, np.array(gravity, dtype=np.float64)
        _check_counterparts(world.model)
        self._physx.set_scene_config(gravity=self._gravity, enable_tgs=True, enable_enhanced_determinism=True)
        self._physx.set_shape_config(contact_offset=_CONTACT_OFFSET_M, rest_offset=0.0)
        self._physx.set_body_config(_POSITION_ITERATIONS, 1, sleep_threshold=0.0)
        self._system = self._physx.PhysxCpuSystem()
        self._system.timestep = physics.time_step_s
        self._scene = self._sapien.Scene([self._system])
        # PhysX takes the mean friction of two shapes, MuJoCo the greater: with one material they are the same.
        self._material = self._physx.PhysxMaterial(friction, friction, 0.0)
        # MuJoCo's torque at slip is the force times a length, PhysX's also times the friction.
        self._patch_radius = physics.torsional_friction_m / friction if friction > 0.0 else 0.0

        self._add_hand(hand)
        self._object = self._physx.PhysxRigidDynamicComponent()
        self._add_object(object_fields)
        self._articulation = next(iter(self.links.values())).articulation
        self._drive(world, hand, gain_factor)
        self._forced = [(body, float(body.mass)) for body in (*self.links.values(), self._object)]
        self._falling = True

    # -- conversion

    def _add_hand(self, hand: Hand) -> None:
        model, digit = self._model, digit_of_geoms(self._model, hand)
        self._groups = _collision_groups(model, digit)
        self._hand, self._touchable = hand, {}
        palm = {hand.prefix + name for name in hand.palm_bodies}
        self.links: dict[str, Any] = {}
        entities = []
        for body in range(1, model.nbody):  # parents come before their children
            name, parent = model.body(body).name, model.body(model.body_parentid[body]).name
            if name == OBJECT:
                continue
            link = self.links[name] = self._physx.PhysxArticulationLinkComponent(self.links.get(parent))
            self._fill(link, model.body_mass[body], model.body_inertia[body])
            link.cmass_local_pose = self._pose(model.body_ipos[body], model.body_iquat[body])
            for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
                if geom in self._groups:
                    place = model.geom_pos[geom], model.geom_quat[geom]
                    self._attach(link, model.geom_type[geom], model.geom_size[geom], geom, *place)
                    if digit[geom] >= 0 or name in palm:
                        # -1, the last column, is the palm's.
                        self._touchable[link] = int(digit[geom]), name.removeprefix(hand.prefix)
            entity = self._sapien.Entity()
            entity.add_component(link)
            entities.append(entity)
            X_parent_body = self._pose(model.body_pos[body], model.body_quat[body])
            link.joint.type = "fixed"
            if parent not in self.links:
                entity.pose = X_parent_body
            elif model.body_jntnum[body]:
                self._hinge(link.joint, body)
            else:
                link.joint.pose_in_parent = X_parent_body
        for entity in entities:
            self._scene.add_entity(entity)

    def _hinge(self, joint: Any, body: int) -> None:
        model, number = self._model, int(self._model.body_jntadr[body])
        along = np.zeros(4)
        mujoco.mju_quatZ2Vec(along, model.jnt_axis[number])
        turn = quat_multiply(along, _X_TO_Z)
        joint.type, joint.name = "revolute", model.joint(number).name
        joint.pose_in_child = self._pose(np.zeros(3), turn)
        joint.pose_in_parent = self._pose(model.body_pos[body], quat_multiply(model.body_quat[body], turn))
        joint.limit = model.jnt_range[number].astype(np.float32).reshape(1, 2)
        joint.friction = 0.0
        joint.set_drive_properties(0.0, 0.0)

    def _drive(self, world: World, hand: Hand, gain_factor: float) -> None:
        """Read the actuators, in the order of joints that PhysX has: breadth first."""
        model, step = self._model, self._system.timestep
        joints, names = self._articulation.active_joints, [hand.prefix + name for name in hand.joint_names]
        self._to_physx = np.array([names.index(joint.name) for joint in joints])
        self._from_physx = self._to_physx.argsort()
        numbers = [model.joint(joint.name).id for joint in joints]
        dofs = model.jnt_dofadr[numbers]
        # How much an actuator's length grows with an angle is also how much torque its force gives.
        self._moment = moment = world.control_map.T[:, self._to_physx]
        self._damping, self._speed_gain = model.dof_damping[dofs], -model.actuator_biasprm[:, 2]
        # A step's damping depends on the speed at its end, as in MuJoCo's implicit integration: the same as torques
        # by the speed at its start on joints of this much more inertia.
        late = self._damping + np.abs(moment).T @ (self._speed_gain * np.abs(moment).sum(axis=1))
        inertia = model.dof_armature[dofs] + step * late
        self._ties = [_Tie(model, number, numbers, step) for number in range(model.neq)]
        for tie in self._ties:
            inertia[[tie.follower, tie.leader]] += tie.inertia
        for joint, armature in zip(joints, inertia, strict=True):
            joint.armature = np.array([armature], dtype=np.float32)
        self._gain = model.actuator_gainprm[:, 0] * gain_factor
        limited = np.asarray(model.actuator_forcelimited, dtype=bool)
        self._least, self._most = np.where(limited, model.actuator_forcerange.T, [[-np.inf], [np.inf]])

    def _add_object(self, fields: Mapping[str, NDArray[Any]]) -> None:
        self._fill(self._object, fields["body_mass"][0], fields["body_inertia"][0])
        self._attach(self._object, fields["geom_type"][0], fields["geom_size"][0], self._model.geom(OBJECT).id)
        self._entity = self._sapien.Entity()
        self._entity.add_component(self._object)
        self._scene.add_entity(self._entity)

    def _fill(self, body: Any, mass: float, inertia: Array) -> None:
        body.mass, body.inertia = float(mass), inertia.astype(np.float32)
        body.linear_damping = body.angular_damping = 0.0

    def _attach(
        self,
        body: Any,
        kind: int,
        size: Array,
        geom: int,
        position: ArrayLike = (0.0, 0.0, 0.0),
        quat: ArrayLike = _IDENTITY,
    ) -> None:
        physx, kinds, material = self._physx, mujoco.mjtGeom, self._material
        match kind:
            case kinds.mjGEOM_BOX:
                shape = physx.PhysxCollisionShapeBox(size.astype(np.float32), material)
            case kinds.mjGEOM_SPHERE:
                shape = physx.PhysxCollisionShapeSphere(size[0], material)
            case kinds.mjGEOM_CAPSULE:
                shape = physx.PhysxCollisionShapeCapsule(size[0], size[1], material)
                quat = quat_multiply(quat, _X_TO_Z)
            case _:
                points = _COOKED * _hull_points(self._model, kind, size, geom)
                shape = physx.PhysxCollisionShapeConvexMesh(points.astype(np.float32), [1 / _COOKED] * 3, material)
        shape.local_pose = self._pose(position, quat)
        shape.set_collision_groups([*self._groups[geom], 0, 0])
        shape.set_min_patch_radius(self._patch_radius)
        shape.set_patch_radius(0.0)
        body.attach(shape)

    def _pose(self, position: ArrayLike, quat: ArrayLike) -> Any:
        return self._sapien.Pose(np.asarray(position, dtype=np.float32), np.asarray(quat, dtype=np.float32))

    # -- state

    def place(self, angles: Array, position: ArrayLike, quat: ArrayLike) -> None:
        """Put the hand's joints, in the order of the hand, and the object somewhere, at rest."""
        self._articulation.set_qpos(angles[self._to_physx].astype(np.float32))
        self._articulation.set_qvel(np.zeros(len(angles), dtype=np.float32))
        self._entity.pose = self._pose(position, quat)

    @property
    def angles(self) -> Array:
        """Joint angles ``(J,)`` in the order of the hand, radians."""
        return np.asarray(self._articulation.qpos[self._from_physx], dtype=np.float64)

    @property
    def object_pose(self) -> Array:
        """Position and unit quaternion wxyz ``(7,)`` of the object."""
        pose = self._entity.pose
        quat = np.asarray(pose.q, dtype=np.float64)
        return np.concatenate([pose.p, quat / np.linalg.norm(quat)])

    def touching(self) -> tuple[NDArray[np.bool_], NDArray[np.uint16]]:
        """Tell which digits, and last the palm, pressed on the object in the last step ``(D + 1,)``.

        With them come the areas of each digit that did (see `Hand.area_masks`), ``(D,)``.
        """
        touching = np.zeros(len(self._hand.digits) + 1, dtype=bool)
        bodies, normals = [], []
        for contact in self._system.get_contacts():
            pressed = [point.normal for point in contact.points if np.any(point.impulse)]
            if self._object not in contact.bodies or not pressed:
                continue
            # Normals point from the second body to the first.
            for link, outward in zip(contact.bodies, (-1.0, 1.0), strict=True):
                column, name = self._touchable.get(link, (-1, None))
                touching[column] |= name is not None
                if column >= 0:
                    bodies += [name] * len(pressed)
                    normals += list(outward * rotate(quat_conjugate(link.entity_pose.q), pressed))
        return touching, self._hand.area_masks(bodies, normals)

    def step(self, target: Array, acceleration: Array) -> None:
        """Make one time step with targets of the actuators ``(n_actuators,)`` in a field of acceleration, m/s2."""
        falling = bool((acceleration == self._gravity).all())
        if falling != self._falling:
            for body, _ in self._forced:
                body.disable_gravity = not falling
            self._falling = falling
        if not falling and acceleration.any():
            for body, mass in self._forced:
                body.add_force_torque((mass * acceleration).astype(np.float32), _NOTHING)
        articulation, moment = self._articulation, self._moment
        angles, speeds = articulation.qpos, articulation.qvel
        force = self._gain * (target - moment @ angles) - self._speed_gain * (moment @ speeds)
        force = np.minimum(np.maximum(force, self._least), self._most)
        torque = force @ moment - self._damping * speeds
        for tie in self._ties:
            tie.add(torque, angles, speeds)
        articulation.set_qf(torque.astype(np.float32))
        self._system.step()


class _Tie:
    """A spring and damper that let a joint follow a polynomial of another's angle, as soft as MuJoCo's equality."""

    def __init__(self, model: Any, number: int, joints: list[int], time_step_s: float) -> None:
        pair = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])]
        self.follower, self.leader = (joints.index(joint) for joint in pair)
        self._follows = np.polynomial.Polynomial(model.eq_data[number, :5])
        self._slope, self._time_step_s = self._follows.deriv(), time_step_s
        # What MuJoCo's soft constraint comes to: d / (1 - d) of the inertia that it takes the pair to have, times the
        # stiffness and damping of its reference acceleration (its documentation, "Solver parameters").
        (time_s, damping_ratio), most = model.eq_solref[number], float(model.eq_solimp[number, 1])
        inertia = most / (1.0 - most) / float(model.dof_invweight0[model.jnt_dofadr[pair]].sum())
        self._stiffness = inertia / (most * time_s * damping_ratio) ** 2
        self._damping = 2.0 * inertia / (most * time_s)
        late = time_step_s * (self._damping + time_step_s * self._stiffness)
        self.inertia = late * np.array([1.0, float(self._slope(0.0)) ** 2])

    def add(self, torque: Array, angles: Array, speeds: Array) -> None:
        """Add its torques at these angles and speeds."""
        slope = self._slope(angles[self.leader])
        apart = angles[self.follower] - self._follows(angles[self.leader])
        parting = speeds[self.follower] - slope * speeds[self.leader]
        pull = self._stiffness * (apart + self._time_step_s * parting) + self._damping * parting
        torque[self.follower] -= pull
        torque[self.leader] += slope * pull


_NOTHING = np.zeros(3, dtype=np.float32)


def _check_counterparts(model: Any) -> None:
    parts = {
        "equalities with a stiffness of their own": np.any(model.eq_solref[:, 0] <= 0.0),
        "springs or torque limits of joints": np.any(model.jnt_stiffness) or np.any(model.jnt_actfrclimited),
        "springs or dampers of tendons": np.any(model.tendon_stiffness) or np.any(model.tendon_damping),
        "gravity compensation": np.any(model.body_gravcomp),
    }
    if lacking := [name for name, there in parts.items() if there]:
        raise InputError(f"engine physx has no counterpart to {', '.join(lacking)}; try this hand with engine mujoco")


def _collision_groups(model: Any, digit: NDArray[np.int64]) -> dict[int, tuple[int, int]]:
    """Find what each geom that can touch something is, and what it touches, as bit masks.

    Bit 0 is the object, bit 1 the hand without digits, the next ones are the digits.
    """
    bit = digit + 2
    bit[model.geom(OBJECT).id] = 0
    touches = np.zeros(len(bit) + 2, dtype=np.int64)
    pairs = np.stack([model.pair_geom1, model.pair_geom2], axis=1)
    for one, other in [*pairs, *pairs[:, ::-1]]:
        touches[bit[one]] |= 1 << bit[other]
    return {int(geom): (int(1 << bit[geom]), int(touches[bit[geom]])) for geom in np.unique(pairs)}


def _hull_points(model: Any, kind: int, size: Array, geom: int) -> Array:
    """Compute vertices ``(n, 3)``, metres, of the convex shape that stands for a cylinder, an ellipsoid or a mesh."""
    kinds = mujoco.mjtGeom
    if kind == kinds.mjGEOM_CYLINDER:
        angle = np.linspace(0.0, 2 * pi, CYLINDER_SIDES, endpoint=False)
        ring = size[0] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return np.concatenate([np.insert(ring, 2, z, axis=1) for z in (-size[1], size[1])])
    # Directions spread evenly over the sphere, along a spiral.
    height = np.linspace(-1.0, 1.0, _HULL_POINTS)
    turn, across = np.arange(_HULL_POINTS) * pi * (3.0 - sqrt(5.0)), np.sqrt(1.0 - height**2)
    directions = np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)
    if kind == kinds.mjGEOM_ELLIPSOID:
        return np.asarray(size * directions)
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        vertices = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])]
        # Of many vertices those farthest in some direction.
        few = np.unique((vertices @ directions.T).argmax(axis=0)) if len(vertices) > _HULL_POINTS else slice(None)
        return np.asarray(vertices[few], dtype=np.float64)
    raise InputError(f"engine physx has no shape for geom {model.geom(geom).name} of type {kinds(kind).name}")
