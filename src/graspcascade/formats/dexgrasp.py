"""DexGraspBench and DexGraspNet: the Shadow Hand's grasps as pickled dictionaries; reading one runs what it carries.

A DexGraspBench folder has ``graspdata/<object>/<grasp type>/<number>.npy`` and ``objects/<object>/``, a DexGraspNet one
``dataset/<object>.npy`` and ``meshdata/<object>/``; docs/formats.md says what is in them.
"""

from __future__ import annotations

import json
import pickle
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.errors import FileFormatError
from ..core.objects import GraspObject
from ..core.poses import Pose, as_quat, as_rotation
from ..worlds.meshes import object_mesh, write_obj
from . import foreign
from .document import GraspDocument, hand_of, mapping, number, numbers, place, pose_of, shortened
from .foreign import KEY, ForeignGrasp
from .options import Assumptions, ExportOptions, in_contact

JOINTS: tuple[str, ...] = tuple(
    f"{digit}J{joint}"
    for digit, joints in (("FF", 4), ("MF", 4), ("RF", 4), ("LF", 5), ("TH", 5))
    for joint in range(joints, 0, -1)
)
STATES = ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos")
_N = 7 + len(JOINTS)
_NOWHERE = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
X_HAND_BASE = Pose(np.array([0.0, 0.0, -0.034]), np.array([1.0, 0.0, 0.0, 0.0]))
BENCH_CONVENTIONS = {
    "qpos": "base xyz in metres, base quaternion wxyz, then angles in radians in the order of qpos_joint_names",
    "base frame": "34 mm below the palm body along the fingers (-z of the hand frame), same axes",
    "obj_pose": "object in the world, xyz in metres, quaternion wxyz",
    "pregrasp_qpos": "open hand",
    "grasp_qpos": "in contact, from a trial; where contact_measured is false, the target",
    "squeeze_qpos": "joint targets",
}


def write_bench(path: Path, document: GraspDocument, options: ExportOptions) -> None:
    """Fill a folder."""
    grasps = document.grasps
    foreign.check_shadow(grasps.hand, grasps.joint_names, JOINTS, "DexGraspBench")
    notes = foreign.file_notes(document, BENCH_CONVENTIONS) | {
        "qpos_joint_names": list(JOINTS),
        "n_grasps": len(grasps),
    }
    (contact, measured), world = in_contact(grasps, options), document.X_world_object or _NOWHERE
    base = world @ contact.X_hand_object.inverse() @ X_HAND_BASE
    columns = [grasps.joint_names.index(name) for name in JOINTS]
    states = dict(zip(STATES, (grasps.pregrasp, contact.posture, grasps.posture), strict=True))
    root, stems = options.object_root or "objects", foreign.file_stems(grasps.tasks)
    each = foreign.contact_notes(document, measured)
    for i, name in enumerate(grasps.object_name.tolist()):
        folder = path / "graspdata" / stems[name] / str(grasps.grasp_type[i])
        folder.mkdir(parents=True, exist_ok=True)
        row = {
            "obj_path": f"{root}/{stems[name]}",
            "obj_scale": 1.0,
            "obj_pose": np.concatenate([world.position_m, world.quat_wxyz]),
        }
        row |= {
            state: np.concatenate([base.position_m[i], base.quat_wxyz[i], angles[i, columns]])
            for state, angles in states.items()
        }
        save_objects(folder / _file_name(i), row | {KEY: notes | {"grasp": each[i]}})
    for name, obj in grasps.tasks.objects.items():
        _write_bench_object(path / "objects" / stems[name], obj)


def read_bench(path: Path, assume: Assumptions) -> GraspDocument:
    """Read one file, or all under a folder.

    The hand base of ``grasp_qpos`` counts, since the base of a trial does not move. In an export of ours, the object is
    back where it was placed before the trial.
    """
    whole = path / "graspdata"
    files = sorted((whole if whole.is_dir() else path).rglob("*.npy")) if path.is_dir() else [path]
    rows: list[ForeignGrasp] = []
    noted: list[Mapping[str, Any]] = []
    for file in files:
        with place(file.name):
            array = load_objects(file)
            row = array.item() if array.ndim == 0 else None
            if not isinstance(row, Mapping) or not {"grasp_qpos", "robot_pose"} & set(row):
                raise FileFormatError("not a DexGraspBench grasp (one dictionary with grasp_qpos or robot_pose)")
            rows.extend(_bench_grasps(row))
            noted.append(mapping(row.get(KEY)))
    if whole.is_dir():
        if not files:
            raise FileFormatError("graspdata holds no .npy files")
        _check_none_lost(noted)
    hand = hand_of(next(filter(None, noted), {}), assume.hand)
    foreign.check_shadow(hand.name, hand.joint_names, JOINTS, "DexGraspBench")
    return foreign.foreign_document(rows, noted, assume, hand)


def _check_none_lost(noted: list[Mapping[str, Any]]) -> None:
    """Check that an export's grasps are all there; files of others, or without a count, may lie beside them."""
    written = max(int(number(notes.get("n_grasps", 0), "n_grasps")) for notes in noted)
    rows = [mapping(notes.get("grasp")).get("number") for notes in noted]
    present = {i for i in rows if isinstance(i, int) and 0 <= i < written}
    if len(present) < written:
        first = next(i for i in range(written) if i not in present)
        raise FileFormatError(
            f"it has {len(present)} of the {written} grasps that were written; {_file_name(first)} is lost"
        )


def _bench_grasps(row: Mapping[str, Any]) -> Iterator[ForeignGrasp]:
    """Read the grasps of a dictionary, one or a batch."""
    states, order, X_hand_base = _states(row)
    n = len(states["grasp_qpos"])
    placed = _batch(row.get("obj_pose"), 7, "obj_pose")
    if len(placed) not in (1, n):
        raise FileFormatError(f"obj_pose is batched as {len(placed)} poses for {n} grasps")
    path = str(np.asarray(row.get("obj_path"), dtype=object).reshape(-1)[0]).rstrip("/")
    name = re.sub(r"(/mesh)?/[^/]+\.obj$", "", path).rsplit("/", 1)[-1]
    scale, notes = foreign.scale_of(row.get("obj_scale", 1.0), "obj_scale"), mapping(mapping(row.get(KEY)).get("grasp"))
    for i in range(n):
        base, obj = states["grasp_qpos"][i, :7], placed[i if len(placed) > 1 else 0]
        X_world_hand = pose_of(base[:3], base[3:], "hand base") @ X_hand_base.inverse()
        X_hand_object = X_world_hand.inverse() @ pose_of(obj[:3], obj[3:], "obj_pose")
        if "placed" in notes:
            X_hand_object = noted_pose(notes["placed"])
        opened, target = (
            dict(zip(order, states[state][i, 7:].tolist(), strict=True)) for state in (STATES[0], STATES[2])
        )
        yield ForeignGrasp(target, opened, X_hand_object, name, scale, notes=notes)


def _states(row: Mapping[str, Any]) -> tuple[dict[str, NDArray[np.float64]], Sequence[str], Pose]:
    """Read the three states ``(n, 29)`` of a dictionary, the order of their joints, and the base in the hand frame."""
    order: Sequence[str] = JOINTS
    X_hand_base = X_HAND_BASE
    given = {state: row.get(state, row.get("grasp_qpos")) for state in STATES}
    if "grasp_qpos" not in row:
        stages = np.asarray(row["robot_pose"])
        if stages.ndim == 4 and stages.shape[0] == 1 and stages.shape[2] >= 3:
            # As BODex writes it: the palm's own pose, and the thumb first.
            stages, order, X_hand_base = stages[0, :, :3], (*JOINTS[-5:], *JOINTS[:-5]), _NOWHERE
        if stages.ndim == 3 and stages.shape[1] == 3:
            given = {state: stages[:, i] for i, state in enumerate(STATES)}
        else:
            given = dict.fromkeys(STATES, stages)
    states = {state: _batch(value, _N, "robot_pose" if state not in row else state) for state, value in given.items()}
    if len({len(state) for state in states.values()}) > 1:
        lengths = ", ".join(f"{name} {len(state)}" for name, state in states.items())
        raise FileFormatError(f"its states are batched as different numbers of grasps: {lengths}")
    names = row.get("joint_names")
    if names is not None:
        listed = np.asarray(names, dtype=object).reshape(-1).tolist()
        places = foreign.pick_joints(
            dict(zip(map(str, listed), range(len(listed)), strict=True)), JOINTS, "joint_names"
        )
        order = sorted(JOINTS, key=lambda joint: places[joint])
    return states, order, X_hand_base


def _batch(value: object, width: int, what: str) -> NDArray[np.float64]:
    """Read one row of numbers ``(width,)``, or a batch ``(n, width)``, as a batch."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise FileFormatError(f"{what} is {shortened(value)}, not {width} numbers") from error
    if array.ndim > 2:
        raise FileFormatError(f"{what} is batched as {array.shape}; only ({width},) and (n, {width}) can be read")
    if array.ndim == 0 or array.shape[-1] != width:
        raise FileFormatError(f"{what} has {array.size} numbers; a Shadow Hand's has {width}, batched (n, {width})")
    rows = array.reshape(-1, width)
    for row in rows[~np.isfinite(rows).all(axis=1)][:1]:
        numbers(row, width, what)
    return rows


def noted_pose(notes: object) -> Pose:
    """Read a pose from our notes."""
    return pose_of(mapping(notes).get("position_m"), mapping(notes).get("quat_wxyz"), "noted pose")


def _file_name(row: int) -> str:
    return f"{row:06d}.npy"


def _write_bench_object(folder: Path, obj: GraspObject) -> None:
    mesh = object_mesh(obj)
    (folder / "info").mkdir(parents=True)
    (folder / "urdf" / "meshes").mkdir(parents=True)
    # The mesh's own volume: the benchmark sets a density so that the meshed object has a given mass.
    info = {"mass": float(mesh.volume), "density": 1.0, "scale": 1.0}
    (folder / "info" / "simplified.json").write_text(json.dumps(info, indent=1) + "\n", encoding="utf-8")
    write_obj(folder / "urdf" / "meshes" / "convex_piece_000.obj", mesh)


TRANSLATION: tuple[str, ...] = ("WRJTx", "WRJTy", "WRJTz")
ROTATION: tuple[str, ...] = ("WRJRx", "WRJRy", "WRJRz")
REVERSED: frozenset[str] = frozenset({"FFJ4", "MFJ4", "THJ2", "THJ1"})
"""Our joints that turn the other way in DexGraspNet's hand."""
NET_CONVENTIONS = {
    "qpos WRJT": "palm body in the object frame, metres",
    "qpos WRJR": "its rotation about the fixed axes x, then y, then z, radians (transforms3d 'sxyz')",
    "qpos robot0": "radians; numbered from 0, so FFJ3 is the FFJ4 of joint_names, with the sign of that hand model",
    "scale": "of the mesh, which is in metres",
}


def write_net(path: Path, document: GraspDocument, options: ExportOptions) -> None:
    """Write one object's grasps to a file, or to a folder a file for each object with its meshes."""
    tasks = document.grasps.tasks
    foreign.check_shadow(document.grasps.hand, document.grasps.joint_names, JOINTS, "DexGraspNet")
    rows = _dictionaries(document, options)
    if not path.is_dir():
        foreign.only_object(tasks, "a DexGraspNet")
        save_objects(path, rows)
        return
    (path / "dataset").mkdir()
    for name, stem in foreign.file_stems(tasks).items():
        mine = [row for row, other in zip(rows, tasks.object_name.tolist(), strict=True) if other == name]
        save_objects(path / "dataset" / f"{stem}.npy", mine)
        _write_net_object(path / "meshdata" / stem / "coacd", stem, tasks.objects[name])


def read_net(path: Path, assume: Assumptions) -> GraspDocument:
    """Read an object's file, whose name is the object's, or all of a folder.

    ``qpos`` of a foreign file is taken for the target, and the hand opens as in our own trials.
    """
    rows: list[ForeignGrasp] = []
    files: list[Mapping[str, Any]] = []
    folder = path / "dataset" if (path / "dataset").is_dir() else path
    for file in sorted(folder.glob("*.npy")) if path.is_dir() else [path]:
        for row in _rows(file):
            with place(f"grasp {len(rows)}"):
                rows.append(_net_grasp(row, file.stem))
            files.append(mapping(row.get(KEY)))
    hand = hand_of(next(filter(None, files), {}), assume.hand)
    foreign.check_shadow(hand.name, hand.joint_names, JOINTS, "DexGraspNet")
    return foreign.foreign_document(rows, files, assume, hand)


def _dictionaries(document: GraspDocument, options: ExportOptions) -> list[dict[str, Any]]:
    notes = foreign.file_notes(document, NET_CONVENTIONS)
    grasps = document.grasps
    contact, measured = in_contact(grasps, options)
    palm = contact.X_hand_object.inverse()
    turns = _euler(palm.quat_wxyz)
    rows = []
    for i, noted in enumerate(foreign.contact_notes(document, measured)):
        angles = dict(zip(grasps.joint_names, contact.posture[i].tolist(), strict=True))
        qpos = {
            f"robot0:{other}": -angles[name] if name in REVERSED else angles[name]
            for name, other in foreign.numbered(JOINTS, 0).items()
        }
        qpos |= dict(zip(ROTATION, turns[i].tolist(), strict=True))
        qpos |= dict(zip(TRANSLATION, palm.position_m[i].tolist(), strict=True))
        noted |= {
            name: dict(zip(grasps.joint_names, values[i].tolist(), strict=True))
            for name, values in (("posture", grasps.posture), ("pregrasp", grasps.pregrasp))
        }
        rows.append({"scale": 1.0, "qpos": qpos, KEY: notes | {"grasp": noted}})
    return rows


def _rows(file: Path) -> list[Mapping[str, Any]]:
    array = load_objects(file)
    rows = array.tolist() if array.ndim == 1 else None
    if rows is None or not all(isinstance(row, Mapping) and isinstance(row.get("qpos"), Mapping) for row in rows):
        raise FileFormatError("not a DexGraspNet file (an array of dictionaries with qpos by joint name)")
    return list(rows)


def _net_grasp(row: Mapping[str, Any], object_name: str) -> ForeignGrasp:
    qpos, notes = row["qpos"], mapping(mapping(row.get(KEY)).get("grasp"))
    scale = foreign.scale_of(row.get("scale", 1.0), "scale")
    if notes:
        # It may say where the hand settled; a trial wants what was commanded and where the object was put.
        target, opened = (
            foreign.pick_joints(notes.get(name), JOINTS, f"noted {name}") for name in ("posture", "pregrasp")
        )
        return ForeignGrasp(target, opened, noted_pose(notes.get("placed")), object_name, scale, notes=notes)
    # Only this format needs scipy for reading.
    from scipy.spatial.transform import Rotation

    turn = as_quat(Rotation.from_euler("xyz", [number(qpos.get(name), name) for name in ROTATION]))
    palm = Pose(np.array([number(qpos.get(name), name) for name in TRANSLATION]), turn)
    angles = foreign.pick_joints(qpos, JOINTS, "qpos", numbering=0)
    posture = {name: -angle if name in REVERSED else angle for name, angle in angles.items()}
    return ForeignGrasp(posture, None, palm.inverse(), object_name, scale)


def _euler(quat_wxyz: NDArray[np.float64]) -> NDArray[np.float64]:
    with warnings.catch_warnings():
        # At a pitch of 90 degrees roll and yaw are one; scipy says so and sets one to zero, which is as good as any.
        warnings.simplefilter("ignore", UserWarning)
        return np.asarray(as_rotation(quat_wxyz).as_euler("xyz"))


def _write_net_object(folder: Path, stem: str, obj: GraspObject) -> None:
    mesh = object_mesh(obj)
    folder.mkdir(parents=True)
    for name in ("decomposed.obj", "coacd_convex_piece_0.obj"):
        write_obj(folder / name, mesh)
    shape = '<geometry><mesh filename="coacd_convex_piece_0.obj" scale="1 1 1"/></geometry>'
    (folder / "coacd.urdf").write_text(
        f'<?xml version="1.0"?>\n<robot name="{stem}">\n <link name="{stem}">\n'
        f"  <visual>{shape}</visual>\n  <collision>{shape}</collision>\n </link>\n</robot>\n",
        encoding="utf-8",
    )


_PROTOCOL = 3
"""The last in which a pickle names modules in plain text, which `save_objects` relies on."""


def save_objects(path: Path, value: Any) -> None:
    """Write one object, or a list of them as a one-dimensional array, as `numpy.save` does.

    Numpy 2 pickles arrays under a module name that numpy before 1.26 does not have; the name that all versions have is
    written instead, since the tools that read these files run on old ones.
    """
    array = np.empty((len(value),) if isinstance(value, list) else (), dtype=object)
    array[...] = value
    data = pickle.dumps(array, protocol=_PROTOCOL).replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n")
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(array))
        file.write(data)


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
        raise FileFormatError(f"{path.name} is not an .npy file ({' '.join(str(error).split())})") from error
    if not dtype.hasobject:
        raise FileFormatError(f"{path.name} is an array of {dtype}, not of dictionaries")
    return tuple(shape)
