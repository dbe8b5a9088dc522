"""Hand files for tests: the Shadow Hand's model edited as text, and smaller hands cut out of it."""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from graspcascade.core.grasps import Grasps
from graspcascade.core.tasks import Tasks
from graspcascade.core.taxonomy import DIGITS
from graspcascade.core.yaml_files import load_yaml
from graspcascade.hands import Hand, load_hand, shipped_hands

SHADOW_FILE = shipped_hands()["shadow"]
SHADOW_MJCF = SHADOW_FILE.parent / "shadow_hand.xml"


def shadow_entries() -> dict[str, Any]:
    """Read the entries of the Shadow Hand's file, to be changed at will."""
    entries = load_yaml(SHADOW_FILE)
    assert isinstance(entries, dict)
    return entries


def write_hand(folder: Path, mjcf: str | None = None, /, **entries: Any) -> Path:
    """Write a hand file based on the Shadow Hand, with the text of another MJCF beside it where one is given."""
    if mjcf is not None:
        (folder / "model.xml").write_text(mjcf, encoding="utf-8")
        entries = {"mjcf": "model.xml"} | entries
    path = folder / "hand.yaml"
    path.write_text(json.dumps({"base": "shadow"} | entries), encoding="utf-8")  # YAML takes JSON as it is
    return path


def edited(*changes: tuple[str, str]) -> str:
    """Replace parts of the Shadow Hand's MJCF, each of which must be there."""
    text = SHADOW_MJCF.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return text


def actuator_line(name: str) -> str:
    """Find the line of an actuator in the Shadow Hand's MJCF."""
    return next(line for line in SHADOW_MJCF.read_text().splitlines() if f'<position name="{name}"' in line)


def cut_hand(folder: Path, n_digits: int) -> Hand:
    """Write the Shadow Hand with only its first digits, thumb first, and read it."""
    entries = shadow_entries()
    kept, gone = DIGITS[:n_digits], DIGITS[n_digits:]
    # The little finger takes its part of the palm along, which a joint of its own moves.
    roots = {entries["digits"][digit]["root"] for digit in gone} | ({"lfmetacarpal"} if "little" in gone else set())
    text, joints = _without(roots)
    return load_hand(
        write_hand(
            folder,
            text,
            name=f"hand_of_{n_digits}",
            joints=[name for finger in entries["joints"] for name in finger if name in joints],
            digits={digit: entries["digits"][digit] for digit in kept},
            couplings={name: pair for name, pair in entries["couplings"].items() if joints.issuperset(pair)},
            places={name: place for name, place in entries["places"].items() if name.startswith(kept)},
            surface_points={
                name: point for name, point in entries["surface_points"].items() if name.startswith((*kept, "palm"))
            },
            palm_bodies=["palm"] if "little" in gone else entries["palm_bodies"],
        )
    )


def _without(roots: Collection[str]) -> tuple[str, set[str]]:
    """Cut bodies out of the Shadow Hand's MJCF with all that speaks of them; also name the joints that stay."""
    tree = ElementTree.parse(SHADOW_MJCF).getroot()
    parents = {child: parent for parent in tree.iter() for child in parent}
    for body in [body for body in tree.iter("body") if body.get("name") in roots]:
        parents[body].remove(body)
    bodies = {body.get("name") for body in tree.iter("body")}
    joints = {joint.get("name", "") for body in tree.iter("body") for joint in body.findall("joint")}
    for tendon in tree.findall("tendon/fixed"):
        if not joints.issuperset(part.get("joint", "") for part in tendon):
            parents[tendon].remove(tendon)
    tendons = {tendon.get("name") for tendon in tree.findall("tendon/fixed")}
    for element in [*tree.findall("actuator/*"), *tree.findall("contact/exclude")]:
        speaks_of = {element.get(key) for key in ("joint", "tendon", "body1", "body2")} - {None}
        if not speaks_of <= joints | tendons | bodies:
            parents[element].remove(element)
    return ElementTree.tostring(tree, encoding="unicode"), joints


def cut_grasps(grasps: Grasps, hand: Hand, rows: np.ndarray) -> Grasps:
    """Keep of the Shadow Hand's grasps the joints that a smaller hand has."""
    columns = [grasps.joint_names.index(name) for name in hand.joint_names]
    some = grasps[rows]
    angles = {"posture": some.posture[:, columns], "pregrasp": some.pregrasp[:, columns]}
    tasks: Tasks = some.tasks
    return Grasps.from_columns(hand.name, hand.joint_names, tasks, some.columns() | angles)
