"""`HandModel`: joint names and limits, and where pads and tips are for a batch of postures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..poses import Pose
from ..taxonomy import GRASP_TYPES, GraspType
from .description import SHADOW_HAND, ContactPlace, HandDescription, Vector
from .kinematics import Kinematics, Link

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlacePoints:
    """Hold contact places of n postures in the hand frame.

    Attributes:
        point_m: ``(n, 3)`` metres.
        normal: ``(n, 3)`` outward unit normals.
    """

    point_m: Array
    normal: Array


@dataclass(frozen=True)
class Closure:
    """Hold between what n executed postures close.

    Attributes:
        thumb_m: ``(n, 3)`` the thumb's opposing place, metres in the hand frame.
        other_m: ``(n, 3)`` the place it opposes.
        grasp_size_m: ``(n,)`` thumb tip to index tip, metres.
    """

    thumb_m: Array
    other_m: Array
    grasp_size_m: Array


@dataclass(frozen=True)
class HandModel:
    """Answer geometric questions about a hand; all postures are ``(n, J)`` radians in the order of `joint_names`.

    Attributes:
        description: names of the hand's parts.
        kinematics: the tree of links below the palm.
        lower_rad: ``(J,)`` lower joint limits.
        upper_rad: ``(J,)`` upper joint limits.
        X_forearm_hand: fixed pose of the hand frame in the forearm base, wrist at zero.
    """

    description: HandDescription
    kinematics: Kinematics
    lower_rad: Array
    upper_rad: Array
    X_forearm_hand: Pose

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Name the posture's columns."""
        return self.description.joint_names

    @cached_property
    def pregrasp(self) -> Array:
        """Give the open hand ``(J,)`` before closing."""
        return np.array(self.description.pregrasp)

    @cached_property
    def _coupled_columns(self) -> list[tuple[int, int]]:
        place = self.joint_names.index
        return [(place(one), place(other)) for one, other in self.description.coupled.values()]

    def clip(self, posture: ArrayLike) -> Array:
        """Bring angles inside the joint limits."""
        return np.clip(np.asarray(posture, dtype=np.float64), self.lower_rad, self.upper_rad)

    def executed(self, posture: ArrayLike) -> Array:
        """Give the free-space angles that a commanded posture leads to.

        One tendon drives a finger's two outer joints, so only their sum is commanded and, touching nothing, they
        share it equally; all others reach their targets within limits.
        """
        return self.share(self.clip(posture))

    def share(self, posture: ArrayLike) -> Array:
        """Share the sum of each tendon's two joints equally between them, whatever the limits."""
        posture = np.array(posture, dtype=np.float64)
        for one, other in self._coupled_columns:
            shared = (posture[..., one] + posture[..., other]) / 2
            posture[..., one] = shared
            posture[..., other] = shared
        return posture

    def frames(self, posture: ArrayLike, bodies: list[str] | None = None) -> dict[str, tuple[Array, Array]]:
        """Compute body frames in the hand frame: ``(n, 3, 3)`` rotations and ``(n, 3)`` origins by body name."""
        return self.kinematics.frames(self._angles(posture), bodies)

    def _angles(self, posture: ArrayLike) -> dict[str, Array]:
        """Give the angles ``(n,)`` by joint name, or refuse a posture of another width."""
        posture = np.atleast_2d(np.asarray(posture, dtype=np.float64))
        if posture.shape[1] != len(self.joint_names):
            raise InputError(f"a posture of this hand has {len(self.joint_names)} joints, got {posture.shape[1]}")
        return dict(zip(self.joint_names, posture.T, strict=True))

    def places(self, posture: ArrayLike, names: list[str]) -> dict[str, PlacePoints]:
        """Locate contact places by name, without the tendon's sharing (see `executed`).

        Raises:
            InputError: the hand's description lacks a place.
        """
        wanted = {name: self._place(name) for name in names}
        frames = self.frames(posture, [place.body for place in wanted.values()])
        found = {}
        for name, place in wanted.items():
            rotation, origin = frames[place.body]
            found[name] = PlacePoints(origin + rotation @ np.array(place.point_m), rotation @ np.array(place.normal))
        return found

    def _place(self, name: str) -> ContactPlace:
        """Look up a contact place, or say which grasp types need it."""
        found = self.description.places.get(name)
        if found is None:
            asking = [kind.name for kind in GRASP_TYPES.values() if name in (*kind.opposition, *kind.support)]
            needed = f", needed by {', '.join(asking)}" if asking else ""
            raise InputError(
                f"hand {self.description.name} has no contact place {name!r}{needed}; "
                f"it has: {', '.join(self.description.places) or 'none'}"
            )
        return found

    def tips(self, posture: ArrayLike, digits: list[str]) -> dict[str, Array]:
        """Locate fingertip centres ``(n, 3)`` by digit, metres in the hand frame."""
        wanted = {digit: self.description.tips[digit] for digit in digits}
        frames = self.frames(posture, [body for body, _ in wanted.values()])
        return {digit: frames[body][1] + frames[body][0] @ np.array(point) for digit, (body, point) in wanted.items()}

    def tip_distance(self, posture: ArrayLike) -> Array:
        """Measure thumb tip to index tip ``(n,)`` in metres at these very angles."""
        tips = self.tips(posture, ["thumb", "index"])
        return np.asarray(np.linalg.norm(tips["thumb"] - tips["index"], axis=-1))

    def grasp_size(self, posture: ArrayLike) -> Array:
        """Measure thumb tip to index tip ``(n,)`` of the posture executed without an object (paper, section V)."""
        return self.tip_distance(self.executed(posture))

    def opposition(self, posture: ArrayLike, kind: GraspType) -> tuple[Array, Array]:
        """Locate the opposition pair of a type in the executed posture.

        Returns:
            The two contact points ``(n, 3)``, thumb first, metres in the hand frame.

        Raises:
            InputError: the hand's description lacks one of the two places.
        """
        thumb, other = kind.opposition
        found = self.places(self.executed(posture), [thumb, other])
        return found[thumb].point_m, found[other].point_m

    def closure(self, executed: ArrayLike, kinds: Sequence[GraspType], kind_of_row: NDArray[np.intp]) -> Closure:
        """Locate opposition pairs and measure grasp sizes, as `opposition` and `grasp_size` do, in one pass.

        Args:
            executed: ``(n, J)`` postures as `executed` gives them.
            kinds: the distinct types.
            kind_of_row: ``(n,)`` place in `kinds` of each row's type.

        Raises:
            InputError: the hand's description lacks a place of an opposition pair.
        """
        spots = {digit: self.description.tips[digit] for digit in ("thumb", "index")}
        for name in sorted({name for kind in kinds for name in kind.opposition}):
            place = self._place(name)
            spots[name] = (place.body, place.point_m)
        found = self.kinematics.points(self._angles(executed), spots)
        thumb, other = np.zeros((2, len(kind_of_row), 3))
        for number, kind in enumerate(kinds):
            rows = np.True_ if len(kinds) == 1 else (kind_of_row == number)[:, None]
            for points, name in zip((thumb, other), kind.opposition, strict=True):
                np.copyto(points, found[name], where=rows)
        return Closure(thumb, other, np.linalg.norm(found["thumb"] - found["index"], axis=-1))


def load_spec(description: HandDescription) -> Any:
    """Read a hand's MJCF as an editable MuJoCo spec.

    Raises:
        InputError: the file cannot be read or lacks a part the description names.
    """
    # The engine is heavy to load and geometry from stored constants does not need it.
    import mujoco

    try:
        spec = mujoco.MjSpec.from_file(str(description.mjcf))
    except (ValueError, OSError) as error:
        raise InputError(f"cannot read hand model {description.mjcf}: {_one_line(error)}") from error
    joints = {joint.name for joint in spec.joints}
    bodies = {body.name for body in spec.bodies}
    needed_joints = {*description.joint_names, *description.wrist_joints}
    needed_bodies = {description.hand_body, *description.digit_roots.values(), *description.palm_bodies}
    needed_bodies |= {place.body for place in description.places.values()}
    needed_bodies |= {body for body, _ in description.tips.values()}
    missing = sorted(n for n in needed_joints if description.prefix + n not in joints)
    missing += sorted(n for n in needed_bodies if description.prefix + n not in bodies)
    if missing:
        raise InputError(
            f"hand model {Path(description.mjcf).name} lacks {', '.join(missing)} (prefix {description.prefix!r})"
        )
    return spec


def load_hand(description: HandDescription) -> HandModel:
    """Build a hand model from its MJCF.

    Raises:
        InputError: the file is unreadable or does not fit the description.
    """
    import mujoco

    spec = load_spec(description)
    try:
        model = spec.compile()
    except ValueError as error:
        raise InputError(f"cannot compile hand model {description.mjcf}: {_one_line(error)}") from error
    prefix = description.prefix
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    hand = model.body(prefix + description.hand_body).id
    links = []
    for body in range(hand, model.nbody):
        if body != hand and model.body_rootid[body] != model.body_rootid[hand]:
            continue
        links.append(_link(model, body, hand, prefix))
    limits = np.array([model.joint(prefix + name).range for name in description.joint_names])
    base = int(model.body_rootid[hand])
    X_world_base = Pose.of(data.xpos[base], data.xquat[base])
    X_world_hand = Pose.of(data.xpos[hand], data.xquat[hand])
    return HandModel(
        description, Kinematics(tuple(links)), limits[:, 0], limits[:, 1], X_world_base.inverse() @ X_world_hand
    )


def _link(model: Any, body: int, hand: int, prefix: str) -> Link:
    import mujoco

    if model.body_jntnum[body] > 1 and body != hand:
        raise InputError(
            f"body {model.body(body).name} has {model.body_jntnum[body]} joints; one hinge at most is supported"
        )
    name = model.body(body).name.removeprefix(prefix)
    if body == hand:
        return Link(name, None, (0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, model.body_quat[body])
    joint, axis = None, np.array([1.0, 0.0, 0.0])
    if model.body_jntnum[body]:
        index = model.body_jntadr[body]
        joint = model.joint(index).name.removeprefix(prefix)
        axis = model.jnt_axis[index]
        if model.jnt_type[index] != mujoco.mjtJoint.mjJNT_HINGE or np.abs(model.jnt_pos[index]).max() > 1e-9:
            raise InputError(f"joint {joint} is not a hinge at the origin of its body, which is all that is supported")
    return Link(
        name,
        model.body(model.body_parentid[body]).name.removeprefix(prefix),
        _vector(model.body_pos[body]),
        tuple(tuple(float(v) for v in row) for row in matrix.reshape(3, 3)),
        joint,
        _vector(axis),
    )


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _vector(values: Array) -> Vector:
    x, y, z = (float(v) for v in values)
    return x, y, z


@lru_cache(maxsize=1)
def shadow_hand() -> HandModel:
    """Load the right Shadow Hand with our primitive shapes (cached)."""
    return load_hand(SHADOW_HAND)
