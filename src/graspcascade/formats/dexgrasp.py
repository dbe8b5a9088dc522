"""DexGraspBench and DexGraspNet: the Shadow Hand's grasps as pickled dictionaries; reading one runs what it carries.

A DexGraspBench folder has ``graspdata/<object>/<grasp type>/<number>.npy`` and ``objects/<object>/``, a DexGraspNet one
``dataset/<object>.npy`` and ``meshdata/<object>/``; docs/formats.md says what is in them.
"""

from __future__ import annotations

import contextlib
import json
import pickle
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.errors import FileFormatError, InputError
from ..core.grasps import Grasps
from ..core.poses import Pose, as_quat, as_rotation
from ..worlds.meshes import shape_mesh, write_obj
from . import document as doc
from . import foreign
from .document import ANGLES, Assumptions, ExportOptions, GraspDocument, mapping, number, pose_of
from .foreign import KEY, ForeignGrasp

_CHANCE = {f"{KEY} grasp probability": "chance to hold as its type asks; None unknown"}
_DIGITS = {"FF": 4, "MF": 4, "RF": 4, "LF": 5, "TH": 5}
JOINTS: tuple[str, ...] = tuple(f"{digit}J{joint}" for digit, n in _DIGITS.items() for joint in range(n, 0, -1))
BENCH, NET = "DexGraspBench", "DexGraspNet"
_FILE = "{:06d}.npy"
STATES = ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos")
_NOWHERE = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
X_HAND_BASE = Pose(np.array([0.0, 0.0, -0.034]), np.array([1.0, 0.0, 0.0, 0.0]))
BENCH_CONVENTIONS = {
    "qpos": "base xyz in metres, base quaternion wxyz, then angles in radians in the order of qpos_joint_names",
    "base frame": "34 mm below the palm body along the fingers (-z of the hand frame), same axes",
    "obj_pose": "object in the world, xyz in metres, quaternion wxyz",
    "pregrasp_qpos": "open hand",
    "grasp_qpos": "in contact, from a trial; where contact_measured is false, the target",
    "squeeze_qpos": "joint targets",
    **_CHANCE,
}
TRANSLATION: tuple[str, ...] = ("WRJTx", "WRJTy", "WRJTz")
ROTATION: tuple[str, ...] = ("WRJRx", "WRJRy", "WRJRz")
REVERSED: frozenset[str] = frozenset({"FFJ4", "MFJ4", "THJ2", "THJ1"})
"""Our joints that turn the other way in DexGraspNet's hand."""
NET_CONVENTIONS = {
    "qpos WRJT": "palm body in the object frame, metres",
    "qpos WRJR": "its rotation about the fixed axes x, then y, then z, radians (transforms3d 'sxyz')",
    "qpos robot0": "radians; numbered from 0, so FFJ3 is the FFJ4 of joint_names, with the sign of that hand model",
    "scale": "of the mesh, which is in metres",
    **_CHANCE,
}


def write_bench(path: Path, document: GraspDocument, options: ExportOptions) -> None:
    """Fill a folder."""
    grasps, stems = document.grasps, foreign.file_stems(document.grasps.tasks)
    contact, notes, each = _in_contact(document, options, BENCH, BENCH_CONVENTIONS)
    notes |= {"qpos_joint_names": list(JOINTS), "n_grasps": len(grasps)}
    world, root = document.X_world_object or _NOWHERE, options.object_root or "objects"
    base = world @ contact.X_hand_object.inverse() @ X_HAND_BASE
    columns = [grasps.joint_names.index(name) for name in JOINTS]
    states = dict(zip(STATES, (grasps.pregrasp, contact.posture, grasps.posture), strict=True))
    for i, name in enumerate(grasps.object_name.tolist()):
        folder = path / "graspdata" / stems[name] / str(grasps.grasp_type[i])
        folder.mkdir(parents=True, exist_ok=True)
        placed = np.concatenate([world.position_m, world.quat_wxyz])
        row = {"obj_path": f"{root}/{stems[name]}", "obj_scale": 1.0, "obj_pose": placed}
        for state, angles in states.items():
            row[state] = np.concatenate([base.position_m[i], base.quat_wxyz[i], angles[i, columns]])
        save_objects(folder / _FILE.format(i), row | {KEY: notes | {"grasp": each[i]}})
    for name, obj in grasps.tasks.objects.items():
        mesh, folder = shape_mesh(obj.shape), path / "objects" / stems[name]
        write_obj(folder / "urdf" / "meshes" / "convex_piece_000.obj", mesh)
        # The mesh's own volume: the benchmark sets a density so that the meshed object has a given mass.
        info = {"mass": float(mesh.volume), "density": 1.0, "scale": 1.0}
        (folder / "info").mkdir()
        (folder / "info" / "simplified.json").write_text(json.dumps(info, indent=1) + "\n", encoding="utf-8")


def read_bench(path: Path, assume: Assumptions) -> GraspDocument:
    """Read one file, or all under a folder.

    The hand base of ``grasp_qpos`` counts, since the base of a trial does not move. In an export of ours, the object is
    back where it was placed before the trial.
    """
    whole = path / "graspdata"
    files = (whole if whole.is_dir() else path).rglob("*.npy")
    rows: list[ForeignGrasp] = []
    noted: list[Mapping[str, Any]] = []
    for file, name in foreign.input_files(path, files, ".npy"):
        with doc.place(name):
            array = load_objects(file)
            row = array.item() if array.ndim == 0 else None
            if not isinstance(row, Mapping) or not {"grasp_qpos", "robot_pose"} & set(row):
                raise FileFormatError("not a DexGraspBench grasp (one dictionary with grasp_qpos or robot_pose)")
            rows.extend(_bench_grasps(row))
            noted.append(mapping(row.get(KEY)))
    if whole.is_dir():
        # All grasps of an export must be there; files of others, or without a count, may lie beside them.
        written = max(int(number(notes.get("n_grasps", 0), "n_grasps")) for notes in noted)
        rows_noted = [mapping(notes.get("grasp")).get("number") for notes in noted]
        present = {i for i in rows_noted if isinstance(i, int) and 0 <= i < written}
        if len(present) < written:
            first = _FILE.format(next(i for i in range(written) if i not in present))
            raise FileFormatError(f"it has {len(present)} of the {written} grasps that were written; {first} is lost")
    return _document(rows, noted, assume, BENCH)


def _bench_grasps(row: Mapping[str, Any]) -> Iterator[ForeignGrasp]:
    """Read the grasps of a dictionary, one or a batch."""
    states, order, X_hand_base = _states(row)
    n, head = len(states["grasp_qpos"]), mapping(row.get(KEY))
    placed, notes = _batch(row.get("obj_pose"), 7, "obj_pose"), mapping(head.get("grasp"))
    paths = np.asarray(row.get("obj_path"), dtype=object).reshape(-1)
    for what, given in (("obj_pose", placed), ("obj_path", paths)):
        if len(given) not in (1, n):
            raise FileFormatError(f"{what} has {len(given)} entries for {n} grasps; it needs one, or one for each")
    if n > 1 and (head or np.asarray(row.get("obj_scale"), dtype=object).size > 1):
        of_one = f"the notes under {KEY!r} are" if head else "an obj_scale of several numbers is"
        raise FileFormatError(f"it holds {n} grasps, but {of_one} of a single one")
    scale, contact = foreign.scale_of(row.get("obj_scale", 1.0), "obj_scale"), mapping(notes.get("contact"))
    world = doc.pose_to_json(doc.world_pose(head) or _NOWHERE)
    for i, (opened, base, target) in enumerate(zip(*(states[state] for state in STATES), strict=True)):
        path, obj = paths[i % len(paths)], placed[i % len(placed)]
        name = None if path is None else re.sub(r"(/mesh)?/[^/]+\.obj$", "", str(path).rstrip("/")).rsplit("/", 1)[-1]
        X_world_hand = pose_of(base[:3], base[3:7], "hand base") @ X_hand_base.inverse()
        X_world_object = pose_of(obj[:3], obj[3:], "obj_pose")
        X_hand_object = X_world_hand.inverse() @ X_world_object
        changed = foreign.differ(X_hand_object, doc.by_name(order, base[7:]), contact)
        changed |= bool(contact) and foreign.differ(X_world_object, {}, world)
        if "placed" in notes and not changed:
            X_hand_object = foreign.noted_pose(mapping(notes["placed"]))
        posture, pregrasp = doc.by_name(order, target[7:]), doc.by_name(order, opened[7:])
        yield ForeignGrasp(posture, pregrasp, X_hand_object, name, scale, notes=notes, changed=changed)


def _states(row: Mapping[str, Any]) -> tuple[dict[str, NDArray[np.float64]], Sequence[str], Pose]:
    """Read the three states ``(n, 29)`` of a dictionary, the order of their joints, and the base in the hand frame."""
    order: Sequence[str] = JOINTS
    X_hand_base = X_HAND_BASE
    given = {state: row.get(state, row.get("grasp_qpos")) for state in STATES}
    if "grasp_qpos" not in row:
        stages = _array(row["robot_pose"], "robot_pose")
        if stages.ndim == 4 and stages.shape[0] == 1 and stages.shape[2] >= 3:
            # As BODex writes it: the palm's own pose, and the thumb first.
            stages, order, X_hand_base = stages[0, :, :3], (*JOINTS[-5:], *JOINTS[:-5]), _NOWHERE
        in_stages = stages.ndim == 3 and stages.shape[1] == 3
        given = {state: stages[:, i] if in_stages else stages for i, state in enumerate(STATES)}
    width = 7 + len(JOINTS)
    states = {state: _batch(value, width, state if state in row else "robot_pose") for state, value in given.items()}
    if len({len(state) for state in states.values()}) > 1:
        lengths = ", ".join(f"{name} {len(state)}" for name, state in states.items())
        raise FileFormatError(f"its states are batched as different numbers of grasps: {lengths}")
    if row.get("joint_names") is not None:
        listed = np.asarray(row["joint_names"], dtype=object).reshape(-1).tolist()
        if len(listed) != len(JOINTS):
            raise FileFormatError(f"joint_names has {len(listed)} names for {len(JOINTS)} angles")
        places = foreign.pick_joints({str(name): i for i, name in enumerate(listed)}, JOINTS, "joint_names")
        order = sorted(JOINTS, key=lambda joint: places[joint])
    return states, order, X_hand_base


def _batch(value: object, width: int, what: str) -> NDArray[np.float64]:
    """Read one row of numbers ``(width,)``, or a batch ``(n, width)``, as a batch."""
    array = _array(value, what)
    if array.ndim > 2:
        raise FileFormatError(f"{what} is batched as {array.shape}; only ({width},) and (n, {width}) can be read")
    if array.ndim == 0 or array.shape[-1] != width:
        raise FileFormatError(f"{what} has {array.size} numbers; a Shadow Hand's has {width}, batched (n, {width})")
    for bad in array[~np.isfinite(array)][:1].tolist():
        number(bad, what)
    return array.reshape(-1, width)


def _array(value: object, what: str) -> NDArray[np.float64]:
    if value is None:
        raise FileFormatError(f"lacks {what}")
    with contextlib.suppress(TypeError, ValueError, OverflowError):
        array = np.asarray(value)
        if array.dtype.kind in "iufO":
            return array.astype(np.float64)
    raise FileFormatError(f"{what} is {doc.shown(value)}, not an array of numbers")


def write_net(path: Path, document: GraspDocument, options: ExportOptions) -> None:
    """Write one object's grasps to a file, or to a folder a file for each object with its meshes."""
    grasps = document.grasps
    contact, notes, each = _in_contact(document, options, NET, NET_CONVENTIONS)
    palm = contact.X_hand_object.inverse()
    rows: list[dict[str, Any]] = []
    with warnings.catch_warnings():
        # At a pitch of 90 degrees roll and yaw are one; scipy says so and sets one to zero, which is as good as any.
        warnings.simplefilter("ignore", UserWarning)
        turns = as_rotation(palm.quat_wxyz).as_euler("xyz")
    for i, noted in enumerate(each):
        angles = doc.by_name(grasps.joint_names, contact.posture[i])
        qpos = {
            f"robot0:{other}": -angles[name] if name in REVERSED else angles[name]
            for name, other in foreign.numbered(JOINTS, 0).items()
        }
        qpos |= doc.by_name(ROTATION, turns[i]) | doc.by_name(TRANSLATION, palm.position_m[i])
        noted |= {name: doc.by_name(grasps.joint_names, getattr(grasps, name)[i]) for name in ANGLES}
        rows.append({"scale": 1.0, "qpos": qpos, KEY: notes | {"grasp": noted}})
    shape = '<geometry><mesh filename="coacd_convex_piece_0.obj" scale="1 1 1"/></geometry>'
    if path.is_dir():
        (path / "dataset").mkdir()
    for obj, file, mine in foreign.object_files(path, path / "dataset", ".npy", grasps.tasks, "a DexGraspNet"):
        save_objects(file, [rows[i] | {KEY: rows[i][KEY] | {"n_grasps": len(mine)}} for i in mine])
        if path.is_dir():
            mesh, folder = shape_mesh(obj.shape), path / "meshdata" / file.stem / "coacd"
            write_obj(folder / "decomposed.obj", mesh)
            write_obj(folder / "coacd_convex_piece_0.obj", mesh)
            (folder / "coacd.urdf").write_text(
                f'<?xml version="1.0"?>\n<robot name="{file.stem}">\n <link name="{file.stem}">\n'
                f"  <visual>{shape}</visual>\n  <collision>{shape}</collision>\n </link>\n</robot>\n",
                encoding="utf-8",
            )


def read_net(path: Path, assume: Assumptions) -> GraspDocument:
    """Read an object's file, whose name is the object's, or all of a folder.

    ``qpos`` of a foreign file is taken for the target, and the hand opens as in our own trials.
    """
    rows: list[ForeignGrasp] = []
    noted: list[Mapping[str, Any]] = []
    folder = path / "dataset" if (path / "dataset").is_dir() else path
    for file, name in foreign.input_files(path, folder.glob("*.npy"), ".npy"):
        with doc.place(name):
            array = load_objects(file)
            read: list[Any] = array.tolist() if array.ndim == 1 else [None]
            if not all(isinstance(row, Mapping) and isinstance(row.get("qpos"), Mapping) for row in read):
                raise FileFormatError("not a DexGraspNet file (an array of dictionaries with qpos by joint name)")
            heads = [notes for row in read if (notes := mapping(row.get(KEY)))]
            for written in {int(number(notes["n_grasps"], "n_grasps")) for notes in heads if "n_grasps" in notes}:
                foreign.check_count(len(heads), written)
            noted += heads
            for row in read:
                with doc.place(f"grasp {len(rows)}"):
                    rows.append(_net_grasp(row, file.stem))
    return _document(rows, noted, assume, NET)


def _net_grasp(row: Mapping[str, Any], object_name: str) -> ForeignGrasp:
    qpos, notes = row["qpos"], mapping(mapping(row.get(KEY)).get("grasp"))
    scale = foreign.scale_of(row.get("scale", 1.0), "scale")
    from scipy.spatial.transform import Rotation  # only this format needs scipy for reading

    point, turn = ([number(qpos.get(name), name) for name in names] for names in (TRANSLATION, ROTATION))
    far = max(turn, key=abs)
    if abs(far) > 2 * np.pi:
        raise FileFormatError(f"WRJR has an angle of {far:g}, but angles are radians; this looks like degrees")
    X_hand_object = Pose(np.array(point), as_quat(Rotation.from_euler("xyz", turn))).inverse()
    angles = foreign.pick_joints(qpos, JOINTS, "qpos", numbering=0)
    posture = {name: -angle if name in REVERSED else angle for name, angle in angles.items()}
    changed = foreign.differ(X_hand_object, posture, mapping(notes.get("contact")))
    if notes and not changed:
        # It may say where the hand settled; a trial wants what was commanded and where the object was put.
        target, opened = (foreign.pick_joints(notes.get(name), JOINTS, f"noted {name}") for name in ANGLES)
        X_hand_object = foreign.noted_pose(mapping(notes.get("placed")))
        return ForeignGrasp(target, opened, X_hand_object, object_name, scale, notes=notes)
    return ForeignGrasp(posture, None, X_hand_object, object_name, scale, notes=notes, changed=changed)


# -- what both share


def _in_contact(
    document: GraspDocument, options: ExportOptions, what: str, conventions: dict[str, str]
) -> tuple[Grasps, dict[str, Any], list[dict[str, Any]]]:
    """Put hand and object where they settled, if a trial reached closing; with our notes on the file and each grasp."""
    grasps, outcomes = document.grasps, options.outcomes
    _check_shadow(grasps.hand, foreign.without_wrist(grasps, ("WRJ2", "WRJ1")), what)
    notes, contact, placed = doc.header(document) | {"conventions": conventions}, grasps, grasps.X_hand_object
    measured = np.zeros((len(grasps), 1), dtype=bool)
    if outcomes is not None and options.contact == "settled":
        settled, posture = outcomes.X_hand_object_settled, outcomes.settled_posture
        measured[:, 0] = np.isfinite(np.hstack([posture, settled.position_m])).all(axis=1)
        position, quat = (np.where(measured, getattr(settled, part), getattr(placed, part)) for part in doc.POSE_PARTS)
        posture = np.where(measured, posture, grasps.posture)
        contact = replace(grasps, posture=posture, X_hand_object=Pose(position, quat))
    each = foreign.grasp_notes(document)
    for i, row in enumerate(each):
        row |= {"contact_measured": bool(measured[i, 0]), "placed": doc.pose_to_json(placed, i)}
        # What the file's own fields say, so that a reader knows whether they were changed since.
        row["contact"] = doc.pose_to_json(contact.X_hand_object, i)
        row["contact"]["posture"] = doc.by_name(contact.joint_names, contact.posture[i])
    return contact, notes, each


def _document(
    rows: list[ForeignGrasp], noted: Sequence[Mapping[str, Any]], assume: Assumptions, what: str
) -> GraspDocument:
    hand = doc.hand_of(next(filter(None, noted), {}), assume.hand)
    _check_shadow(hand.name, hand.joint_names, what)
    return foreign.foreign_document(rows, noted, assume, hand)


def _check_shadow(hand: str, joint_names: Sequence[str], what: str) -> None:
    if not set(joint_names) & set(JOINTS):
        raise InputError(f"{what} files are of the Shadow Hand only, not of {hand}; use isaac_grasp or moveit_grasp")
    foreign.check_joints(joint_names, JOINTS, "shadow_hand_right")


def save_objects(path: Path, value: Any) -> None:
    """Write one object, or a list of them as a one-dimensional array, as `numpy.save` does.

    Numpy 2 pickles arrays under a module name that numpy before 1.26 does not have; the name that all versions have is
    written instead, since the tools that read these files run on old ones.
    """
    array = np.empty((len(value),) if isinstance(value, list) else (), dtype=object)
    array[...] = value
    data = pickle.dumps(array, protocol=3)  # the last in which a pickle names modules in plain text
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(array))
        file.write(data.replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n"))


def load_objects(path: Path) -> Any:
    """Read the array of objects; only for files whose source is trusted."""
    array_shape(path)
    damages = (pickle.UnpicklingError, ArithmeticError, AttributeError, EOFError, ImportError, LookupError)
    try:
        return np.load(path, allow_pickle=True)
    except (*damages, MemoryError, TypeError, ValueError) as error:
        raise FileFormatError(f"its pickled objects are damaged ({' '.join(str(error).split())})") from error


def array_shape(path: Path) -> tuple[int, ...]:
    """Read the shape of an array of objects from its header, which unpickles nothing."""
    try:
        with path.open("rb") as file:
            major, _ = np.lib.format.read_magic(file)
            read_header = np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
            shape, _, dtype = read_header(file)
    except (ValueError, EOFError, SyntaxError, TypeError) as error:
        raise FileFormatError(f"not an .npy file ({' '.join(str(error).split())})") from error
    if not dtype.hasobject:
        raise FileFormatError(f"an array of {dtype}, not of dictionaries")
    return tuple(shape)
