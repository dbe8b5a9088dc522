"""Formats of others: frames and orders against raw file contents, round trips, trust, and what is not sound."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import CATALOGUE
from graspcascade.core.outcomes import VERDICTS, Outcomes
from graspcascade.core.poses import Pose, canonical_quat, rotation_angle
from graspcascade.core.protocols import PAPER, Carry, Close, Protocol, Shake
from graspcascade.core.tasks import Task, Tasks
from graspcascade.engines import run_trials
from graspcascade.formats import (
    FORMATS_BY_NAME,
    Assumptions,
    ExportOptions,
    held_rates,
    load_document,
    load_grasps,
    save_grasps,
)
from graspcascade.formats.dexgrasp import JOINTS
from graspcascade.hands import Hand
from graspcascade.studies.record import Cell, Evaluation

TARGET = ExportOptions(contact="target")
METADATA = {"model": "model3", "seed": 7}
WORLD = Pose.of([0.5, -0.2, 0.1], [0.5, -0.5, 0.5, 0.5])
FOREIGN = {
    "isaac_grasp": "folder",
    "moveit_grasp": "grasps.yaml",
    "dexgraspbench": "folder",
    "dexgraspnet": "folder",
}
every_foreign = pytest.mark.parametrize("name", list(FOREIGN))
every_yaml = pytest.mark.parametrize("name", ["isaac_grasp", "moveit_grasp"])

Array = np.ndarray[Any, np.dtype[np.float64]]


@pytest.fixture
def grasps(drawn: Grasps) -> Grasps:
    return drawn[[0, 20, 40, 53]]


@pytest.fixture
def one_object(drawn: Grasps) -> Grasps:
    return drawn[drawn.object_name == "box_medium"]


def save(folder: Path, name: str, grasps: Grasps, **more: Any) -> Path:
    path = folder / FOREIGN[name]
    options = more.pop("options", ExportOptions())
    if options.outcomes is None:
        options = replace(options, contact="target")
    save_grasps(path, grasps, metadata=METADATA, format=name, options=options, **more)
    return path


def assert_close(found: Grasps, expected: Grasps) -> None:
    assert (found.hand, found.joint_names) == (expected.hand, expected.joint_names)
    assert found.tasks.same_as(expected.tasks)
    for name in ("posture", "pregrasp", "position_m", "grasp_size_m", "object_size_m", "probability"):
        np.testing.assert_allclose(found.columns()[name], expected.columns()[name], atol=1e-13, err_msg=name)
    assert rotation_angle(found.X_hand_object.quat_wxyz, expected.X_hand_object.quat_wxyz).max(initial=0) < 1e-7


def matrix(position_m: Any, quat_wxyz: Any) -> Array:
    w, x, y, z = quat_wxyz
    found = np.eye(4)
    found[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
    found[:3, 3] = position_m
    return found


def hand_object(grasps: Grasps, row: int) -> Array:
    return matrix(grasps.X_hand_object.position_m[row], grasps.X_hand_object.quat_wxyz[row])


# -- the registry


def test_every_format_can_be_listed_from_data_alone() -> None:
    assert list(FORMATS_BY_NAME) == ["json", "parquet", *FOREIGN]
    for name, found in FORMATS_BY_NAME.items():
        assert found.name == name
        assert found.missing == ()
        assert found.pickled == (found.suffixes == (".npy",))
        assert found.contact == (name in ("dexgraspbench", "dexgraspnet"))


def test_an_unknown_format_is_answered_with_the_nearest(grasps: Grasps, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Did you mean 'isaac_grasp'"):
        save_grasps(tmp_path / "g.yaml", grasps, metadata={}, format="isac_grasp")
    with pytest.raises(InputError, match="Did you mean 'dexgraspnet'"):
        load_grasps(tmp_path / "g.npy", "dexgrasnet")


def test_a_suffix_of_several_formats_needs_a_name_and_a_name_its_suffix(grasps: Grasps, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="isaac_grasp, moveit_grasp"):
        save_grasps(tmp_path / "g.yaml", grasps, metadata={})
    with pytest.raises(InputError, match=r"named \.yaml or \.yml"):
        save_grasps(tmp_path / "g.json", grasps, metadata={}, format="moveit_grasp")
    with pytest.raises(InputError, match="is a folder"):
        save_grasps(tmp_path / "g.npy", grasps, metadata={}, format="dexgraspbench")
    assert list(tmp_path.iterdir()) == []


def test_formats_of_one_object_a_file_say_so(grasps: Grasps, tmp_path: Path) -> None:
    for name, suffix in (("isaac_grasp", ".yaml"), ("dexgraspnet", ".npy")):
        with pytest.raises(InputError, match=r"one object.*without suffix"):
            save_grasps(tmp_path / f"g{suffix}", grasps, metadata={}, format=name, options=TARGET)
    assert list(tmp_path.iterdir()) == []


def test_exports_load_neither_the_engine_nor_yaml_before_they_are_asked_to() -> None:
    code = (
        "import sys; import graspcascade.formats; print([m for m in ('mujoco', 'yaml', 'torch') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"


# -- round trips


@every_foreign
@pytest.mark.parametrize("placed", [None, WORLD])
def test_an_export_reads_back(grasps: Grasps, tmp_path: Path, name: str, placed: Pose | None) -> None:
    path = save(tmp_path, name, grasps, X_world_object=placed)
    found = load_document(path, trust_pickle=True)
    assert_close(found.grasps, grasps)
    assert found.metadata == METADATA
    assert (found.X_world_object is None) == (placed is None)


@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(list(FOREIGN)))
def test_any_grasps_read_back(
    drawn: Grasps, hand: Hand, tmp_path_factory: pytest.TempPathFactory, seed: int, name: str
) -> None:
    rng = np.random.default_rng(seed)
    grasps = drawn[rng.integers(len(drawn), size=3)]
    changed = replace(
        grasps,
        posture=hand.clip(rng.normal(size=grasps.posture.shape)),
        pregrasp=hand.clip(rng.normal(size=grasps.posture.shape)),
        X_hand_object=Pose(rng.uniform(-0.5, 0.5, (3, 3)), canonical_quat(rng.normal(size=(3, 4)))),
        probability=np.where(rng.uniform(size=3) < 0.5, np.nan, rng.uniform(size=3)),
    )
    placed = Pose.of(rng.normal(size=3), canonical_quat(rng.normal(size=4))) if rng.uniform() < 0.5 else None
    options = ExportOptions(
        joint_prefix=str(rng.choice(["", "rh_"])),
        parent_link=["palm", "forearm"][seed % 2],
        joint_numbering=seed // 2 % 2,
        frame_keys=["frame", "frame_link"][seed // 4 % 2],
        frame_id=["", None][seed // 8 % 2],
    )
    path = save(tmp_path_factory.mktemp("any"), name, changed, X_world_object=placed, options=options)
    assert_close(load_grasps(path, trust_pickle=True), changed)


@pytest.mark.parametrize(("name", "file"), [("isaac_grasp", "box_medium.yaml"), ("dexgraspnet", "box_medium.npy")])
def test_one_object_is_a_file(one_object: Grasps, tmp_path: Path, name: str, file: str) -> None:
    save_grasps(tmp_path / file, one_object, metadata=METADATA, format=name, options=TARGET)
    assert_close(load_grasps(tmp_path / file, trust_pickle=True), one_object)


@every_foreign
def test_a_trial_of_the_imported_file_gives_the_same_verdicts(
    drawn: Grasps, outcomes: Outcomes, short: Protocol, tmp_path: Path, name: str
) -> None:
    held = np.flatnonzero(outcomes.held)
    rows = [int(held[0]), int(held[-1]), int(np.flatnonzero(~outcomes.held)[0])]
    path = save(tmp_path, name, drawn[rows], options=ExportOptions(outcomes=outcomes[rows]))
    again = run_trials(load_grasps(path, trust_pickle=True), short)
    np.testing.assert_array_equal(again.verdict, outcomes.verdict[rows])


# -- isaac_grasp


@pytest.mark.parametrize("suffix", [".yml", ".YAML"])
def test_a_folder_of_isaac_files_is_known_by_any_of_their_suffixes(grasps: Grasps, tmp_path: Path, suffix: str) -> None:
    folder = save(tmp_path, "isaac_grasp", grasps)
    for file in list(folder.iterdir()):
        file.rename(file.with_suffix(suffix))
    assert_close(load_grasps(folder), grasps)


def test_isaac_poses_are_of_the_palm_in_the_object_frame(one_object: Grasps, tmp_path: Path) -> None:
    save_grasps(tmp_path / "g.yaml", one_object, metadata={}, format="isaac_grasp")
    data = yaml.safe_load((tmp_path / "g.yaml").read_text())
    assert (data["format"], data["format_version"]) == ("isaac_grasp", 1.0)
    assert (data["object_frame"], data["gripper_frame"]) == ("box_medium", "palm")
    assert list(data["grasps"]) == [f"grasp_{i}" for i in range(len(one_object))]
    for i, row in enumerate(data["grasps"].values()):
        assert set(row) == {
            "confidence",
            "position",
            "orientation",
            "cspace_position",
            "pregrasp_cspace_position",
        }
        assert data["object_scale"] == 1.0
        gripper = matrix(row["position"], [row["orientation"]["w"], *row["orientation"]["xyz"]])
        np.testing.assert_allclose(gripper @ hand_object(one_object, i), np.eye(4), atol=1e-12)
        assert row["cspace_position"]["THJ4"] == one_object.posture[i, one_object.joint_names.index("THJ4")]
        assert row["pregrasp_cspace_position"] == dict(
            zip(one_object.joint_names, one_object.pregrasp[i].tolist(), strict=True)
        )


def evaluation(held: int) -> Evaluation:
    verdicts = dict.fromkeys(VERDICTS, 0) | {"held": held, "dropped": 10 - held}
    cell = Cell(verdicts, 0, "tripod", "box_medium")
    return Evaluation(PAPER, "m", "h", (cell,), 0, 10, {}, {})


@every_yaml
def test_confidence_is_the_grasps_own_then_the_measured_rate_then_zero(
    one_object: Grasps, tmp_path: Path, name: str
) -> None:
    grasps = one_object[:3]
    grasps = replace(
        grasps,
        tasks=Tasks.of(Task.of(kind, "box_medium", "x") for kind in ("tripod", "tripod", "tip_pinch")),
        probability=np.array([0.25, np.nan, np.nan]),
    )
    options = ExportOptions(held_rates=held_rates(evaluation(7)))
    save_grasps(tmp_path / "g.yaml", grasps, metadata={}, format=name, options=options)
    rows = yaml.safe_load((tmp_path / "g.yaml").read_text())["grasps"]
    found = [row.get("confidence", row.get("grasp_quality")) for row in (rows.values() if name[0] == "i" else rows)]
    assert found == [0.25, 0.7, 0.0]
    # A rate of many is not a probability of its own when the file is read back.
    np.testing.assert_array_equal(load_grasps(tmp_path / "g.yaml").probability, [0.25, np.nan, np.nan])


@pytest.mark.parametrize(
    "bad",
    [
        {"held_rates": {("tripod", "box_medium"): 1.5}},
        {"parent_link": "elbow"},
        {"joint_prefix": "lh_"},
        {"joint_numbering": 2},
        {"contact": "soft"},
        {"frame_keys": "link"},
    ],
)
def test_options_that_make_no_sense_are_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        ExportOptions(**bad)


# -- moveit_msgs/Grasp

MESSAGE_FIELDS = {
    "id": str,
    "pre_grasp_posture": dict,
    "grasp_posture": dict,
    "grasp_pose": dict,
    "grasp_quality": float,
    "pre_grasp_approach": dict,
    "post_grasp_retreat": dict,
    "post_place_retreat": dict,
    "max_contact_force": float,
    "allowed_touch_objects": list,
}


@pytest.mark.parametrize("parent", ["forearm", "palm"])
@pytest.mark.parametrize("placed", [None, WORLD])
def test_moveit_messages_have_the_fields_and_the_parent_links_pose(
    grasps: Grasps, hand: Hand, tmp_path: Path, parent: str, placed: Pose | None
) -> None:
    options = ExportOptions(parent_link=parent, joint_prefix="rh_")  # type: ignore[arg-type]
    path = save(tmp_path, "moveit_grasp", grasps, X_world_object=placed, options=options)
    data = yaml.safe_load(path.read_text())
    assert data["parent_link"] == f"rh_{parent}"
    forearm = matrix(hand.X_base_hand.position_m, hand.X_base_hand.quat_wxyz)
    for i, row in enumerate(data["grasps"]):
        assert {name: type(value) for name, value in row.items()} == MESSAGE_FIELDS
        pose = row["grasp_pose"]["pose"]
        link = matrix([pose["position"][k] for k in "xyz"], [pose["orientation"][k] for k in "wxyz"])
        frame = np.eye(4) if placed is None else matrix(placed.position_m, placed.quat_wxyz)
        palm = link @ (forearm if parent == "forearm" else np.eye(4))
        np.testing.assert_allclose(palm @ hand_object(grasps, i), frame, atol=1e-9)
        label = str(grasps.object_name[i])
        assert row["grasp_pose"]["header"]["frame_id"] == (label if placed is None else "world")
        assert row["allowed_touch_objects"] == [label]
        for what, angles in (("grasp_posture", grasps.posture), ("pre_grasp_posture", grasps.pregrasp)):
            names, point = row[what]["joint_names"], row[what]["points"][0]
            named = dict(zip(names, point["positions"], strict=True))
            assert named.pop("rh_WRJ1", 0.0) == named.pop("rh_WRJ2", 0.0) == 0.0
            assert named == {f"rh_{j}": angles[i, k] for k, j in enumerate(grasps.joint_names)}
            assert set(point) == {"positions", "velocities", "accelerations", "effort", "time_from_start"}
        assert len(names) == (24 if parent == "forearm" else 22)


def test_moveit_retreats_upwards_where_up_is_known(grasps: Grasps, tmp_path: Path) -> None:
    path = save(tmp_path, "moveit_grasp", grasps[:1], X_world_object=WORLD, options=ExportOptions(frame_id="map"))
    row = yaml.safe_load(path.read_text())["grasps"][0]
    retreat = row["post_grasp_retreat"]["direction"]
    assert (retreat["header"]["frame_id"], retreat["vector"]) == ("map", {"x": 0.0, "y": 0.0, "z": 1.0})
    approach = row["pre_grasp_approach"]["direction"]
    assert (approach["header"]["frame_id"], approach["vector"]) == ("forearm", {"x": 0.0, "y": -1.0, "z": 0.0})
    assert row["post_place_retreat"]["direction"]["vector"] == {"x": 0.0, "y": 1.0, "z": 0.0}
    path = save(tmp_path, "moveit_grasp", grasps[:1])
    retreat = yaml.safe_load(path.read_text())["grasps"][0]["post_grasp_retreat"]["direction"]
    assert (retreat["header"]["frame_id"], retreat["vector"]) == ("forearm", {"x": 0.0, "y": 1.0, "z": 0.0})
    assert load_grasps(path).object_name[0] == grasps.object_name[0]


def test_the_pregrasp_is_free_along_the_approach(drawn: Grasps, short: Protocol) -> None:
    back = drawn.X_hand_object.position_m + np.array([0.0, -0.03, 0.0])
    away = replace(drawn, X_hand_object=Pose(back, drawn.X_hand_object.quat_wxyz))
    brief = replace(short, phases=(Close(), Shake(), Carry(0.02)))
    nearer = run_trials(drawn, brief).verdict == "overlap"
    assert not ((run_trials(away, brief).verdict == "overlap") & ~nearer).any()


# -- DexGraspBench


def bench_rows(folder: Path) -> list[dict[str, Any]]:
    files = sorted((folder / "graspdata").rglob("*.npy"), key=lambda file: file.name)
    return [np.load(file, allow_pickle=True).item() for file in files]


def test_dexgraspbench_order_is_finger_by_finger_from_the_spread() -> None:
    assert " ".join(JOINTS) == (
        "FFJ4 FFJ3 FFJ2 FFJ1 MFJ4 MFJ3 MFJ2 MFJ1 RFJ4 RFJ3 RFJ2 RFJ1 LFJ5 LFJ4 LFJ3 LFJ2 LFJ1 THJ5 THJ4 THJ3 THJ2 THJ1"
    )


def test_dexgraspbench_is_right_whatever_order_the_grasps_have(grasps: Grasps, tmp_path: Path) -> None:
    turned = replace(
        grasps,
        joint_names=grasps.joint_names[::-1],
        posture=grasps.posture[:, ::-1],
        pregrasp=grasps.pregrasp[:, ::-1],
    )
    for name in FOREIGN:
        (tmp_path / name).mkdir()
        assert_close(load_grasps(save(tmp_path / name, name, turned), trust_pickle=True), grasps)
    for i, row in enumerate(bench_rows(tmp_path / "dexgraspbench" / "folder")):
        expected = [grasps.posture[i, grasps.joint_names.index(joint)] for joint in JOINTS]
        np.testing.assert_array_equal(row["squeeze_qpos"][7:], expected)


@pytest.mark.parametrize("placed", [None, WORLD])
def test_dexgraspbench_base_is_34_mm_below_the_palm(grasps: Grasps, tmp_path: Path, placed: Pose | None) -> None:
    folder = save(tmp_path, "dexgraspbench", grasps, X_world_object=placed)
    world = np.eye(4) if placed is None else matrix(placed.position_m, placed.quat_wxyz)
    palm = matrix([0.0, 0.0, 0.034], [1.0, 0.0, 0.0, 0.0])
    for i, row in enumerate(bench_rows(folder)):
        assert {key: np.shape(row[key]) for key in row if key.endswith(("qpos", "obj_pose"))} == {
            "obj_pose": (7,),
            "pregrasp_qpos": (29,),
            "grasp_qpos": (29,),
            "squeeze_qpos": (29,),
        }
        np.testing.assert_allclose(matrix(row["obj_pose"][:3], row["obj_pose"][3:]), world, atol=1e-12)
        for name in ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos"):
            base = matrix(row[name][:3], row[name][3:7])
            np.testing.assert_allclose(base @ palm @ hand_object(grasps, i), world, atol=1e-12)
        assert row["obj_scale"] == 1.0
        assert Path(row["obj_path"]) == folder / "objects" / str(grasps.object_name[i])


def test_dexgraspbench_grasp_is_the_contact_of_a_trial(drawn: Grasps, outcomes: Outcomes, tmp_path: Path) -> None:
    closed = np.flatnonzero(outcomes.held)[:2]
    overlapping = np.flatnonzero(np.isnan(outcomes.settled_posture).any(axis=1))[:1]
    rows = np.concatenate([closed, overlapping])
    folder = save(tmp_path, "dexgraspbench", drawn[rows], options=ExportOptions(outcomes=outcomes[rows]))
    columns = [drawn.joint_names.index(joint) for joint in JOINTS]
    for i, row in zip(rows, bench_rows(folder), strict=True):
        settled = i in closed
        angles = outcomes.settled_posture if settled else drawn.posture
        pose = outcomes.X_hand_object_settled if settled else drawn.X_hand_object
        np.testing.assert_array_equal(row["grasp_qpos"][7:], angles[i, columns])
        np.testing.assert_array_equal(row["squeeze_qpos"][7:], drawn.posture[i, columns])
        palm = matrix(row["grasp_qpos"][:3], row["grasp_qpos"][3:7]) @ matrix([0, 0, 0.034], [1, 0, 0, 0])
        np.testing.assert_allclose(palm @ matrix(pose.position_m[i], pose.quat_wxyz[i]), np.eye(4), atol=1e-12)
        assert row["graspcascade"]["grasp"]["contact_measured"] == settled
    assert_close(load_grasps(folder, trust_pickle=True), drawn[rows])


def test_outcomes_of_other_grasps_are_refused(grasps: Grasps, outcomes: Outcomes, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="54 outcomes for 4 grasps"):
        save(tmp_path, "dexgraspbench", grasps, options=ExportOptions(outcomes=outcomes))


def test_object_root_names_objects_where_the_benchmark_runs(grasps: Grasps, tmp_path: Path) -> None:
    folder = save(tmp_path, "dexgraspbench", grasps, options=ExportOptions(object_root="assets/object/ours"))
    assert {row["obj_path"] for row in bench_rows(folder)} == {
        f"assets/object/ours/{label}" for label in grasps.object_name.tolist()
    }


def test_one_file_of_a_dexgraspbench_folder_reads_alone(grasps: Grasps, tmp_path: Path) -> None:
    file = next((save(tmp_path, "dexgraspbench", grasps) / "graspdata").rglob("000002.npy"))
    assert_close(load_grasps(file, trust_pickle=True), grasps[2])


@pytest.mark.parametrize("lost", [0, 2, 3])
def test_a_lost_file_of_a_dexgraspbench_folder_is_named(grasps: Grasps, tmp_path: Path, lost: int) -> None:
    folder = save(tmp_path, "dexgraspbench", grasps)
    next((folder / "graspdata").rglob(f"00000{lost}.npy")).unlink()
    with pytest.raises(FileFormatError, match=f"3 of the 4 grasps that were written; 00000{lost}.npy is lost"):
        load_grasps(folder, trust_pickle=True)


def test_a_dexgraspbench_folder_that_lost_all_its_files_is_refused(grasps: Grasps, tmp_path: Path) -> None:
    folder = save(tmp_path, "dexgraspbench", grasps)
    for file in list((folder / "graspdata").rglob("*.npy")):
        file.unlink()
    with pytest.raises(FileFormatError, match=r"no \.npy files"):
        load_grasps(folder, trust_pickle=True)


def test_a_part_of_a_dexgraspbench_folder_is_read_for_what_it_is(grasps: Grasps, tmp_path: Path) -> None:
    data = save(tmp_path, "dexgraspbench", grasps) / "graspdata"
    part = data / str(grasps.object_name[1])
    rows = np.flatnonzero(grasps.object_name == grasps.object_name[1])
    assert_close(load_grasps(part, "dexgraspbench", trust_pickle=True), grasps[rows])


def test_a_dexgraspbench_folder_may_hold_files_that_tell_no_count(grasps: Grasps, tmp_path: Path) -> None:
    folder = save(tmp_path, "dexgraspbench", grasps)
    files = sorted((folder / "graspdata").rglob("*.npy"), key=lambda file: file.name)
    for file in files:
        row = np.load(file, allow_pickle=True).item()
        del row["graspcascade"]["n_grasps"]
        np.save(file, np.array(row, dtype=object), allow_pickle=True)
    assert_close(load_grasps(folder, trust_pickle=True), grasps)
    files[3].unlink()
    assert_close(load_grasps(folder, trust_pickle=True), grasps[:3])


def test_the_target_stands_for_the_contact_in_dexgraspbench_files_of_others(grasps: Grasps, tmp_path: Path) -> None:
    row = bench_rows(save(tmp_path, "dexgraspbench", grasps))[0]
    del row["graspcascade"]
    row = {key: value.astype(np.float32) if isinstance(value, np.ndarray) else value for key, value in row.items()}
    np.save(tmp_path / "theirs.npy", np.array(row, dtype=object), allow_pickle=True)
    assume = Assumptions(grasp_type=str(grasps.grasp_type[0]))
    found = load_grasps(tmp_path / "theirs.npy", trust_pickle=True, assume=assume)
    np.testing.assert_allclose(found.posture, grasps.posture[:1], atol=1e-6)
    np.testing.assert_allclose(found.X_hand_object.position_m, grasps.X_hand_object.position_m[:1], atol=1e-6)
    assert found.object_name[0] == grasps.object_name[0]


# -- DexGraspNet

# The palm's tree in DexGraspNet's shadow_hand_wrist_free.xml: body, parent, position, quaternion wxyz, joint, axis.
NET_TREE = [
    *(
        row
        for finger, base in (("ff", (0.033, 0, 0.095)), ("mf", (0.011, 0, 0.099)), ("rf", (-0.011, 0, 0.095)))
        for row in ((f"{finger}knuckle", "palm", base, None, 3, (0, 1, 0)),)
    ),
    ("lfmetacarpal", "palm", (-0.017, 0, 0.044), None, 4, (0.570977, 0, 0.820966)),
    ("lfknuckle", "lfmetacarpal", (-0.017, 0, 0.044), None, 3, (0, 1, 0)),
    *(
        row
        for finger in ("ff", "mf", "rf", "lf")
        for row in (
            (f"{finger}proximal", f"{finger}knuckle", (0, 0, 0), None, 2, (1, 0, 0)),
            (f"{finger}middle", f"{finger}proximal", (0, 0, 0.045), None, 1, (1, 0, 0)),
            (f"{finger}distal", f"{finger}middle", (0, 0, 0.025), None, 0, (1, 0, 0)),
        )
    ),
    ("thbase", "palm", (0.034, -0.009, 0.029), (0.923956, 0, 0.382499, 0), 4, (0, 0, -1)),
    ("thproximal", "thbase", (0, 0, 0), None, 3, (1, 0, 0)),
    ("thhub", "thproximal", (0, 0, 0.038), None, 2, (1, 0, 0)),
    ("thmiddle", "thhub", (0, 0, 0), None, 1, (0, 1, 0)),
    ("thdistal", "thmiddle", (0, 0, 0.032), None, 0, (0, 1, 0)),
]
NET_TIPS = {"thumb": "thdistal", "index": "ffdistal", "middle": "mfdistal", "ring": "rfdistal", "little": "lfdistal"}


def net_tips(qpos: dict[str, float]) -> dict[str, Array]:
    """Place DexGraspNet's fingertips in the object frame by its own tree and Euler angles."""
    rx, ry, rz = (qpos[f"WRJR{k}"] for k in "xyz")
    about = [Rotation.from_rotvec(v).as_matrix() for v in ([rx, 0, 0], [0, ry, 0], [0, 0, rz])]
    palm = np.eye(4)
    palm[:3, :3] = about[2] @ about[1] @ about[0]
    palm[:3, 3] = [qpos[f"WRJT{k}"] for k in "xyz"]
    frames = {"palm": palm}
    for body, parent, position, quat, number, axis in NET_TREE:
        turn = np.eye(4)
        angle = qpos[f"robot0:{body[:2].upper()}J{number}"]
        unit = np.array(axis) / np.linalg.norm(axis)
        turn[:3, :3] = Rotation.from_rotvec(angle * unit).as_matrix()
        frames[body] = frames[parent] @ matrix(position, quat or (1, 0, 0, 0)) @ turn
    heights = {"thumb": 0.0275}
    return {d: (frames[body] @ [0, 0, heights.get(d, 0.026), 1])[:3] for d, body in NET_TIPS.items()}


def test_dexgraspnet_angles_and_pose_put_its_own_hand_where_ours_is(drawn: Grasps, hand: Hand, tmp_path: Path) -> None:
    folder = save(tmp_path, "dexgraspnet", drawn)
    ours = hand.tips(drawn.posture, list(NET_TIPS))
    for file in sorted((folder / "dataset").glob("*.npy")):
        rows = np.load(file, allow_pickle=True)
        numbers = np.flatnonzero(drawn.object_name == file.stem)
        assert rows.shape == (len(numbers),)
        for i, row in zip(numbers, rows, strict=True):
            assert row["scale"] == 1.0
            assert len(row["qpos"]) == 28
            to_object = np.linalg.inv(hand_object(drawn, i))
            for digit, point in net_tips(row["qpos"]).items():
                expected = (to_object @ [*ours[digit][i], 1])[:3]
                # The two models differ by up to 2 mm in the little finger's and the thumb's mounts.
                assert np.linalg.norm(point - expected) < 0.003, digit


def test_dexgraspnet_survives_a_pitch_of_a_right_angle(one_object: Grasps, tmp_path: Path) -> None:
    quat = canonical_quat([[np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]] * len(one_object))
    turned = replace(one_object, X_hand_object=Pose(one_object.X_hand_object.position_m, quat))
    save_grasps(tmp_path / "g.npy", turned, metadata={}, format="dexgraspnet", options=TARGET)
    for i, row in enumerate(np.load(tmp_path / "g.npy", allow_pickle=True)):
        rotation = Rotation.from_euler("xyz", [row["qpos"][f"WRJR{k}"] for k in "xyz"]).as_matrix()
        np.testing.assert_allclose(rotation @ hand_object(turned, i)[:3, :3], np.eye(3), atol=1e-7)


def test_dexgraspnet_files_of_others_need_a_type_and_a_catalogue_object(one_object: Grasps, tmp_path: Path) -> None:
    save_grasps(tmp_path / "ours.npy", one_object, metadata={}, format="dexgraspnet", options=TARGET)
    rows = [{k: row[k] for k in ("scale", "qpos")} for row in np.load(tmp_path / "ours.npy", allow_pickle=True)]
    theirs = tmp_path / "core-mug-85.npy"
    np.save(theirs, np.array(rows, dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="grasp type"):
        load_grasps(theirs, trust_pickle=True)
    with pytest.raises(InputError, match=r"unknown object 'core-mug-85'.*give --object"):
        load_grasps(theirs, trust_pickle=True, assume=Assumptions("tripod"))
    found = load_grasps(theirs, trust_pickle=True, assume=Assumptions("tripod", "box_medium", "x"))
    np.testing.assert_allclose(found.posture, one_object.posture, atol=1e-12)
    np.testing.assert_allclose(found.X_hand_object.position_m, one_object.X_hand_object.position_m, atol=1e-12)
    np.testing.assert_allclose(found.pregrasp, one_object.pregrasp)
    assert set(found.side_axis) == {"x"}
    for row in rows:
        row["scale"] = 0.08
    np.save(theirs, np.array(rows, dtype=object), allow_pickle=True)
    # What the user says it is has the size they say.
    found = load_grasps(theirs, trust_pickle=True, assume=Assumptions("tripod", "sphere:40mm"))
    assert list(found.tasks.objects) == ["sphere:40mm"]


def test_the_side_of_a_foreign_grasp_is_the_one_along_the_opposition(drawn: Grasps, hand: Hand, tmp_path: Path) -> None:
    path = save(tmp_path, "moveit_grasp", drawn)
    data = yaml.safe_load(path.read_text())
    for row in data["graspcascade"]["grasps"]:
        for name in ("side_axis", "side_m", "grasp_size_m"):
            del row[name]
    path.write_text(yaml.safe_dump(data))
    found = load_grasps(path)
    np.testing.assert_array_equal(found.side_axis, drawn.side_axis)
    np.testing.assert_array_equal(found.side_m, drawn.side_m)
    np.testing.assert_allclose(found.grasp_size_m, hand.grasp_size(drawn.posture))


# -- trust


class _Mark:
    """Leave a mark when unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return (Path.touch, (self.path,))


@pytest.mark.parametrize("value", ["one", "list"])
def test_pickled_code_runs_only_when_trusted(tmp_path: Path, value: str) -> None:
    mark = _Mark(tmp_path / "ran")
    array = np.array(mark if value == "one" else [mark], dtype=object)
    np.save(tmp_path / "evil.npy", array, allow_pickle=True)
    for name in (None, "dexgraspbench", "dexgraspnet"):
        with pytest.raises(InputError, match=r"runs whatever code.*trust_pickle=True.*--trust-pickle"):
            load_grasps(tmp_path / "evil.npy", name)
    assert not (tmp_path / "ran").exists()
    with pytest.raises(FileFormatError):
        load_grasps(tmp_path / "evil.npy", trust_pickle=True)
    assert (tmp_path / "ran").exists()


def test_yaml_makes_plain_data_only(tmp_path: Path) -> None:
    (tmp_path / "evil.yaml").write_text(
        f"format: isaac_grasp\nx: !!python/object/apply:pathlib.Path.touch [{tmp_path}/ran]\n"
    )
    with pytest.raises(FileFormatError, match="the YAML tag"):
        load_grasps(tmp_path / "evil.yaml")
    assert not (tmp_path / "ran").exists()


def test_pickles_name_numpy_as_every_version_of_it_does(grasps: Grasps, tmp_path: Path) -> None:
    for file in save(tmp_path, "dexgraspbench", grasps).rglob("*.npy"):
        data = file.read_bytes()
        assert b"numpy._core" not in data
        assert b"numpy.core.multiarray" in data


# -- writing


@every_foreign
def test_what_cannot_be_written_leaves_nothing_behind(grasps: Grasps, tmp_path: Path, name: str) -> None:
    spoilt = replace(grasps, posture=np.full_like(grasps.posture, np.nan))
    with pytest.raises(InputError, match="posture"):
        save(tmp_path, name, spoilt)
    assert list(tmp_path.iterdir()) == []


@every_foreign
def test_grasps_without_a_joint_of_the_hand_are_refused_and_leave_nothing_behind(
    grasps: Grasps, tmp_path: Path, name: str
) -> None:
    lacking = replace(
        grasps, joint_names=grasps.joint_names[1:], posture=grasps.posture[:, 1:], pregrasp=grasps.pregrasp[:, 1:]
    )
    with pytest.raises(InputError, match=rf"lack joints of .*: {grasps.joint_names[0]}; only native files"):
        save(tmp_path, name, lacking)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", [name for name, target in FOREIGN.items() if target == "folder"])
def test_a_folder_is_never_mixed_with_what_was_there(grasps: Grasps, tmp_path: Path, name: str) -> None:
    (tmp_path / "folder").mkdir()
    save(tmp_path, name, grasps)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match="not an empty folder"):
        save(tmp_path, name, grasps)
    assert sorted(tmp_path.rglob("*")) == before
    with pytest.raises(InputError, match="no folder"):
        save(tmp_path / "absent", name, grasps)


def test_a_write_that_breaks_off_leaves_the_earlier_file(
    one_object: Grasps, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "g.npy"
    save_grasps(path, one_object, metadata={}, format="dexgraspnet", options=TARGET)
    before = path.read_bytes()

    def fail(*_: Any) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(np.lib.format, "write_array_header_1_0", fail)
    with pytest.raises(OSError, match="no space left"):
        save_grasps(path, one_object, metadata={}, format="dexgraspnet", options=TARGET)
    with pytest.raises(OSError, match="no space left"):
        save_grasps(tmp_path / "folder", one_object, metadata={}, format="dexgraspbench", options=TARGET)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["g.npy"]


# -- reading what is not sound


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("isaac_grasp", "g.yaml"),
        ("moveit_grasp", "g.yaml"),
        ("dexgraspnet", "g.npy"),
        ("dexgraspbench", "000000.npy"),
    ],
)
def test_a_file_cut_off_anywhere_is_refused_in_one_line(
    one_object: Grasps, tmp_path: Path, name: str, file: str
) -> None:
    if name == "dexgraspbench":
        save_grasps(tmp_path / "all", one_object, metadata={}, format=name, options=TARGET)
        data = next((tmp_path / "all").rglob(file)).read_bytes()
    else:
        save_grasps(tmp_path / file, one_object, metadata={}, format=name, options=TARGET)
        data = (tmp_path / file).read_bytes().rstrip()
    cut = tmp_path / f"cut{Path(file).suffix}"
    for length in [0, 1, 10, 70, 200, len(data) // 3, len(data) // 2, len(data) - 1]:
        cut.write_bytes(data[:length])
        with pytest.raises(FileFormatError) as caught:
            load_grasps(cut, name, trust_pickle=True)
        assert str(cut) in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1


@every_yaml
def test_a_yaml_file_cut_off_between_lines_is_refused_or_whole(one_object: Grasps, tmp_path: Path, name: str) -> None:
    grasps = one_object[:2]
    save_grasps(tmp_path / "g.yaml", grasps, metadata={}, format=name)
    lines = (tmp_path / "g.yaml").read_text().splitlines(keepends=True)
    whole = 0
    for n in range(len(lines)):
        (tmp_path / "g.yaml").write_text("".join(lines[:n]))
        try:
            found = load_grasps(tmp_path / "g.yaml", name)
        except FileFormatError:
            continue
        assert_close(found, grasps)
        whole += 1
    # Fields of the last message that a grasp does not need may be missing.
    assert whole <= (0 if name == "isaac_grasp" else 30)


@pytest.mark.parametrize(("name", "suffix"), [(n, FORMATS_BY_NAME[n].suffixes[0]) for n in FOREIGN])
def test_bytes_of_something_else_are_refused(tmp_path: Path, name: str, suffix: str) -> None:
    path = tmp_path / f"foreign{suffix}"
    contents = (b"\x00\xff\xfe" * 50, b"hello", b"[" * 5000, b"{}", b"- 1\n- 2\n", b"null", b"a: b: c", b"&a [*a]")
    for content in contents:
        path.write_bytes(content)
        for chosen in (name, None):
            with pytest.raises(FileFormatError) as caught:
                load_grasps(path, chosen, trust_pickle=True)
            assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    "value", [np.arange(4.0), [1, 2], {"a": 1}, {"grasp_qpos": [1, 2]}, [{"qpos": {"a": 1}}], None]
)
def test_npy_files_of_other_data_are_refused(tmp_path: Path, value: Any) -> None:
    given = value if isinstance(value, np.ndarray) else np.array(value, dtype=object)
    np.save(tmp_path / "other.npy", given, allow_pickle=True)
    for name in (None, "dexgraspbench", "dexgraspnet"):
        with pytest.raises(FileFormatError):
            load_grasps(tmp_path / "other.npy", name, trust_pickle=True)


def test_a_pickle_of_something_not_installed_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "other.npy", np.array({"grasp_qpos": 1}, dtype=object), allow_pickle=True)
    data = (tmp_path / "other.npy").read_bytes()
    head = data[: data.index(b"\n") + 1]
    (tmp_path / "other.npy").write_bytes(head + b"cabsent_module\nThing\n.")
    with pytest.raises(FileFormatError, match="absent_module"):
        load_grasps(tmp_path / "other.npy", trust_pickle=True)


def change(data: Any, path: list[Any], value: Any) -> None:
    for key in path[:-1]:
        data = data[key]
    if value is None:
        del data[path[-1]]
    else:
        data[path[-1]] = value


@pytest.mark.parametrize(
    ("path", "value", "word"),
    [
        (["format"], "other", "not an isaac_grasp file"),
        (["format_version"], 2.0, "format_version 2.0"),
        (["format_version"], [1], "format_version"),
        (["gripper_frame"], "/World/panda_hand", "panda_hand"),
        (["grasps"], [1], "grasps is not a mapping"),
        (["grasps", "grasp_1"], 5, "grasp_1: is not a mapping"),
        (["grasps", "grasp_1", "position"], [0.0, 0.1], "grasp_1: gripper position"),
        (["grasps", "grasp_1", "position"], "abc", "grasp_1: gripper position"),
        (["grasps", "grasp_1", "position", 0], float("nan"), "grasp_1: gripper position"),
        (["grasps", "grasp_1", "orientation", "w"], 3.0, "norm 1"),
        (["grasps", "grasp_1", "orientation", "xyz"], [0.0], "4 numbers"),
        (["grasps", "grasp_1", "orientation"], None, "orientation w is None"),
        (["grasps", "grasp_1", "cspace_position", "THJ4"], None, "grasp_1: cspace_position lacks.*THJ4"),
        (["grasps", "grasp_1", "cspace_position", "THJ4"], "wide", "THJ4 is 'wide'"),
        (["grasps", "grasp_1", "cspace_position", "THJ4"], True, "THJ4 is True"),
        (["grasps", "grasp_1", "cspace_position"], None, "cspace_position is not a mapping"),
        (["graspcascade", "grasps", "grasp_1", "grasp_type"], "tripodd", "Did you mean 'tripod'"),
        (["graspcascade", "grasps", "grasp_1", "side_axis"], "q", "unknown side axis"),
        (["graspcascade", "grasps", "grasp_1", "side_m"], -1.0, "side_m"),
        (["graspcascade", "grasps", "grasp_1", "probability"], 2.0, "probability"),
        (["graspcascade", "grasps", "grasp_1", "probability"], "high", "probability is 'high'"),
    ],
)
def test_an_isaac_file_with_a_fault_is_refused_with_its_place(
    one_object: Grasps, tmp_path: Path, path: list[Any], value: Any, word: str
) -> None:
    save_grasps(tmp_path / "g.yaml", one_object, metadata={}, format="isaac_grasp")
    data = yaml.safe_load((tmp_path / "g.yaml").read_text())
    change(data, path, value)
    (tmp_path / "g.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(InputError, match=word) as caught:
        load_grasps(tmp_path / "g.yaml", "isaac_grasp")
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("path", "value", "word"),
    [
        (["parent_link"], "gripper", "parent_link is 'gripper'"),
        (["grasps"], 1, "no list 'grasps'"),
        (["grasps", 1], 5, "grasp 1: is not a mapping"),
        (["grasps", 1, "grasp_posture", "points"], [], "grasp 1: grasp_posture"),
        (["grasps", 1, "grasp_posture", "joint_names"], ["a"], "grasp 1: grasp_posture positions"),
        (["grasps", 1, "grasp_posture", "points", 0, "positions", 0], 0.3, r"bends the wrist \(WRJ2\)"),
        (["grasps", 1, "grasp_pose", "pose", "orientation", "w"], None, "grasp 1: grasp_pose quaternion"),
        (["grasps", 1, "grasp_pose"], None, "grasp 1: grasp_pose position"),
    ],
)
def test_a_moveit_file_with_a_fault_is_refused_with_its_place(
    grasps: Grasps, tmp_path: Path, path: list[Any], value: Any, word: str
) -> None:
    file = save(tmp_path, "moveit_grasp", grasps)
    data = yaml.safe_load(file.read_text())
    change(data, path, value)
    file.write_text(yaml.safe_dump(data))
    with pytest.raises(FileFormatError, match=word):
        load_grasps(file)


def test_moveit_poses_in_an_unknown_place_are_refused(grasps: Grasps, tmp_path: Path) -> None:
    file = save(tmp_path, "moveit_grasp", grasps, X_world_object=WORLD)
    data = yaml.safe_load(file.read_text())
    del data["graspcascade"]
    file.write_text(yaml.safe_dump(data))
    with pytest.raises(FileFormatError, match="frame 'world'"):
        load_grasps(file, assume=Assumptions("tripod"))


def test_an_isaac_file_of_others_reads_with_what_is_assumed(one_object: Grasps, tmp_path: Path) -> None:
    path = tmp_path / "g.yaml"
    save_grasps(path, one_object, metadata={}, format="isaac_grasp", options=ExportOptions(joint_prefix="rh_"))
    data = yaml.safe_load(path.read_text())
    del data["graspcascade"], data["object_frame"]
    data["format_version"], data["object_frame_link"] = "1.0", "/World/Mug"
    for row in data["grasps"].values():
        del row["pregrasp_cspace_position"], row["confidence"]
        row["cspace_position"]["arm_joint_1"] = 0.5
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(InputError, match=r"unknown object 'Mug'.*give --object"):
        load_grasps(path, assume=Assumptions("tripod"))
    found = load_grasps(path, assume=Assumptions("tripod", "box_medium"))
    np.testing.assert_array_equal(found.posture, one_object.posture)
    np.testing.assert_array_equal(found.pregrasp, one_object.pregrasp)
    assert np.isnan(found.probability).all()
    assert set(found.side_axis) <= set(CATALOGUE["box_medium"].sides_m)


def test_a_folder_of_nothing_known_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="dexgraspbench"):
        load_grasps(tmp_path)


def test_notes_carry_names_units_frames_and_order(one_object: Grasps, tmp_path: Path) -> None:
    save_grasps(tmp_path / "g.yaml", one_object, metadata=METADATA, format="isaac_grasp")
    save_grasps(tmp_path / "g.npy", one_object, metadata=METADATA, format="dexgraspnet", options=TARGET)
    for notes in (
        yaml.safe_load((tmp_path / "g.yaml").read_text())["graspcascade"],
        np.load(tmp_path / "g.npy", allow_pickle=True)[0]["graspcascade"],
    ):
        assert notes["units"] == {"length": "metre", "angle": "radian"}
        assert notes["quaternion_order"] == "wxyz"
        assert notes["joint_names"] == list(one_object.joint_names)
        assert notes["metadata"] == METADATA
        assert "X_hand_object" in notes["frames"]
        assert notes["conventions"]
        json.dumps(notes)
