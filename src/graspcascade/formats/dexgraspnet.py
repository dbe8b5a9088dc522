"""DexGraspNet: one ``.npy`` an object, an array of dictionaries with ``scale`` and ``qpos``.

``qpos`` has the palm's pose in the object frame (``WRJTx`` .. in metres, ``WRJRx`` .. in radians, turned about the
fixed axes x, y, z in this order) and 22 angles of the older Shadow model, whose joints are numbered from 0 and four of
which turn the other way. A folder has ``dataset/<object>.npy`` and ``meshdata/<object>/coacd/``.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..errors import FileFormatError, InputError
from ..hands import SHADOW_HAND
from ..objects import grasp_object
from ..poses import Pose, as_quat, as_rotation
from .contact import contact_of
from .document import GraspDocument
from .meshes import object_mesh, write_obj
from .notes import KEY, ForeignGrasp, file_notes, foreign_document, grasp_notes, mapping, noted_pose, number
from .options import Assumptions, ExportOptions
from .pickled import load_objects, save_objects

TRANSLATION: tuple[str, ...] = ("WRJTx", "WRJTy", "WRJTz")
ROTATION: tuple[str, ...] = ("WRJRx", "WRJRy", "WRJRz")
REVERSED: frozenset[str] = frozenset({"FFJ4", "MFJ4", "THJ2", "THJ1"})
"""Our joints that turn the other way in DexGraspNet's hand."""
JOINTS: Mapping[str, str] = {name: f"robot0:{name[:-1]}{int(name[-1]) - 1}" for name in SHADOW_HAND.joint_names}
"""DexGraspNet's joint names by ours."""
_SIGNS = {name: -1.0 if name in REVERSED else 1.0 for name in JOINTS}
CONVENTIONS = {
    "qpos WRJT": "palm body in the object frame, metres",
    "qpos WRJR": "its rotation about the fixed axes x, then y, then z, radians (transforms3d 'sxyz')",
    "qpos robot0": "radians; numbered from 0, so FFJ3 is the FFJ4 of joint_names, with the sign of that hand model",
    "scale": "of the mesh, which is in metres",
}


def write(path: Path, document: GraspDocument, options: ExportOptions) -> None:
    """Write one object's grasps to a file, or to a folder a file for each object with its meshes.

    Raises:
        InputError: a file is to hold grasps of several objects, or a value that no reader would take.
    """
    labels = list(dict.fromkeys(document.grasps.object_label.tolist()))
    rows = _dictionaries(document, options)
    if not path.is_dir():
        if len(labels) != 1:
            raise InputError(
                f"a DexGraspNet file holds the grasps of one object, these are of {len(labels)} "
                f"({', '.join(labels) or 'none'}); a name without suffix makes a folder with a file for each"
            )
        save_objects(path, rows)
        return
    (path / "dataset").mkdir()
    for label in labels:
        mine = [row for row, other in zip(rows, document.grasps.object_label.tolist(), strict=True) if other == label]
        save_objects(path / "dataset" / f"{label}.npy", mine)
        _write_object(path / "meshdata" / label / "coacd", label)


def read(path: Path, assume: Assumptions) -> GraspDocument:
    """Read an object's file, whose name is the object's, or all of a folder.

    ``qpos`` of a foreign file is taken for the target, and the hand opens as in our own trials.

    Raises:
        FileFormatError: it is truncated or foreign, or its object is scaled.
        InputError: something it does not say and nothing is assumed for.
    """
    found: list[tuple[Mapping[str, Any], str]] = []
    folder = path / "dataset" if (path / "dataset").is_dir() else path
    for file in sorted(folder.glob("*.npy")) if path.is_dir() else [path]:
        found.extend((row, file.stem) for row in _rows(file))
    notes = mapping(found[0][0].get(KEY)) if found else {}
    return foreign_document(_grasps(found), notes, assume)


def _dictionaries(document: GraspDocument, options: ExportOptions) -> list[dict[str, Any]]:
    notes = file_notes(document, CONVENTIONS)
    grasps, contact = document.grasps, contact_of(document.grasps, options)
    each = grasp_notes(grasps)
    palm = contact.X_hand_object.inverse()
    turns = _euler(palm.quat_wxyz)
    placed = grasps.X_hand_object
    found = []
    for i in range(len(grasps)):
        angles = {
            JOINTS[name]: _SIGNS[name] * angle
            for name, angle in zip(grasps.joint_names, contact.posture[i].tolist(), strict=True)
            if name in JOINTS
        }
        each[i] |= {
            "contact_measured": bool(contact.measured[i]),
            "posture": dict(zip(grasps.joint_names, grasps.posture[i].tolist(), strict=True)),
            "pregrasp": dict(zip(grasps.joint_names, grasps.pregrasp[i].tolist(), strict=True)),
            "placed": {"position_m": placed.position_m[i].tolist(), "quat_wxyz": placed.quat_wxyz[i].tolist()},
        }
        qpos = angles | dict(zip(ROTATION, turns[i].tolist(), strict=True))
        qpos |= dict(zip(TRANSLATION, palm.position_m[i].tolist(), strict=True))
        found.append({"scale": 1.0, "qpos": qpos, KEY: notes | {"grasp": each[i]}})
    return found


def _rows(file: Path) -> list[Mapping[str, Any]]:
    found = load_objects(file)
    rows = found.tolist() if found.ndim == 1 else None
    if rows is None or not all(isinstance(row, Mapping) and isinstance(row.get("qpos"), Mapping) for row in rows):
        raise FileFormatError("not a DexGraspNet file (an array of dictionaries with qpos by joint name)")
    return list(rows)


def _grasps(found: list[tuple[Mapping[str, Any], str]]) -> Iterator[ForeignGrasp]:
    for i, (row, name) in enumerate(found):
        try:
            yield _grasp(row, name)
        except FileFormatError as error:
            raise FileFormatError(f"grasp {i}: {error}") from error


def _grasp(row: Mapping[str, Any], object_name: str) -> ForeignGrasp:
    if number(row.get("scale", 1.0), "scale") != 1.0:
        raise FileFormatError(f"scale is {row['scale']}; catalogue objects are meshed in metres, at scale 1")
    qpos, notes = row["qpos"], mapping(mapping(row.get(KEY)).get("grasp"))
    missing = [name for name in (*TRANSLATION, *ROTATION, *JOINTS.values()) if name not in qpos]
    if missing:
        raise FileFormatError(f"qpos lacks {', '.join(missing)}")
    values = {name: number(qpos[name], name) for name in (*TRANSLATION, *ROTATION, *JOINTS.values())}
    turn = as_quat(Rotation.from_euler("xyz", [values[name] for name in ROTATION]))
    X_hand_object = Pose(np.array([values[name] for name in TRANSLATION]), turn).inverse()
    posture: Mapping[str, float] = {name: _SIGNS[name] * values[theirs] for name, theirs in JOINTS.items()}
    if not notes:
        return ForeignGrasp(posture, None, X_hand_object, object_name)
    # An export of ours may say where the hand settled; a trial wants what was commanded and where the object was put.
    kept = {name: {j: number(v, j) for j, v in mapping(notes.get(name)).items()} for name in ("posture", "pregrasp")}
    if any(set(JOINTS) - set(angles) for angles in kept.values()):
        raise FileFormatError("its notes lack joints of posture or pregrasp")
    placed = noted_pose(notes.get("placed"))
    return ForeignGrasp(kept["posture"], kept["pregrasp"], placed, object_name, notes)


def _euler(quat_wxyz: NDArray[np.float64]) -> NDArray[np.float64]:
    with warnings.catch_warnings():
        # At a pitch of 90 degrees roll and yaw are one; scipy says so and sets one to zero, which is as good as any.
        warnings.simplefilter("ignore", UserWarning)
        return np.asarray(as_rotation(quat_wxyz).as_euler("xyz"))


def _write_object(folder: Path, label: str) -> None:
    mesh = object_mesh(grasp_object(label))
    folder.mkdir(parents=True)
    for name in ("decomposed.obj", "coacd_convex_piece_0.obj"):
        write_obj(folder / name, mesh)
    shape = '<geometry><mesh filename="coacd_convex_piece_0.obj" scale="1 1 1"/></geometry>'
    (folder / "coacd.urdf").write_text(
        f'<?xml version="1.0"?>\n<robot name="{label}">\n <link name="{label}">\n'
        f"  <visual>{shape}</visual>\n  <collision>{shape}</collision>\n </link>\n</robot>\n",
        encoding="utf-8",
    )
