"""The geometric heuristic (paper, section IV): from a posture to where the object must be in the hand."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.errors import InputError, check_whole
from ..core.grasps import Grasps
from ..core.objects import GraspObject
from ..core.poses import Pose, canonical_quat, quat_multiply
from ..core.tasks import Tasks, draw_tasks
from ..core.taxonomy import GraspType, as_type
from ..hands.hand import Hand
from . import Proposal, as_proposed, check_reach
from .prior import PosturePrior

Array = NDArray[np.float64]

HEURISTIC = "heuristic"
"""Name of the paper's heuristic among models, and stem of its evaluation's file."""


@dataclass(frozen=True)
class Placement:
    """How far objects may be placed from where the paper's heuristic puts them.

    Attributes:
        offset_share: largest offset of the site's centre from the middle between the opposing places, along each body
            axis across the site, as a share of the object's extent along it; up to 0.5.
        tilt_rad: largest angle between the site's axis and the line between the opposing places, radians.

    Raises:
        InputError: a number out of bounds.
    """

    offset_share: float = 0.0
    tilt_rad: float = 0.0

    def __post_init__(self) -> None:
        for name, most in (("offset_share", 0.5), ("tilt_rad", np.pi / 2)):
            if not 0.0 <= (value := getattr(self, name)) <= most:
                raise InputError(f"{name} of a placement must be 0 to {most:.4g}, got {value}")

    def draw(self, axes: Array, extents_m: Array, line: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw offsets in the body frame and tilts in the hand frame.

        Offsets are even along each axis; tilts have an even angle, about an even direction across the line.

        Args:
            axes: ``(n, 3)`` axes of the sites in the body frame.
            extents_m: ``(n, 3)`` extents of the objects along the body axes, metres.
            line: ``(n, 3)`` unit directions from one opposing place to the other in the hand frame.
            rng: source of the draws.

        Returns:
            Offsets ``(n, 3)``, metres, and rotations ``(n, 4)`` as quaternions wxyz.
        """
        offset = _across(rng.uniform(-self.offset_share, self.offset_share, axes.shape) * extents_m, axes)
        angle = rng.uniform(0.0, self.tilt_rad, len(axes))
        return offset, _turn(angle, _unit(_across(rng.normal(size=line.shape), line)))


CENTRED, SPREAD = Placement(), Placement(1 / 3, np.deg2rad(15.0))
"""Where the paper's heuristic places objects, and a third of the other extents and 15 degrees about it."""


@dataclass(frozen=True, eq=False)
class Heuristic(Proposal):
    """Draw postures from the prior and place each object between the opposing contact places.

    Attributes:
        placement: how far from the middle between these places, and how oblique; by default not at all.

    Raises:
        InputError: the prior is of other joints than the hand.
    """

    source = name = HEURISTIC
    screening = "candidates whose opposing places stay farther apart than the side is wide are skipped"
    hand: Hand
    prior: PosturePrior
    placement: Placement = CENTRED

    def __post_init__(self) -> None:
        self.prior.columns_of(self.hand)

    @classmethod
    def pretrained(cls) -> Heuristic:
        """Load the shipped hand and prior."""
        from ..hands.hand_file import load_hand

        return cls(load_hand("shadow"), PosturePrior.pretrained())

    @property
    def grasp_types(self) -> tuple[GraspType, ...]:
        """Grasp types that the hand can make and of which the prior has seen postures."""
        possible = self.hand.possible(self.prior.types.values())
        return tuple(kind for kind in possible if kind.name in self.prior.grasp_types)

    def postures(self, grasp_types: NDArray[np.str_], rng: np.random.Generator) -> Array:
        """Draw one posture ``(n, J)``, radians, for each type name; an InputError if the hand or prior lacks a type."""
        for name in dict.fromkeys(grasp_types.tolist()):
            self.hand.check_type(as_type(name, self.prior.types))
        return self.prior.sample(grasp_types, rng)[:, self.prior.columns_of(self.hand)]

    def propose(self, tasks: Tasks, rng: np.random.Generator) -> Grasps:  # noqa: D102 (inherited)
        self.check_types(task.grasp_type for task in tasks.distinct)
        return place(self.hand, self.postures(tasks.grasp_type, rng), tasks, rng, self.placement)

    def propose_any_side(  # noqa: D102 (inherited)
        self, obj: GraspObject, kind: GraspType, n: int, rng: np.random.Generator
    ) -> Grasps:
        self.check_types([kind])
        # Postures are drawn before sides: the order in which published collections drew them.
        postures = self.postures(np.full(n, kind.name), rng)
        tasks = draw_tasks([(obj, kind)], n, self.hand.reach_m, rng)
        return place(self.hand, postures, tasks, rng, self.placement)

    def hopeless(self, grasps: Grasps) -> NDArray[np.bool_]:
        """Tell which grasps ``(n,)`` cannot touch their object (see `cannot_touch`)."""
        return cannot_touch(self.hand, grasps)

    def describe(self) -> dict[str, Any]:
        """Say for a record which prior postures are drawn from, and how objects are placed if not as in the paper."""
        placed = {} if self.placement == CENTRED else {"placement": asdict(self.placement)}
        return {"prior": self.prior.fingerprint()} | placed

    def origin(self, kind: GraspType, obj: GraspObject) -> dict[str, Any]:  # noqa: D102 (inherited)
        return super().origin(kind, obj) | self.describe()


@dataclass(frozen=True, eq=False)
class Screened(Proposal):
    """Draw from a heuristic, and draw a posture again if its digits would stay too far apart to touch the object.

    Attributes:
        most_draws: postures tried for one grasp. If none of them can touch, the last is returned (see `cannot_touch`).

    Examples:
        >>> Screened.pretrained().sample("tripod", "box:32x41x60mm", "x", n=4)
        <Grasps: 4 tripod of box:32x41x60mm, 22 joints of shadow_hand_right>
    """

    source, name = HEURISTIC, "screened"
    heuristic: Heuristic
    most_draws: int = 200

    def __post_init__(self) -> None:
        check_whole("most_draws", self.most_draws, 1)

    @classmethod
    def pretrained(cls) -> Screened:
        """Screen the heuristic of the shipped hand and prior."""
        return cls(Heuristic.pretrained())

    @property
    def hand(self) -> Hand:  # type: ignore[override]
        """Hand that the grasps are for."""
        return self.heuristic.hand

    @property
    def grasp_types(self) -> tuple[GraspType, ...]:
        """Grasp types of the heuristic."""
        return self.heuristic.grasp_types

    def propose(self, tasks: Tasks, rng: np.random.Generator) -> Grasps:  # noqa: D102 (inherited)
        self.check_types(task.grasp_type for task in tasks.distinct)
        postures = self.heuristic.postures(tasks.grasp_type, rng)
        grasps = place(self.hand, postures, tasks, rng, self.heuristic.placement)
        for _ in range(self.most_draws - 1):
            if not (wide := cannot_touch(self.hand, grasps)).any():
                break
            postures[wide] = self.heuristic.postures(tasks.grasp_type[wide], rng)
            grasps = place(self.hand, postures, tasks, rng, self.heuristic.placement)
        return grasps

    def notes(self, grasps: Grasps) -> tuple[str, ...]:
        """Say how many of its grasps are not screened, if any."""
        wide = int(cannot_touch(self.hand, grasps).sum())
        tried = f"in {self.most_draws} draws none was found whose digits can touch the object"
        return (f"{wide} of {len(grasps)} grasps are not screened: {tried}",) if wide else ()

    def describe(self) -> dict[str, Any]:
        """Say for a record what the heuristic does, and how often a posture is drawn."""
        return self.heuristic.describe() | {"most_draws": self.most_draws}

    def origin(self, kind: GraspType, obj: GraspObject) -> dict[str, Any]:  # noqa: D102 (inherited)
        return super().origin(kind, obj) | self.describe()


def place(
    hand: Hand, postures: ArrayLike, tasks: Tasks, rng: np.random.Generator, placement: Placement = CENTRED
) -> Grasps:
    """Place each object between the opposing contact places of its posture.

    The site's centre goes to the middle of the opposition pair of the executed posture, and its axis along the line
    between the pair. The angle about that line is free and drawn evenly.

    Args:
        hand: the hand.
        postures: ``(n, J)`` radians.
        tasks: n tasks.
        rng: draws the free angles, then what the placement asks for; the same generator state gives the same grasps.
        placement: how far off the middle the site's centre may be, and how far its axis may tilt about the middle.

    Raises:
        InputError: lengths that differ, a side beyond the hand's reach, a site that is none of its object, or a hand
            that lacks a contact place of a type.
    """
    postures = hand.executed(np.atleast_2d(np.asarray(postures, dtype=np.float64)))
    if len(postures) != len(tasks):
        raise InputError(f"got {len(postures)} postures for {len(tasks)} tasks")
    check_reach(hand, tasks)
    for task in tasks.distinct:
        if not task.object.shape.has_site(task.site):
            wide = f"{task.site.name}, {task.site.width_m * 100:g} cm wide, does not end on the surface of"
            raise InputError(f"the site {wide} {task.object.name}; its sides: {task.object.describe_sides()}")
    thumb, other = opposition_points(hand, postures, tasks)
    turn = rng.uniform(0.0, 2 * np.pi, len(tasks))
    axes = tasks.column(lambda task: task.site.axis, np.float64).reshape(len(tasks), 3)
    centres = tasks.column(lambda task: task.site.centre_m, np.float64).reshape(len(tasks), 3)
    line = _unit(other - thumb)
    pose = Pose((thumb + other) / 2, _align(axes, line, turn))
    if placement != CENTRED:
        extents = tasks.column(lambda task: task.object.extents_m, np.float64).reshape(len(tasks), 3)
        offset, tilt = placement.draw(axes, extents, line, rng)
        centres, pose = centres + offset, Pose(pose.position_m, canonical_quat(quat_multiply(tilt, pose.quat_wxyz)))
    if centres.any():
        pose = Pose(pose.apply(-centres), pose.quat_wxyz)
    return as_proposed(hand, tasks, postures, pose, hand.grasp_size(postures), np.full(len(tasks), np.nan))


def opposition_points(hand: Hand, postures: Array, tasks: Tasks) -> tuple[Array, Array]:
    """Locate the opposition pairs ``(n, 3)``, thumb first, of postures of mixed types, metres in the hand frame.

    Raises:
        InputError: the hand lacks a contact place of a type.
    """
    thumb, other = np.zeros((len(postures), 3)), np.zeros((len(postures), 3))
    for kind, rows in tasks.groups(lambda task: task.grasp_type):
        thumb[rows], other[rows] = hand.opposition(postures[rows], kind)
    return thumb, other


def cannot_touch(hand: Hand, grasps: Grasps) -> NDArray[np.bool_]:
    """Tell which grasps' opposing places stay farther apart than the side is wide, so that closing cannot touch.

    Collection skips these; the heuristic's own success rate counts them.
    """
    thumb, other = opposition_points(hand, grasps.posture, grasps.tasks)
    return np.asarray(np.linalg.norm(other - thumb, axis=-1) > grasps.side_m)


def _align(axes: Array, unit: Array, turn: Array) -> Array:
    """Rotate body axes ``(n, 3)`` onto unit directions by the smallest rotation, then turn about them."""
    # An axis has no sign (half-turns are symmetries), so the shorter of the two ways round is taken.
    body = np.where((axes * unit).sum(axis=-1, keepdims=True) < 0, -axes, axes)
    smallest = np.concatenate([1.0 + (body * unit).sum(axis=-1, keepdims=True), np.cross(body, unit)], axis=-1)
    return canonical_quat(quat_multiply(_turn(turn, unit), canonical_quat(smallest)))


def _turn(angle: Array, unit: Array) -> Array:
    """Compute the quaternions ``(n, 4)`` of turns by angles ``(n,)`` about unit directions ``(n, 3)``."""
    return np.concatenate([np.cos(angle / 2)[:, None], np.sin(angle / 2)[:, None] * unit], axis=-1)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _across(vectors: Array, unit: Array) -> Array:
    """Remove from vectors ``(n, 3)`` their parts along unit directions."""
    return np.asarray(vectors - (vectors * unit).sum(axis=-1, keepdims=True) * unit)
