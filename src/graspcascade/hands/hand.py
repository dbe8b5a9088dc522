"""`Hand`: joints, digits, couplings, actuators and contact places of a hand, and where they are in many postures."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.errors import FileFormatError, InputError
from ..core.poses import Pose
from ..core.taxonomy import AREAS, GRASP_TYPES, TAXONOMIES, GraspType
from .kinematics import Kinematics, Vector

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ContactPlace:
    """A spot on the surface of a body that is meant to touch objects: metres and outward unit normal in its frame."""

    body: str
    point_m: Vector
    normal: Vector


@dataclass(frozen=True)
class Digit:
    """A digit by its first body and the body of its tip.

    Attributes:
        tip_m: centre of the rounded fingertip in the tip body's frame, metres; grasp size is measured between tips.
    """

    root: str
    tip_body: str
    tip_m: Vector


@dataclass(frozen=True)
class Coupling:
    """Joints that are not free of each other, by the name of their tendon or joint equality.

    Attributes:
        kind: "tendon": one actuator drives the weighted sum of the joints; "equality": the first joint follows the
            second along a polynomial.
        coefficients: weights of the sum, or the polynomial's coefficients from the constant upwards.
    """

    name: str
    kind: str
    joints: tuple[str, ...]
    coefficients: tuple[float, ...]


@dataclass(frozen=True)
class Actuator:
    """A position actuator of the hand's model; limits that the model does not set are infinite.

    Attributes:
        weights: by joint, what the joint's angle adds to the actuator's length: 1 for a joint's own actuator, a
            tendon's coefficients.
        low: least target, radians.
        high: greatest target, radians.
        gain_nm_per_rad: torque per radian of error.
        force_limit_nm: greatest torque.
    """

    name: str
    weights: Mapping[str, float]
    low: float
    high: float
    gain_nm_per_rad: float
    force_limit_nm: float


@dataclass(frozen=True)
class PlacePoints:
    """A contact place in n postures: points ``(n, 3)`` in metres and outward unit normals, in the hand frame."""

    point_m: Array
    normal: Array


@dataclass(frozen=True)
class Closure:
    """What opposes (see `Hand.opposition`) ``(n, 3)`` in the hand frame, and tip distances ``(n,)``, all in metres."""

    thumb_m: Array
    other_m: Array
    grasp_size_m: Array


def middle(points: Sequence[Array]) -> Array:
    """Compute the middle of one or more points, ``(n, 3)`` each: where places that oppose the thumb together are."""
    return np.asarray(sum(points[1:], points[0]) / len(points))


@dataclass(frozen=True, eq=False, repr=False)
class Hand:
    """A hand and its geometry; all postures are ``(n, J)`` radians in the order of `joint_names`.

    The hand frame has z along the straight fingers, -y out of the palm and x towards the thumb. Names of bodies, joints
    and actuators are without the model's prefix.

    Attributes:
        name: identifier recorded with every dataset and model.
        mjcf: its MJCF file; None for a hand that came with a trained model, which cannot be simulated.
        prefix: what the MJCF puts before every name.
        body: body of the palm, which carries the hand frame.
        X_body_hand: hand frame in that body's frame.
        X_base_hand: hand frame in the frame of the base, the body that everything hangs from, wrist at zero.
        wrist_joints: joints held at zero in grasps and trials.
        joint_names: the J joints of a posture, in column order.
        lower_rad: ``(J,)`` lower joint limits, and `upper_rad` the upper ones.
        kinematics: the tree of links below the palm.
        digits: two or more by name, thumb first and then in anatomical order.
        actuators: what can be commanded; empty for a hand without `mjcf`.
        palm_bodies: bodies that count as palm.
        places: contact places by name, ``<digit>_pad``, ``<digit>_end``, ``<digit>_phalanx`` and ``middle_side``.
        surface_points: further points of the surface, body and metres in its frame, by name.
        pregrasp_rad: angles of the open hand before closing; joints left out are zero.
        reach_m: widest side of an object that the opposing digits reach round, metres.
        source: digest of the files it was read from, empty for a hand that came with a trained model.

    Examples:
        >>> from graspcascade import load_hand
        >>> hand = load_hand("shadow")
        >>> hand
        <Hand shadow_hand_right: 22 joints, thumb index middle ring little>
        >>> hand.grasp_size(hand.pregrasp[None]).round(3).tolist()  # metres, thumb tip to index tip
        [0.173]
    """

    name: str
    mjcf: Path | None
    prefix: str
    body: str
    X_body_hand: Pose
    X_base_hand: Pose
    wrist_joints: tuple[str, ...]
    joint_names: tuple[str, ...]
    lower_rad: Array
    upper_rad: Array
    kinematics: Kinematics
    digits: Mapping[str, Digit]
    couplings: tuple[Coupling, ...]
    actuators: tuple[Actuator, ...]
    palm_bodies: tuple[str, ...]
    places: Mapping[str, ContactPlace]
    surface_points: Mapping[str, tuple[str, Vector]]
    pregrasp_rad: Mapping[str, float]
    reach_m: float
    source: str = ""

    def __hash__(self) -> int:
        """Hash what tells hands apart, so that what is built for a hand can be kept by it."""
        return hash((self.name, self.mjcf, self.source))

    def __eq__(self, other: object) -> bool:
        """Compare by the files the hands were read from, or by identity where they have none."""
        if not isinstance(other, Hand) or not self.source:
            return self is other
        return (self.name, self.mjcf, self.source) == (other.name, other.mjcf, other.source)

    def __repr__(self) -> str:
        """Describe the hand in one line."""
        return f"<Hand {self.name}: {len(self.joint_names)} joints, {' '.join(self.digits)}>"

    @cached_property
    def pregrasp(self) -> Array:
        """Joint angles ``(J,)`` of the open hand before closing, radians."""
        return np.array([self.pregrasp_rad.get(name, 0.0) for name in self.joint_names])

    @property
    def fingers(self) -> tuple[str, ...]:
        """Digits other than the thumb, in order."""
        return tuple(digit for digit in self.digits if digit != "thumb")

    @property
    def grasp_types(self) -> tuple[GraspType, ...]:
        """Grasp types, as `core.taxonomy.GRASP_TYPES` has them, that the hand can make."""
        return self.possible(GRASP_TYPES.values())

    def possible(self, kinds: Iterable[GraspType]) -> tuple[GraspType, ...]:
        """Select the grasp types that the hand has the digits and contact places for."""
        return tuple(kind for kind in kinds if not self._missing(kind))

    def _missing(self, kind: GraspType) -> list[str]:
        missing = [name for name in kind.opposition if name not in self.places]
        lacking = [each for each in kind.asked_of(self.digits) if not set(each.digits) & set(self.digits)]
        return missing + [" or ".join(contact.digits) for contact in lacking]

    def check_type(self, kind: GraspType) -> None:
        """Check that the hand has what a grasp type needs; an InputError names what it lacks and possible types."""
        missing = self._missing(kind)
        if missing:
            others = self.possible(TAXONOMIES[kind.taxonomy].values())
            possible = ", ".join(other.name for other in others) or "none"
            cannot = f"hand {self.name} cannot make a {kind.name}: it has no {', '.join(missing)}"
            raise InputError(f"{cannot}. Possible types: {possible}.")

    def fingerprint(self) -> str:
        """Read the digest of the hand's files; a hand that came with a trained model has none: an InputError."""
        if not self.source:
            bare = f"hand {self.name} came with a trained model and has no files to compute a fingerprint of"
            raise InputError(f"{bare}; load it from its hand file")
        return self.source

    def clip(self, posture: ArrayLike) -> Array:
        """Bring angles inside the joint limits."""
        return np.clip(np.asarray(posture, dtype=np.float64), self.lower_rad, self.upper_rad)

    def executed(self, posture: ArrayLike) -> Array:
        """Compute the free-space angles that a commanded posture leads to.

        Of joints that share a tendon only the weighted sum is commanded and, touching nothing, they share it in
        proportion to their weights; a joint tied to another follows it; all others reach their targets within limits.
        """
        return self.share(self.clip(posture))

    def share(self, posture: ArrayLike) -> Array:
        """Apply the couplings to angles, whatever the limits (see `executed`)."""
        posture = np.array(posture, dtype=np.float64)
        for coupling in self.couplings:
            columns, weights = [self.joint_names.index(name) for name in coupling.joints], coupling.coefficients
            if coupling.kind == "equality":
                follower, leader = columns
                posture[..., follower] = np.polynomial.polynomial.polyval(posture[..., leader], weights)
                continue
            total = sum(posture[..., column] * weight for column, weight in zip(columns, weights, strict=True))
            norm = sum(weight * weight for weight in weights)
            for column, weight in zip(columns, weights, strict=True):
                posture[..., column] = total * weight / norm
        return posture

    def controls(self, angles: Mapping[str, ArrayLike]) -> dict[str, Array]:
        """Compute the actuators' targets ``(n,)`` for joint angles ``(n,)``, radians by joint name, the wrist at zero.

        Actuators are named as in the MJCF, prefix included; targets are within the control ranges.

        Raises:
            InputError: joints of the hand are missing, or the hand has no model and so no actuators.
        """
        self.columns_in(list(angles))
        if not self.actuators:
            bare = f"hand {self.name} came without its model and names no actuators"
            raise InputError(f"{bare}; load it from its hand file")
        given = {name: np.asarray(angles[name], dtype=np.float64) for name in self.joint_names}
        zero, targets = np.zeros(np.shape(given[self.joint_names[0]])), {}
        for actuator in self.actuators:
            lengths = (given[joint] * weight for joint, weight in actuator.weights.items() if joint in given)
            targets[self.prefix + actuator.name] = np.clip(sum(lengths, zero), actuator.low, actuator.high)
        return targets

    def columns_in(self, joint_names: Sequence[str]) -> list[int]:
        """Locate the hand's joints among the columns of grasps; an InputError names those that are not there."""
        missing = [name for name in self.joint_names if name not in joint_names]
        if missing:
            raise InputError(f"the grasps lack joints of {self.name}: {', '.join(missing)}")
        return [joint_names.index(name) for name in self.joint_names]

    def frames(self, posture: ArrayLike, bodies: list[str] | None = None) -> dict[str, tuple[Array, Array]]:
        """Compute body frames in the hand frame: ``(n, 3, 3)`` rotations and ``(n, 3)`` origins by body name."""
        return self.kinematics.frames(self._angles(posture), bodies)

    def _angles(self, posture: ArrayLike) -> dict[str, Array]:
        posture = np.atleast_2d(np.asarray(posture, dtype=np.float64))
        if posture.shape[1] != len(self.joint_names):
            raise InputError(f"a posture of this hand has {len(self.joint_names)} joints, got {posture.shape[1]}")
        return dict(zip(self.joint_names, posture.T, strict=True))

    def place_points(self, posture: ArrayLike, names: Sequence[str]) -> dict[str, PlacePoints]:
        """Locate contact places by name at these very angles (see `executed`); one it lacks is an InputError."""
        wanted, located = {name: self._place(name) for name in names}, {}
        frames = self.frames(posture, [place.body for place in wanted.values()])
        for name, place in wanted.items():
            rotation, origin = frames[place.body]
            located[name] = PlacePoints(origin + rotation @ np.array(place.point_m), rotation @ np.array(place.normal))
        return located

    def _place(self, name: str) -> ContactPlace:
        if name in self.places:
            return self.places[name]
        asking = [kind.name for kind in GRASP_TYPES.values() if name in (*kind.opposition, *kind.support)]
        needed = f", needed by {', '.join(asking)}" if asking else ""
        lacks = f"hand {self.name} has no contact place {name!r}{needed}"
        raise InputError(f"{lacks}; it has: {', '.join(self.places) or 'none'}")

    def tips(self, posture: ArrayLike, digits: Sequence[str]) -> dict[str, Array]:
        """Locate fingertip centres ``(n, 3)`` by digit, metres in the hand frame."""
        frames, located = self.frames(posture, [self.digits[name].tip_body for name in digits]), {}
        for name in digits:
            rotation, origin = frames[self.digits[name].tip_body]
            located[name] = origin + rotation @ np.array(self.digits[name].tip_m)
        return located

    def tip_distance(self, posture: ArrayLike) -> Array:
        """Measure thumb tip to index tip ``(n,)`` in metres at these very angles."""
        tips = self.tips(posture, ["thumb", "index"])
        return np.asarray(np.linalg.norm(tips["thumb"] - tips["index"], axis=-1))

    def grasp_size(self, posture: ArrayLike) -> Array:
        """Measure thumb tip to index tip ``(n,)`` of the posture executed without an object (paper, section V)."""
        return self.tip_distance(self.executed(posture))

    def opposition(self, posture: ArrayLike, kind: GraspType) -> tuple[Array, Array]:
        """Locate what opposes in a type, thumb first, ``(n, 3)`` each in metres, in the executed posture.

        Of several places that oppose the thumb together it is their middle.
        """
        places = self.place_points(self.executed(posture), kind.opposition)
        thumb, *others = (places[name].point_m for name in kind.opposition)
        return thumb, middle(others)

    def closure(self, executed: ArrayLike, kinds: Sequence[GraspType], kind_of_row: NDArray[np.intp]) -> Closure:
        """Measure how executed postures of mixed types close; posture i is of type ``kinds[kind_of_row[i]]``."""
        spots = {name: (self.digits[name].tip_body, self.digits[name].tip_m) for name in ("thumb", "index")}
        for name in sorted({name for kind in kinds for name in kind.opposition}):
            spots[name] = (self._place(name).body, self._place(name).point_m)
        located = self.kinematics.points(self._angles(executed), list(spots.values()))
        points = {name: point.T for name, point in zip(spots, located, strict=True)}
        thumb, other = np.zeros((2, len(kind_of_row), 3))
        for number, kind in enumerate(kinds):
            rows = np.True_ if len(kinds) == 1 else (kind_of_row == number)[:, None]
            own, *others = (points[name] for name in kind.opposition)
            np.copyto(thumb, own, where=rows)
            np.copyto(other, middle(others), where=rows)
        return Closure(thumb, other, np.linalg.norm(points["thumb"] - points["index"], axis=-1))

    def area_masks(self, bodies: Sequence[str], normals: ArrayLike) -> NDArray[np.uint16]:
        """Find on which areas of each digit contacts are: those that face most nearly as the surface does there.

        Pads and ends face as the contact places of these names, backs away from the pads; sides are those of a right
        hand.

        Args:
            bodies: bodies of digits, one for each of n contacts.
            normals: ``(n, 3)`` outward normals of the digit's surface at the contacts, in the bodies' frames.

        Returns:
            Masks ``(D,)`` of `core.taxonomy.AREAS`, a column a digit.
        """
        masks = np.zeros(len(self.digits), dtype=np.uint16)
        for body, normal in zip(bodies, np.asarray(normals, dtype=np.float64), strict=True):
            digit, directions, areas = self._faces[body]
            masks[digit] |= 1 << areas[int(np.argmax(directions @ normal))]
        return masks

    @cached_property
    def _faces(self) -> dict[str, tuple[int, Array, list[int]]]:
        """By body of a digit: the digit's column, directions ``(k, 3)`` in the body's frame, the area of each."""
        links = self.kinematics.links
        faces: dict[str, tuple[int, Array, list[int]]] = {}
        frames = {name: (turn[0], at[0]) for name, (turn, at) in self.frames(np.zeros(len(self.joint_names))).items()}

        def faced(place: str, default: Array) -> Array:
            known = self.places.get(place)
            return default if known is None else frames[known.body][0] @ known.normal

        for column, (name, digit) in enumerate(self.digits.items()):
            line, (turn, at) = self.kinematics.ancestry([digit.tip_body]), frames[digit.tip_body]
            # From the tip inwards; a body that no joint moves is a part of the one that it hangs from.
            moving = [link.name for link in reversed(links) if link.joint and link.name in line]
            along = at + turn @ digit.tip_m - frames[moving[0]][1]
            along /= np.linalg.norm(along)
            pad = faced(f"{name}_pad", np.array([0.0, -1.0, 0.0]))
            palmar = pad - (pad @ along) * along
            palmar /= np.linalg.norm(palmar)
            radial = np.cross(along, palmar)
            part_of = dict(zip(moving, ("distal", "middle"), strict=False))
            for link in links:
                if link.name != digit.root and faces.get(str(link.parent), (-1,))[0] != column:
                    continue
                above = "proximal" if link.name == digit.root else part_of[str(link.parent)]
                part = part_of.setdefault(link.name, "proximal" if link.joint else above)
                facing = {"pad": palmar, "radial": radial, "ulnar": -radial, "back": -palmar}
                if part == "distal":
                    facing |= {"pad": pad, "end": faced(f"{name}_end", along), "back": -pad}
                directions = np.array(list(facing.values())) @ frames[link.name][0]
                faces[link.name] = column, directions, [AREAS.index(f"{part}_{side}") for side in facing]
        return faces

    def to_json(self) -> dict[str, Any]:
        """Describe everything geometric as plain lists and numbers; collision shapes and actuators stay in the MJCF."""
        lists = ("wrist_joints", "joint_names", "palm_bodies", "lower_rad", "upper_rad")
        return {name: np.array(getattr(self, name)).tolist() for name in lists} | {
            "name": self.name,
            "hand_body": self.body,
            "couplings": [[c.name, c.kind, list(c.joints), list(c.coefficients)] for c in self.couplings],
            "digit_roots": {name: digit.root for name, digit in self.digits.items()},
            "places": {name: [p.body, list(p.point_m), list(p.normal)] for name, p in self.places.items()},
            "tips": {name: [digit.tip_body, list(digit.tip_m)] for name, digit in self.digits.items()},
            "pregrasp_rad": dict(self.pregrasp_rad),
            "reach_m": self.reach_m,
            "X_forearm_hand": [part.tolist() for part in vars(self.X_base_hand).values()],
            "X_body_hand": [part.tolist() for part in vars(self.X_body_hand).values()],
            "kinematics": self.kinematics.to_json(),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Hand:
        """Rebuild a hand from `to_json()`, without MJCF and actuators; a FileFormatError names what is malformed."""
        try:
            couplings, tips = data["couplings"], data["tips"]
            names: Any = {key: tuple(data[key]) for key in ("wrist_joints", "joint_names", "palm_bodies")}
            return cls(
                name=data["name"],
                mjcf=None,
                prefix="",
                body=data["hand_body"],
                X_body_hand=Pose.of(*data["X_body_hand"]),
                X_base_hand=Pose.of(*data["X_forearm_hand"]),
                lower_rad=np.array(data["lower_rad"], dtype=np.float64),
                upper_rad=np.array(data["upper_rad"], dtype=np.float64),
                kinematics=Kinematics.from_json(data["kinematics"]),
                digits={k: Digit(root, tips[k][0], tuple(tips[k][1])) for k, root in data["digit_roots"].items()},
                couplings=tuple(Coupling(name, kind, tuple(js), tuple(ws)) for name, kind, js, ws in couplings),
                actuators=(),
                places={k: ContactPlace(p[0], tuple(p[1]), tuple(p[2])) for k, p in data["places"].items()},
                surface_points={},
                pregrasp_rad=dict(data["pregrasp_rad"]),
                reach_m=float(data["reach_m"]),
                **names,
            )
        except (KeyError, TypeError, IndexError, ValueError, AttributeError) as error:
            raise FileFormatError(f"stored hand geometry lacks or garbles {error}") from error


_LEFT = re.compile(r"(^|[^a-z])((lh|left)([^a-z]|$)|l([_/.:-]|$))", re.IGNORECASE)


def is_left(name: str) -> bool:
    """Tell whether a hand's name, or what stands before a joint's, such as ``lh_``, is that of a left hand."""
    return _LEFT.search(name) is not None


def digest(*parts: bytes | str | Mapping[str, Any]) -> str:
    """Compute a short digest of files' contents and plain data."""
    total = hashlib.sha256()
    for part in parts:
        data = json.dumps(part, sort_keys=True) if isinstance(part, Mapping) else part
        total.update(data.encode() if isinstance(data, str) else data)
    return total.hexdigest()[:16]
