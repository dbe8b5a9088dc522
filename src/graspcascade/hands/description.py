"""What a hand model does not say of itself: which bodies are which digit, and where the pads are."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib.resources import files
from pathlib import Path

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class ContactPlace:
    """Mark a spot on the hand's surface that is meant to touch objects.

    Attributes:
        body: body that carries it.
        point_m: the spot in that body's frame, metres.
        normal: outward unit normal in that body's frame.
    """

    body: str
    point_m: Vector
    normal: Vector


@dataclass(frozen=True)
class HandDescription:
    """Name the parts of an MJCF hand. Names are given without the model's prefix.

    Attributes:
        name: identifier recorded with every dataset and model.
        mjcf: path of the MJCF file.
        hand_body: body whose frame is the hand frame (the palm).
        wrist_joints: joints held at zero in grasps and trials.
        joint_names: the joints of a posture, in column order.
        coupled: pairs of joints driven by one tendon, by actuator name.
        digit_roots: first body of each digit, by digit.
        palm_bodies: bodies that count as palm.
        places: contact places by name, ``<digit>_pad``, ``<digit>_end`` and ``<digit>_phalanx``.
        tips: body and point at the centre of each rounded fingertip, by digit; grasp size is measured between them.
        pregrasp_rad: angles of the open hand before closing; joints left out are zero.
        prefix: what the MJCF puts before body, joint and tendon names.
    """

    name: str
    mjcf: Path
    hand_body: str
    wrist_joints: tuple[str, ...]
    joint_names: tuple[str, ...]
    coupled: Mapping[str, tuple[str, str]]
    digit_roots: Mapping[str, str]
    palm_bodies: tuple[str, ...]
    places: Mapping[str, ContactPlace]
    tips: Mapping[str, tuple[str, Vector]]
    pregrasp_rad: Mapping[str, float] = field(default_factory=dict)
    prefix: str = ""

    def __hash__(self) -> int:
        """Hash what tells hands apart, so that what is built for a hand can be kept by it."""
        return hash((self.name, self.mjcf, self.prefix))

    @property
    def pregrasp(self) -> tuple[float, ...]:
        """Give the open hand before closing, radians, in the order of the joints."""
        return tuple(self.pregrasp_rad.get(name, 0.0) for name in self.joint_names)

    def fingerprint(self) -> str:
        """Give a short digest of the description and of its MJCF file, wherever that lies."""
        about = asdict(self) | {"mjcf": hashlib.sha256(self.mjcf.read_bytes()).hexdigest()}
        return hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()[:16]

    def with_model(self, mjcf: Path | str, name: str, prefix: str) -> HandDescription:
        """Describe another MJCF of the same hand, such as one with meshes, whose bodies share our frames."""
        return replace(self, mjcf=Path(mjcf), name=name, prefix=prefix)


_FINGERS = {"index": "ff", "middle": "mf", "ring": "rf", "little": "lf"}
_FINGER_JOINTS = tuple(
    f"{finger.upper()}J{number}"
    for finger in _FINGERS.values()
    for number in ((5, 4, 3, 2, 1) if finger == "lf" else (4, 3, 2, 1))
)


def _finger_places(digit: str, finger: str) -> dict[str, ContactPlace]:
    return {
        f"{digit}_pad": ContactPlace(f"{finger}distal", (0.0, -0.00663, 0.019), (0.0, -0.98928, 0.14604)),
        f"{digit}_end": ContactPlace(f"{finger}distal", (0.0, -0.00405, 0.02905), (0.0, -0.86824, 0.49614)),
        f"{digit}_phalanx": ContactPlace(f"{finger}middle", (0.0, -0.009, 0.0125), (0.0, -1.0, 0.0)),
    }


_PLACES = {
    "thumb_pad": ContactPlace("thdistal", (0.0, -0.00764, 0.021), (0.0, -0.97918, 0.20299)),
    "thumb_end": ContactPlace("thdistal", (0.0, -0.00437, 0.03137), (0.0, -0.86196, 0.50697)),
}
for _digit, _finger in _FINGERS.items():
    _PLACES |= _finger_places(_digit, _finger)

SHADOW_HAND = HandDescription(
    name="shadow_hand_right",
    mjcf=Path(str(files("graspcascade.hands") / "shadow_hand.xml")),
    hand_body="palm",
    wrist_joints=("WRJ2", "WRJ1"),
    joint_names=(*_FINGER_JOINTS, "THJ5", "THJ4", "THJ3", "THJ2", "THJ1"),
    coupled={f"{f.upper()}J0": (f"{f.upper()}J2", f"{f.upper()}J1") for f in _FINGERS.values()},
    digit_roots={"thumb": "thbase"} | {digit: f"{finger}knuckle" for digit, finger in _FINGERS.items()},
    palm_bodies=("palm", "lfmetacarpal"),
    places=_PLACES,
    tips={"thumb": ("thdistal", (0.0, 0.0, 0.0275))}
    | {digit: (f"{finger}distal", (0.0, 0.0, 0.026)) for digit, finger in _FINGERS.items()},
    # Fingers straight, thumb swung out in front of the palm: flat beside the palm it would sweep the object away.
    pregrasp_rad={"THJ4": 1.2217304763960306},
)
"""The right Shadow Dexterous Hand with our primitive collision shapes."""
