"""DexGraspBench: a folder with one pickled dictionary a grasp, and the objects beside them.

    graspdata/<object>/<grasp type>/<number>.npy
    objects/<object>/info/simplified.json
    objects/<object>/urdf/meshes/convex_piece_000.obj

Each hand state is 29 numbers: pose of the hand base in the world (xyz in metres, quaternion wxyz), then 22 angles in
the order of `JOINTS`. The base lies 34 mm below the palm body along the fingers' axis, where the wrist is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError
from ..objects import grasp_object
from ..poses import Pose
from .contact import contact_of
from .document import GraspDocument
from .meshes import object_mesh, write_obj
from .notes import (
    KEY,
    ForeignGrasp,
    file_notes,
    foreign_document,
    grasp_notes,
    mapping,
    noted_pose,
    number,
    numbers,
    pose,
)
from .options import Assumptions, ExportOptions
from .pickled import load_objects, save_objects

JOINTS: tuple[str, ...] = tuple(
    f"{digit}J{joint}"
    for digit, joints in (("FF", 4), ("MF", 4), ("RF", 4), ("LF", 5), ("TH", 5))
    for joint in range(joints, 0, -1)
)
X_HAND_BASE = Pose(np.array([0.0, 0.0, -0.034]), np.array([1.0, 0.0, 0.0, 0.0]))
CONVENTIONS = {
    "qpos": "base xyz in metres, base quaternion wxyz, then angles in radians in the order of qpos_joint_names",
    "base frame": "34 mm below the palm body along the fingers (-z of the hand frame), same axes",
    "obj_pose": "object in the world, xyz in metres, quaternion wxyz",
    "pregrasp_qpos": "open hand",
    "grasp_qpos": "in contact, from a trial; where contact_measured is false, the target",
    "squeeze_qpos": "joint targets",
}


def write(path: Path, document: GraspDocument, options: ExportOptions) -> None:
    """Fill a folder.

    Raises:
        InputError: a value that no reader would take.
    """
    grasps = document.grasps
    notes = file_notes(document, CONVENTIONS) | {"qpos_joint_names": list(JOINTS), "n_grasps": len(grasps)}
    contact = contact_of(grasps, options)
    world = document.X_world_object or Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    base = world @ contact.X_hand_object.inverse() @ X_HAND_BASE
    columns = [grasps.joint_names.index(name) for name in JOINTS]
    each = grasp_notes(grasps)
    root = options.object_root or "objects"
    for i, label in enumerate(grasps.object_label.tolist()):
        folder = path / "graspdata" / label / str(grasps.grasp_type[i])
        folder.mkdir(parents=True, exist_ok=True)
        each[i] |= {"contact_measured": bool(contact.measured[i]), "placed": _placed(document, i)}
        row = {
            "obj_path": f"{root}/{label}",
            "obj_scale": 1.0,
            "obj_pose": np.concatenate([world.position_m, world.quat_wxyz]),
            "pregrasp_qpos": _qpos(base, i, grasps.pregrasp[i, columns]),
            "grasp_qpos": _qpos(base, i, contact.posture[i, columns]),
            "squeeze_qpos": _qpos(base, i, grasps.posture[i, columns]),
            KEY: notes | {"grasp": each[i]},
        }
        save_objects(folder / _file_name(i), row)
    for label in dict.fromkeys(grasps.object_label.tolist()):
        _write_object(path / "objects" / label, label)


def read(path: Path, assume: Assumptions) -> GraspDocument:
    """Read one grasp's file, or all under a folder.

    The hand base of ``grasp_qpos`` counts, since the base of a trial does not move. In an export of ours, the object is
    back where it was placed before the trial.

    Raises:
        FileFormatError: it is truncated or foreign, its object is scaled, or an export has lost files.
        InputError: something it does not say and nothing is assumed for.
    """
    whole = path / "graspdata"
    files = sorted((whole if whole.is_dir() else path).rglob("*.npy")) if path.is_dir() else [path]
    found: list[ForeignGrasp] = []
    noted: list[Mapping[str, Any]] = []
    for file in files:
        try:
            row = _row(file)
            found.append(_grasp(row))
        except FileFormatError as error:
            raise FileFormatError(f"{file.name}: {error}") from error
        noted.append(mapping(row.get(KEY)))
    if whole.is_dir():
        if not files:
            raise FileFormatError("graspdata holds no .npy files")
        _check_none_lost(noted)
    return foreign_document(found, noted[-1] if noted else {}, assume)


def _check_none_lost(noted: list[Mapping[str, Any]]) -> None:
    """Check that an export's grasps are all there; files of others, or without a count, may lie beside them."""
    written = max(int(number(notes.get("n_grasps", 0), "n_grasps")) for notes in noted)
    numbered = [mapping(notes.get("grasp")).get("number") for notes in noted]
    present = {i for i in numbered if isinstance(i, int) and 0 <= i < written}
    if len(present) < written:
        first = next(i for i in range(written) if i not in present)
        raise FileFormatError(
            f"it has {len(present)} of the {written} grasps that were written; {_file_name(first)} is lost"
        )


def _row(file: Path) -> Mapping[str, Any]:
    found = load_objects(file)
    row = found.item() if found.ndim == 0 else None
    if not isinstance(row, Mapping) or "grasp_qpos" not in row:
        raise FileFormatError("not a DexGraspBench grasp (one dictionary with grasp_qpos)")
    return row


def _grasp(row: Mapping[str, Any]) -> ForeignGrasp:
    if number(row.get("obj_scale", 1.0), "obj_scale") != 1.0:
        raise FileFormatError(f"obj_scale is {row['obj_scale']}; catalogue objects are meshed in metres, at scale 1")
    states = {}
    for name in ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos"):
        given = row.get(name, row["grasp_qpos"])
        length = np.size(given)
        if length != 7 + len(JOINTS):
            raise FileFormatError(f"{name} has {length} numbers; a Shadow Hand's has {7 + len(JOINTS)}")
        states[name] = numbers(given, 7 + len(JOINTS), name)
    base, placed = states["grasp_qpos"][:7], numbers(row.get("obj_pose"), 7, "obj_pose")
    X_world_hand = pose(base[:3], base[3:], "hand base") @ X_HAND_BASE.inverse()
    X_hand_object = X_world_hand.inverse() @ pose(placed[:3], placed[3:], "obj_pose")
    notes = mapping(mapping(row.get(KEY)).get("grasp"))
    if "placed" in notes:
        X_hand_object = noted_pose(notes["placed"])
    return ForeignGrasp(
        dict(zip(JOINTS, states["squeeze_qpos"][7:], strict=True)),
        dict(zip(JOINTS, states["pregrasp_qpos"][7:], strict=True)),
        X_hand_object,
        str(row.get("obj_path")).rstrip("/").rsplit("/", 1)[-1],
        notes,
    )


def _file_name(row: int) -> str:
    return f"{row:06d}.npy"


def _placed(document: GraspDocument, row: int) -> dict[str, list[float]]:
    placed = document.grasps.X_hand_object
    return {"position_m": placed.position_m[row].tolist(), "quat_wxyz": placed.quat_wxyz[row].tolist()}


def _qpos(base: Pose, row: int, angles: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([base.position_m[row], base.quat_wxyz[row], angles])


def _write_object(folder: Path, label: str) -> None:
    mesh = object_mesh(grasp_object(label))
    (folder / "info").mkdir(parents=True)
    (folder / "urdf" / "meshes").mkdir(parents=True)
    # The mesh's own volume: the benchmark sets a density so that the meshed object has a given mass.
    info = {"mass": mesh.volume_m3, "density": 1.0, "scale": 1.0}
    (folder / "info" / "simplified.json").write_text(json.dumps(info, indent=1) + "\n", encoding="utf-8")
    write_obj(folder / "urdf" / "meshes" / "convex_piece_000.obj", mesh)
