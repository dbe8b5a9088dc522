"""How likely grasps are to hold, judged by what points of the hand see of the object while it closes."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from ..core.distances import signed_distances
from ..core.errors import FileFormatError, InputError
from ..core.grasps import Grasps
from ..core.objects import SHAPES, Shape
from ..core.poses import Pose, axes_of, quat_multiply
from ..core.protocols import HOLD, Conditions
from ..hands.hand import Hand
from ..nets import NumpyDecoder, load_decoders, save_decoders
from ..nets.inference import logistic

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

SCORER_FILE = "scorer.safetensors"
_KIND, _DECODER = "grasp scorer", "scorer"
Seen = dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Sight:
    """Say what a scorer sees of a grasp beside its type."""

    geometry: Literal["distances", "shape"] = "distances"
    """Distances from points of the hand to the object; or the posture, and the object's pose, shape and extents."""
    closings: tuple[float, ...] = (1.0, 0.6)
    """Shares of the way from open hand to posture at which distances are measured."""
    gradients: bool = True
    """Whether at the first of these the distances' gradients, in the hand frame, are seen as well."""
    conditions: bool = True
    """Whether friction, mass and gains are seen."""

    def __post_init__(self) -> None:
        if not self.closings or not all(0.0 <= closing <= 1.0 for closing in self.closings):
            raise InputError(f"a scorer looks at closings from 0 to 1, at least one, got {self.closings}")


@dataclass(frozen=True)
class View:
    """Encode grasps as a scorer sees them.

    Attributes:
        grasp_types: names of the types, in the order of its inputs.
        points: bodies of the hand, and points of their surfaces in the bodies' frames, metres.
        sight: what is seen.
    """

    grasp_types: tuple[str, ...]
    points: tuple[tuple[str, tuple[float, float, float]], ...]
    sight: Sight = field(default_factory=Sight)

    @classmethod
    def of(cls, hand: Hand, grasp_types: Sequence[str], sight: Sight | None = None) -> View:
        """See with all contact places and surface points of a hand."""
        places = [(place.body, place.point_m) for place in hand.places.values()]
        return cls(tuple(grasp_types), (*places, *hand.surface_points.values()), sight or Sight())

    def width(self, hand: Hand) -> int:
        """Count the columns that `encode` makes."""
        sight = self.sight
        measured = len(self.points) * (len(sight.closings) + 3 * sight.gradients)
        shape = len(hand.joint_names) + 12 + len(SHAPES) + 3
        return (measured if sight.geometry == "distances" else shape) + len(self.grasp_types) + 4

    def encode(self, hand: Hand, grasps: Grasps, conditions: Conditions, *, is_exact: bool) -> NDArray[np.float32]:
        """Encode what is seen of grasps as columns ``(n, width)``: geometry, type, conditions, exactness.

        Args:
            hand: the hand that the grasps are of.
            grasps: at most one grasp type that the view does not list is an InputError.
            conditions: of each trial. Errors of pose and size are applied: what is seen is where the object is.
            is_exact: whether that is known exactly; otherwise it is off by an unknown error as under `varied`.
        """
        tasks, kinds = grasps.tasks, len(self.grasp_types)
        pose = grasps.X_hand_object
        if conditions.rotation_error_rad.any():
            pose = Pose(pose.position_m, quat_multiply(conditions.rotation_error_quat_wxyz, pose.quat_wxyz))
        pose = Pose(pose.position_m + conditions.position_error_m, pose.quat_wxyz)
        # Rows come last in memory: each step is then a few long contiguous operations.
        columns = np.empty((self.width(hand), len(grasps)), dtype=np.float32)
        geometry, types, numbers, exact = np.split(columns, len(columns) - 4 + np.array([-kinds, 0, 3]))
        see = self._distances if self.sight.geometry == "distances" else self._shape
        see(hand, grasps, pose, conditions.size_error_m, geometry)
        known = np.array([self.grasp_types.index(task.grasp_type.name) for task in tasks.table], dtype=np.intp)
        types[:] = known[tasks.row] == np.arange(kinds)[:, None]
        mass_kg = tasks.column(lambda task: task.object.mass_kg, np.float64) * conditions.density_factor
        numbers[:] = conditions.friction, np.log(mass_kg), np.log(conditions.gain_factor)
        numbers *= self.sight.conditions
        exact[:] = is_exact
        return columns.T

    def _distances(self, hand: Hand, grasps: Grasps, pose: Pose, larger_m: Array, out: Array32) -> None:
        tasks, n = grasps.tasks, len(grasps)
        turn = axes_of(pose.quat_wxyz).astype(np.float32)
        origin = -np.einsum("ijn,ni->jn", turn, pose.position_m.astype(np.float32))
        posture, opened = (
            part.T.astype(np.float32, order="C") for part in (hand.executed(grasps.posture), grasps.pregrasp)
        )
        angles = np.concatenate([opened + closing * (posture - opened) for closing in self.sight.closings], axis=1)
        (x, y, z), origins = (np.tile(part, len(self.sight.closings)) for part in (turn, origin))
        by_joint = dict(zip(hand.joint_names, angles, strict=True))
        points = hand.kinematics.points(by_joint, self.points, ((x, y, z), origins))
        shapes: list[Shape] = [task.object.shape for task in tasks.table]
        grown, m = (0.5 * larger_m).astype(np.float32), len(points)
        for number in range(len(self.sight.closings)):
            seen = points[..., number * n : (number + 1) * n].transpose(2, 0, 1)
            measured = signed_distances(shapes, tasks.row, seen, gradients=self.sight.gradients and not number)
            np.subtract(measured.distance_m.T, grown, out=out[:m])
            out = out[m:]
            if measured.gradient is not None:
                slopes = measured.gradient.T
                for column, axis in zip(out[: 3 * m].reshape(m, 3, n).swapaxes(0, 1), turn, strict=True):
                    np.multiply(slopes[0], axis[0], out=column)
                    column += slopes[1] * axis[1]
                    column += slopes[2] * axis[2]
                out = out[3 * m :]

    def _shape(self, hand: Hand, grasps: Grasps, pose: Pose, larger_m: Array, out: Array32) -> None:
        tasks, turn = grasps.tasks, axes_of(pose.quat_wxyz).reshape(9, -1)
        kinds = tasks.column(lambda task: [task.object.shape.kind == kind for kind in SHAPES], np.float64)
        extents = tasks.column(lambda task: task.object.extents_m, np.float64) + larger_m[:, None]
        parts = hand.executed(grasps.posture).T, pose.position_m.T, turn, kinds.T, extents.T
        np.concatenate(parts, out=out, casting="same_kind")


@dataclass(frozen=True)
class Chances:
    """Hold chances ``(n,)`` that grasps hold, and that they hold and touch as their type asks."""

    held: Array
    faithful: Array


@dataclass(frozen=True, eq=False, repr=False)
class Scorer:
    """Estimate the chances of grasps with numpy alone.

    Attributes:
        hand: geometry of the hand whose trials it was trained on.
        view: what it sees of a grasp.
        decoder: the trained network, its outputs calibrated.
        metadata: what it was trained on and how.
    """

    hand: Hand
    view: View
    decoder: NumpyDecoder
    metadata: dict[str, Any]

    @property
    def seen(self) -> Seen:
        """Least and greatest friction, and mass in grams, of the trials it learned from; empty where not recorded."""
        return msgspec.convert(self.metadata.get("seen", {}), Seen)

    def __repr__(self) -> str:
        """Word the scorer in one line."""
        return f"<Scorer of {len(self.view.grasp_types)} grasp types for {self.hand.name}>"

    def chances(self, grasps: Grasps, conditions: Conditions | None = None, *, is_exact: bool = False) -> Chances:
        """Estimate the chances of grasps under conditions, by default those of protocol `hold`.

        Args:
            grasps: of the hand, in its order of joints.
            conditions: of each trial.
            is_exact: whether the object is exactly where and as large as said, as in `hold`; otherwise it is off by
                what protocol `varied` draws, as when a camera looked.

        Raises:
            InputError: other joints than the hand's, or a type that it was not trained on.
        """
        if grasps.joint_names != self.hand.joint_names:
            raise InputError(f"the scorer is of the joints of {self.hand.name}, the grasps are of others")
        asked = dict.fromkeys(task.grasp_type.name for task in grasps.tasks.distinct)
        if foreign := [name for name in asked if name not in self.view.grasp_types]:
            known = ", ".join(self.view.grasp_types)
            raise InputError(f"the scorer has seen no grasps of type {', '.join(foreign)}; it knows {known}")
        about = Conditions.of(HOLD.physics, len(grasps)) if conditions is None else conditions
        if not len(grasps):
            return Chances(np.zeros(0), np.zeros(0))
        seen = self.view.encode(self.hand, grasps, about, is_exact=is_exact)
        said = logistic(self._network.run(seen)).astype(np.float64)
        return Chances(said[:, 0], said[:, 1])

    @cached_property
    def _network(self) -> NumpyDecoder:
        # Once more memory than a call takes was freed, glibc keeps as much for later instead of returning it to the
        # system, from which each call would fetch it again page by page.
        np.empty(3 << 20)
        return self.decoder.unscaled()

    def fingerprint(self) -> str:
        """Compute a short digest of the weights."""
        digest = hashlib.sha256()
        self.decoder.digest_into(digest)
        return digest.hexdigest()[:16]

    def save(self, folder: Path) -> None:
        """Write the scorer to one safetensors file in a folder, beside a cascade's weights."""
        about = {"kind": _KIND, "view": msgspec.to_builtins(self.view), "hand": self.hand.to_json()}
        save_decoders(folder / SCORER_FILE, {_DECODER: self.decoder}, about | {"training": self.metadata})

    @classmethod
    def load(cls, folder: Path | str) -> Scorer:
        """Read a scorer from its folder or file.

        Raises:
            InputError: there is no such file.
            FileFormatError: the file is truncated, foreign or not a scorer, or its parts do not fit together.
        """
        path = Path(folder)
        path = path / SCORER_FILE if path.is_dir() else path
        stored = load_decoders(path)
        about: Mapping[str, Any] = stored.metadata
        if about.get("kind") != _KIND or _DECODER not in stored.decoders:
            raise FileFormatError(f"{path} holds no grasp scorer")
        try:
            view, hand = msgspec.convert(about["view"], View), Hand.from_json(about["hand"])
            training = msgspec.convert(about["training"], dict[str, Any])
            msgspec.convert(training.get("seen", {}), Seen)
            hand.kinematics.points({}, view.points)
        except (KeyError, TypeError, InputError, msgspec.ValidationError) as error:
            raise FileFormatError(f"{path} lacks or garbles {error}") from error
        spec, scorer = stored.decoders[_DECODER].spec, cls(hand, view, stored.decoders[_DECODER], training)
        if (spec.target_dim, spec.latent_dim) != (2, 0) or spec.condition_dim != view.width(hand):
            raise FileFormatError(f"{path}: its weights do not fit what it says to see")
        return scorer
