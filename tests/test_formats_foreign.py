"""Files of others and for others: confidence, scales, frames, joint numbering, batches, other hands, contact."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import Box, GraspObject
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.poses import Pose, canonical_quat, rotation_angle
from graspcascade.core.tasks import Task, Tasks
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.formats import (
    FORMATS_BY_NAME,
    Assumptions,
    ExportOptions,
    load_document,
    load_executable,
    load_grasps,
    save_grasps,
)
from graspcascade.formats.dexgrasp import JOINTS
from graspcascade.hands import Hand

TARGET = ExportOptions(contact="target")
FOREIGN = ("isaac_grasp", "moveit_grasp", "dexgraspbench", "dexgraspnet")
CHANCE_KEY = {"isaac_grasp": "confidence", "moveit_grasp": "grasp_quality"}
every_foreign = pytest.mark.parametrize("name", FOREIGN)
every_yaml = pytest.mark.parametrize("name", FOREIGN[:2])
every_pickled = pytest.mark.parametrize("name", FOREIGN[2:])


@pytest.fixture
def grasps(drawn: Grasps) -> Grasps:
    """Three grasps of the medium box, of several types."""
    return drawn[drawn.object_name == "box_medium"][:3]


def target_of(folder: Path, name: str) -> Path:
    known = FORMATS_BY_NAME[name]
    return folder / ("folder" if known.layout == "folder" else f"box_medium{known.suffixes[0]}")


def save(folder: Path, name: str, grasps: Grasps, options: ExportOptions = TARGET, **more: Any) -> Path:
    path = target_of(folder, name)
    save_grasps(path, grasps, metadata={}, format=name, options=options, **more)
    return path


def edit(path: Path, change: Callable[[Any], object]) -> Path:
    """Change a YAML file's data in place."""
    data = yaml.safe_load(path.read_text())
    change(data)
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


def rows_of(data: Any) -> list[Any]:
    return list(data["grasps"].values()) if isinstance(data["grasps"], dict) else data["grasps"]


def without_notes(data: Any) -> None:
    del data["graspcascade"]


def bench_rows(folder: Path) -> list[dict[str, Any]]:
    files = sorted((folder / "graspdata").rglob("*.npy"), key=lambda file: file.name)
    return [np.load(file, allow_pickle=True).item() for file in files]


def save_row(path: Path, row: dict[str, Any]) -> Path:
    np.save(path, np.array(row, dtype=object), allow_pickle=True)
    return path


def assert_same(found: Grasps, expected: Grasps, atol: float = 1e-12) -> None:
    np.testing.assert_allclose(found.posture, expected.posture, atol=atol)
    np.testing.assert_allclose(found.pregrasp, expected.pregrasp, atol=atol)
    np.testing.assert_allclose(found.X_hand_object.position_m, expected.X_hand_object.position_m, atol=atol)
    turn = rotation_angle(found.X_hand_object.quat_wxyz, expected.X_hand_object.quat_wxyz)
    assert turn.max(initial=0) < max(1e-7, 10 * atol)


# -- the chance to hold


CHANCES = st.lists(st.just(math.nan) | st.floats(0, 1), min_size=3, max_size=3)
RATES = {"measured": {f"{kind}/box_medium": {"held": 7, "n": 10} for kind in GRASP_TYPES}}


@settings(max_examples=12, deadline=None)
@given(chances=CHANCES, order=st.permutations(list(FORMATS_BY_NAME)), metadata=st.sampled_from([{}, RATES]))
def test_a_grasps_own_probability_travels_bit_by_bit_through_all_formats_in_any_order(
    drawn: Grasps,
    tmp_path_factory: pytest.TempPathFactory,
    chances: list[float],
    order: list[str],
    metadata: dict[str, Any],
) -> None:
    of_one = drawn[drawn.object_name == "box_medium"][:3]
    passed, folder = replace(of_one, probability=np.array(chances)), tmp_path_factory.mktemp("chances")
    for number, name in enumerate(order):
        (here := folder / str(number)).mkdir()
        path = target_of(here, name)
        save_grasps(path, passed, metadata=metadata, format=name, options=TARGET)
        if name in FOREIGN[:2]:
            said = [row[CHANCE_KEY[name]] for row in rows_of(yaml.safe_load(path.read_text()))]
            unknown = 0.7 if metadata else 0.0
            assert said == [unknown if math.isnan(chance) else chance for chance in chances]
        passed = load_grasps(path, name, trust_pickle=True)
        np.testing.assert_array_equal(passed.probability, chances, err_msg=name)


@every_pickled
def test_pickled_grasps_say_their_own_chance_in_the_notes(grasps: Grasps, tmp_path: Path, name: str) -> None:
    path = save(tmp_path, name, replace(grasps, probability=np.array([0.9, np.nan, 0.0])))
    rows = bench_rows(path) if name == "dexgraspbench" else np.load(path, allow_pickle=True)
    assert [row["graspcascade"]["grasp"]["probability"] for row in rows] == [0.9, None, 0.0]


@every_yaml
def test_the_confidence_of_a_foreign_file_is_kept_and_written_again(grasps: Grasps, tmp_path: Path, name: str) -> None:
    key = CHANCE_KEY[name]

    def change(data: Any) -> None:
        without_notes(data)
        for row, value in zip(rows_of(data), (0.25, 0.0, 1), strict=True):
            row[key] = value

    path = edit(save(tmp_path, name, grasps), change)
    found = load_grasps(path, assume=Assumptions("tripod"))
    assert found.probability.tolist() == [0.25, 0.0, 1.0]
    save(tmp_path, name, found)
    assert [row[key] for row in rows_of(yaml.safe_load(path.read_text()))] == [0.25, 0.0, 1.0]


@every_yaml
def test_a_confidence_changed_in_one_of_our_exports_counts(grasps: Grasps, tmp_path: Path, name: str) -> None:
    key = CHANCE_KEY[name]
    path = edit(save(tmp_path, name, grasps), lambda data: rows_of(data)[1].update({key: 0.5}))
    np.testing.assert_array_equal(load_grasps(path).probability, [np.nan, 0.5, np.nan])


@every_yaml
def test_a_quality_that_is_no_chance_is_left_out_and_told(grasps: Grasps, tmp_path: Path, name: str) -> None:
    key = CHANCE_KEY[name]
    path = edit(save(tmp_path, name, grasps), lambda data: rows_of(data)[1].update({key: 353.6}))
    document = load_document(path)
    assert np.isnan(document.grasps.probability).all()
    assert document.notes == ("the confidence of 1 grasps is no chance between 0 and 1 and was left out",)


def test_measured_rates_that_read_as_such_are_carried() -> None:
    cells = {"tripod/mug a/b": {"held": 3, "n": 4}, "tripod/x": {"held": 5, "n": 4}, "tripod/y": {"held": 0, "n": 0}}
    for damaged in ({}, {"tripod/z": None}, {1: {}}, {"tripod": {"held": "many", "n": 1}}):
        options = ExportOptions().with_rates_of({"measured": cells | damaged})
        assert options.held_rates == {("tripod", "mug a/b"): 0.75}
    assert ExportOptions().with_rates_of({"measured": [1]}).held_rates == {}


def test_measured_rates_are_not_those_of_another_size(grasps: Grasps) -> None:
    options = ExportOptions(held_rates={("tripod", "box_medium"): 0.7, ("tripod", "mug"): 0.4})
    longer, mug = GraspObject("box_medium", Box(0.03, 0.045, 0.1)), GraspObject("mug", Box(0.03, 0.045, 0.1))
    tasks = Tasks.of(Task.of("tripod", obj, "x") for obj in ("box_medium", longer, mug))
    np.testing.assert_array_equal(options.confidence(replace(grasps, tasks=tasks)), [0.7, np.nan, 0.4])


# -- objects


@every_foreign
@pytest.mark.parametrize("obj", ["box:31x44x71mm", "cylinder:27.5x80mm", "sphere:41mm"])
def test_objects_of_any_size_are_known_by_the_name_in_the_file(
    grasps: Grasps, tmp_path: Path, name: str, obj: str
) -> None:
    sized = replace(grasps, tasks=Tasks.repeat(Task.of("tripod", obj, "x"), 3))
    known = FORMATS_BY_NAME[name]
    path = tmp_path / (f"g{known.suffixes[0]}" if name == "moveit_grasp" else "folder")
    save_grasps(path, sized, metadata={}, format=name, options=TARGET)
    assert load_grasps(path, trust_pickle=True).tasks.same_as(sized.tasks)
    if name == "dexgraspbench":
        row = bench_rows(path)[0]
        del row["graspcascade"]
        path = save_row(tmp_path / "theirs.npy", row)
    elif name == "dexgraspnet":
        (path,) = (path / "dataset").iterdir()
        rows = [{k: row[k] for k in ("scale", "qpos")} for row in np.load(path, allow_pickle=True)]
        np.save(path, np.array(rows, dtype=object), allow_pickle=True)
    else:
        path = edit(next(path.iterdir()) if path.is_dir() else path, without_notes)
    found = load_grasps(path, trust_pickle=True, assume=Assumptions("tripod"))
    assert list(found.tasks.objects) == [obj]


@every_foreign
def test_objects_whose_names_no_folder_can_have_are_written(grasps: Grasps, tmp_path: Path, name: str) -> None:
    odd = replace(grasps, tasks=Tasks.repeat(Task.of("tripod", GraspObject("../a/b", Box(0.03, 0.04, 0.05)), "x"), 3))
    (tmp_path / "in").mkdir()
    path = save(tmp_path / "in", name, odd)
    assert [p.name for p in tmp_path.iterdir()] == ["in"]
    assert load_grasps(path, trust_pickle=True).tasks.same_as(odd.tasks)


def test_what_a_file_calls_unknown_is_what_the_user_says(grasps: Grasps, tmp_path: Path) -> None:
    def change(data: Any) -> None:
        without_notes(data)
        data["object_frame"] = "/World/Mug"

    path = edit(save(tmp_path, "isaac_grasp", grasps), change)
    with pytest.raises(InputError, match=r"unknown object 'Mug'.*give --object"):
        load_grasps(path, assume=Assumptions("tripod"))
    mug = GraspObject("mug", Box(0.03, 0.05, 0.09), 950.0)
    assert load_grasps(path, assume=Assumptions("tripod", mug)).tasks.objects == {"mug": mug}
    found = load_grasps(path, assume=Assumptions("tripod", "box:30x50x90mm"))
    assert list(found.tasks.objects) == ["box:30x50x90mm"]


@pytest.mark.parametrize("scale", [0.8, [0.8, 0.8, 0.8], [1.0, 0.5, 0.8]])
@pytest.mark.parametrize("noted", [True, False])
def test_isaac_object_scale_makes_an_object_of_that_size(
    grasps: Grasps, tmp_path: Path, scale: Any, noted: bool
) -> None:
    def change(data: Any) -> None:
        data["object_scale"] = scale
        if not noted:
            without_notes(data)

    path = edit(save(tmp_path, "isaac_grasp", grasps), change)
    found = load_grasps(path, assume=Assumptions("tripod"))
    (obj,) = found.tasks.objects.values()
    np.testing.assert_allclose(obj.extents_m, np.array([0.03, 0.045, 0.06]) * scale)
    np.testing.assert_allclose(found.X_hand_object.position_m, grasps.X_hand_object.position_m, atol=1e-12)
    again = load_grasps(save(tmp_path, "isaac_grasp", found))
    assert again.tasks.same_as(found.tasks)


@pytest.mark.parametrize(
    ("scale", "word"), [(0, "above 0"), ("big", "not a finite number"), ([1, 2], "one number or three"), (99, "extent")]
)
def test_a_scale_that_makes_no_object_is_refused(grasps: Grasps, tmp_path: Path, scale: Any, word: str) -> None:
    path = edit(save(tmp_path, "isaac_grasp", grasps), lambda data: data.update(object_scale=scale))
    with pytest.raises(FileFormatError, match=word):
        load_grasps(path)


@every_pickled
def test_a_dataset_scale_makes_an_object_of_that_size(grasps: Grasps, tmp_path: Path, name: str) -> None:
    path = save(tmp_path, name, grasps)
    if name == "dexgraspbench":
        row = {k: v for k, v in bench_rows(path)[0].items() if k != "graspcascade"} | {"obj_scale": np.float32(0.5)}
        path = save_row(tmp_path / "theirs.npy", row)
    else:
        rows = [{"scale": 0.5, "qpos": row["qpos"]} for row in np.load(path, allow_pickle=True)]
        np.save(path, np.array(rows, dtype=object), allow_pickle=True)
    found = load_grasps(path, trust_pickle=True, assume=Assumptions("tripod", side_axis="z"))
    assert list(found.tasks.objects) == ["box:15x22.5x30mm"]
    assert set(found.side_m) == {0.03}


def test_files_of_a_folder_that_disagree_on_an_object_are_refused(drawn: Grasps, tmp_path: Path) -> None:
    save_grasps(tmp_path / "folder", drawn[:4], metadata={}, format="isaac_grasp")
    file = next((tmp_path / "folder").iterdir())
    edit(file, lambda data: data["graspcascade"]["objects"]["box_small"].update(extents_m=[0.02, 0.03, 0.05]))
    with pytest.raises(FileFormatError, match="describe object 'box_small' in two ways"):
        load_grasps(tmp_path / "folder")


# -- frames and joints


@pytest.mark.parametrize("keys", ["frame", "frame_link"])
def test_isaac_frames_go_by_either_key(grasps: Grasps, tmp_path: Path, keys: str) -> None:
    options = ExportOptions(frame_keys=keys)  # type: ignore[arg-type]
    path = save(tmp_path, "isaac_grasp", grasps, options)
    data = yaml.safe_load(path.read_text())
    assert {key for key in data if "frame" in key} == {f"object_{keys}", f"gripper_{keys}"}
    assert_same(load_grasps(edit(path, without_notes), assume=Assumptions("tripod")), grasps)


@every_yaml
@pytest.mark.parametrize("prefix", ["lh_", "robot/left_hand_", "Left-"])
def test_a_left_hand_is_refused_in_one_line(grasps: Grasps, tmp_path: Path, name: str, prefix: str) -> None:
    path = save(tmp_path, name, grasps, ExportOptions(joint_prefix="rh_"))
    path.write_text(path.read_text().replace("rh_", prefix))
    with pytest.raises(FileFormatError, match="left hand") as caught:
        load_grasps(path)
    assert len(str(caught.value).splitlines()) == 1


def test_of_two_hands_the_right_one_is_read(grasps: Grasps, tmp_path: Path) -> None:
    path = save(tmp_path, "isaac_grasp", grasps, ExportOptions(joint_prefix="rh_"))

    def change(data: Any) -> None:
        for row in rows_of(data):
            for key in ("cspace_position", "pregrasp_cspace_position"):
                row[key] = {k.replace("rh_", "lh_"): 0.1 for k in row[key]} | row[key]

    assert_same(load_grasps(edit(path, change)), grasps)


@every_yaml
def test_joints_numbered_from_zero_are_read_where_that_is_stated(grasps: Grasps, tmp_path: Path, name: str) -> None:
    path = save(tmp_path, name, grasps, ExportOptions(joint_prefix="robot0:", joint_numbering=0))
    data = yaml.safe_load(path.read_text())
    row = rows_of(data)[0]
    if name == "isaac_grasp":
        angles = row["cspace_position"]
    else:
        posture = row["grasp_posture"]
        angles = dict(zip(posture["joint_names"], posture["points"][0]["positions"], strict=True))
        assert {angles.pop("robot0:WRJ1"), angles.pop("robot0:WRJ0")} == {0.0}
    names = {"robot0:FFJ3": "FFJ4", "robot0:LFJ4": "LFJ5", "robot0:THJ4": "THJ5", "robot0:THJ0": "THJ1"}
    assert {theirs: angles[theirs] for theirs in names} == {
        theirs: grasps.posture_by_name()[ours][0] for theirs, ours in names.items()
    }
    assert len(angles) == 22
    assert_same(load_grasps(path), grasps)
    edit(path, without_notes)
    with pytest.raises(FileFormatError, match=r"numbered from 0 \(robot0:THJ0\).*--joint-numbering 0"):
        load_grasps(path, assume=Assumptions("tripod"))
    assert_same(load_grasps(path, assume=Assumptions("tripod", joint_numbering=0)), grasps)


def test_joint_names_without_numbers_cannot_be_numbered_from_zero(grasps: Grasps, three: Hand, tmp_path: Path) -> None:
    named = replace(three, joint_names=tuple(f"{name}_joint" for name in three.joint_names))
    other = replace(of_hand(grasps, three), hand=named.name, joint_names=named.joint_names)
    with pytest.raises(InputError, match="'FFJ4_joint' has no number"):
        save(tmp_path, "isaac_grasp", other, ExportOptions(hand=named, joint_numbering=0))


@every_yaml
@pytest.mark.parametrize(("prefix", "word"), [("lh_", "left hand"), ("robot/not", "only poses of")])
def test_only_the_right_hands_own_link_is_taken(
    grasps: Grasps, tmp_path: Path, name: str, prefix: str, word: str
) -> None:
    key = {"isaac_grasp": "gripper_frame", "moveit_grasp": "parent_link"}[name]
    path = edit(save(tmp_path, name, grasps), lambda data: data.update({key: prefix + data[key]}))
    with pytest.raises(FileFormatError, match=rf"{key} is .*{word}"):
        load_grasps(path)


@pytest.mark.parametrize("numbering", [7, "0", [1], True])
def test_a_joint_numbering_is_0_or_1(grasps: Grasps, tmp_path: Path, numbering: Any) -> None:
    path = save(tmp_path, "isaac_grasp", grasps)
    edit(path, lambda data: data["graspcascade"].update(joint_numbering=numbering))
    for use in (lambda: load_grasps(path), lambda: Assumptions(joint_numbering=numbering)):
        with pytest.raises(InputError, match=r"unknown joint_numbering .*Valid: 0, 1"):
            use()


@every_foreign
def test_joints_that_the_hand_lacks_are_not_lost(grasps: Grasps, tmp_path: Path, name: str) -> None:
    wider = {what: np.pad(getattr(grasps, what), ((0, 0), (0, 1))) for what in ("posture", "pregrasp")}
    with pytest.raises(InputError, match="have joints that shadow_hand_right lacks: ARM1; only native files"):
        save(tmp_path, name, replace(grasps, joint_names=(*grasps.joint_names, "ARM1"), **wider))


# -- exports changed since, or mixed


@every_pickled
@pytest.mark.parametrize("settled", [False, True])
def test_numbers_changed_by_another_tool_count_and_are_told(
    drawn: Grasps, outcomes: Outcomes, tmp_path: Path, name: str, settled: bool
) -> None:
    rows = np.flatnonzero((drawn.object_name == "box_medium") & outcomes.held)[:1]
    path = save(tmp_path, name, drawn[rows], ExportOptions(outcomes=outcomes[rows]) if settled else TARGET)
    before = load_grasps(path, trust_pickle=True)
    if name == "dexgraspbench":
        (row,) = bench_rows(path)
        for state in ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos"):
            row[state][0] += 0.01
        path = save_row(tmp_path / "changed.npy", row)
    else:
        (row,) = np.load(path, allow_pickle=True)
        row["qpos"]["WRJTx"] += 0.01
        np.save(path, np.array([row], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="it was changed since it was written; say which type"):
        load_grasps(path, trust_pickle=True)
    document = load_document(path, trust_pickle=True, assume=Assumptions("tripod"))
    assert (
        document.notes[-1] == "1 grasps were changed since they were written, and are read as those of a foreign file"
    )
    moved = document.grasps.X_hand_object.position_m - before.X_hand_object.position_m
    assert np.abs(moved).max() > 0.005


def test_another_object_frame_over_our_notes_counts(grasps: Grasps, tmp_path: Path) -> None:
    path = edit(save(tmp_path, "isaac_grasp", grasps), lambda data: data.update(object_frame="/World/sphere_small"))
    document = load_document(path, assume=Assumptions("tripod"))
    assert set(document.grasps.object_name) == {"sphere_small"}
    assert "3 grasps were changed since" in document.notes[-1]


def test_files_of_two_exports_are_not_mixed(drawn: Grasps, tmp_path: Path) -> None:
    (tmp_path / "mixed").mkdir()
    for i, name in enumerate(("box_small", "box_medium")):
        one = drawn[drawn.object_name == name][:2]
        save_grasps(tmp_path / "mixed" / f"{name}.yaml", one, metadata={}, format="isaac_grasp")
        save_grasps(tmp_path / f"{i}.yaml", one, metadata={"model": name}, format="isaac_grasp")
    with pytest.raises(FileFormatError, match="two of its grasps have the same number"):
        load_grasps(tmp_path / "mixed")
    for file in list(tmp_path.glob("*.yaml")):
        file.rename(tmp_path / "mixed" / file.name)
    with pytest.raises(FileFormatError, match="its files differ in metadata"):
        load_grasps(tmp_path / "mixed")


def test_a_copy_of_a_bench_file_is_refused(grasps: Grasps, tmp_path: Path) -> None:
    path = save(tmp_path, "dexgraspbench", grasps)
    file = next(path.rglob("000001.npy"))
    file.with_name("000009.npy").write_bytes(file.read_bytes())
    with pytest.raises(FileFormatError, match="have the same number"):
        load_grasps(path, trust_pickle=True)


@pytest.mark.parametrize("change", ["rows", "angle"])
def test_a_dexgraspnet_file_is_whole_and_in_radians(grasps: Grasps, tmp_path: Path, change: str) -> None:
    path = save(tmp_path, "dexgraspnet", grasps)
    rows, word = np.load(path, allow_pickle=True), "it has 2 of the 3 grasps that were written"
    if change == "angle":
        rows[0]["qpos"]["WRJRx"], word = 57.3, "WRJR has an angle of 57.3.*looks like degrees"
    np.save(path, rows[:2] if change == "rows" else rows, allow_pickle=True)
    with pytest.raises(FileFormatError, match=word):
        load_grasps(path, trust_pickle=True)


@pytest.mark.parametrize("name", ["dexgraspbench", "dexgraspnet", "isaac_grasp"])
def test_a_folder_of_no_grasps_is_not_written(grasps: Grasps, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=f"a {name} folder of no grasps"):
        save_grasps(tmp_path / "none", grasps[[]], metadata={}, format=name, options=TARGET)


def test_a_long_comment_hides_no_format_and_a_folder_of_another_is_named(grasps: Grasps, tmp_path: Path) -> None:
    path = save(tmp_path, "isaac_grasp", grasps)
    path.write_text(f"# {'x' * 5000}\n{path.read_text()}")
    assert_same(load_grasps(path), grasps)
    folder = save(tmp_path, "dexgraspbench", grasps)
    for name, word in (
        ("isaac_grasp", r"the folder holds no \.yaml files"),
        ("moveit_grasp", "is a folder; moveit_grasp"),
    ):
        with pytest.raises(InputError, match=word):
            load_grasps(folder, name)


# -- MoveIt


def test_an_empty_frame_is_the_objects_own(grasps: Grasps, tmp_path: Path) -> None:
    world = Pose.of([0.5, -0.2, 0.1], [0.5, -0.5, 0.5, 0.5])
    path = save(tmp_path, "moveit_grasp", grasps, ExportOptions(frame_id="", parent_link="palm"), X_world_object=world)
    for i, row in enumerate(rows_of(yaml.safe_load(path.read_text()))):
        assert row["grasp_pose"]["header"]["frame_id"] == ""
        position = row["grasp_pose"]["pose"]["position"]
        expected = grasps.X_hand_object.inverse().position_m[i]
        np.testing.assert_allclose([position[k] for k in "xyz"], expected, atol=1e-12)
    assert_same(load_grasps(path), grasps)
    assert_same(load_grasps(edit(path, without_notes), assume=Assumptions("tripod")), grasps)


def test_wrist_joints_that_grasps_carry_are_written_once(grasps: Grasps, tmp_path: Path) -> None:
    def with_wrist(angle: float) -> Grasps:
        wrist = np.tile([0.0, angle], (len(grasps), 1))
        return replace(
            grasps,
            joint_names=("WRJ2", "WRJ1", *grasps.joint_names),
            posture=np.hstack([wrist, grasps.posture]),
            pregrasp=np.hstack([wrist, grasps.pregrasp]),
        )

    path = save(tmp_path, "moveit_grasp", with_wrist(0.0))
    for row in rows_of(yaml.safe_load(path.read_text())):
        names = row["grasp_posture"]["joint_names"]
        assert len(names) == len(set(names)) == 24
        assert len(row["grasp_posture"]["points"][0]["positions"]) == 24
    assert_same(load_grasps(path), grasps)
    with pytest.raises(InputError, match=r"bend the wrist \(WRJ1\)"):
        save(tmp_path, "moveit_grasp", with_wrist(0.2))


# -- other hands


@pytest.fixture
def three(hand: Hand) -> Hand:
    """A hand of three digits without a wrist, whose palm body is turned against its hand frame."""
    kept = [i for i, name in enumerate(hand.joint_names) if name[:2] in ("FF", "MF", "TH")]
    return replace(
        hand,
        name="three_digits",
        joint_names=tuple(hand.joint_names[i] for i in kept),
        lower_rad=hand.lower_rad[kept],
        upper_rad=hand.upper_rad[kept],
        digits={name: hand.digits[name] for name in ("thumb", "index", "middle")},
        couplings=tuple(c for c in hand.couplings if c.name[:2] in ("FF", "MF")),
        wrist_joints=(),
        body="base",
        X_body_hand=Pose.of([0.0, 0.0, 0.0], canonical_quat([0.5, 0.5, -0.5, 0.5])),
        source="made up",
    )


def of_hand(grasps: Grasps, hand: Hand) -> Grasps:
    columns = [grasps.joint_names.index(name) for name in hand.joint_names]
    return replace(
        grasps,
        hand=hand.name,
        joint_names=hand.joint_names,
        posture=grasps.posture[:, columns],
        pregrasp=grasps.pregrasp[:, columns],
    )


@every_yaml
def test_grasps_of_a_hand_of_three_digits_are_exchanged(grasps: Grasps, three: Hand, tmp_path: Path, name: str) -> None:
    other = of_hand(grasps, three)
    with pytest.raises(InputError, match=r"'three_digits', which does not come with graspcascade.*--hand"):
        save(tmp_path, name, other)
    path = save(tmp_path, name, other, ExportOptions(hand=three))
    data = yaml.safe_load(path.read_text())
    assert data.get("gripper_frame", data.get("parent_link")) == "base"
    with pytest.raises(InputError, match="three_digits"):
        load_grasps(path)
    found = load_executable(path, three).grasps
    assert_same(found, other)
    assert (found.hand, found.joint_names) == (three.name, three.joint_names)
    edit(path, without_notes)
    assert_same(load_grasps(path, assume=Assumptions("tripod", hand=three)), other)


def test_poses_are_of_the_palm_body_and_approaches_along_its_normal(
    grasps: Grasps, three: Hand, tmp_path: Path
) -> None:
    other = of_hand(grasps, three)
    row = rows_of(yaml.safe_load(save(tmp_path, "moveit_grasp", other, ExportOptions(hand=three)).read_text()))[0]
    fields = row["grasp_pose"]["pose"]
    body = Pose.of([fields["position"][k] for k in "xyz"], [fields["orientation"][k] for k in "wxyz"])
    approach = row["pre_grasp_approach"]["direction"]["vector"]
    towards = body.apply([approach[k] for k in "xyz"]) - body.position_m
    palm_normal = -(grasps.X_hand_object.inverse() @ Pose(np.zeros(3), np.array([1.0, 0, 0, 0]))).apply([0, 1, 0])[0]
    palm_normal += grasps.X_hand_object.inverse().position_m[0]
    np.testing.assert_allclose(towards, palm_normal, atol=1e-9)
    isaac = yaml.safe_load(save(tmp_path, "isaac_grasp", other, ExportOptions(hand=three)).read_text())
    turned = rows_of(isaac)[0]["orientation"]
    assert rotation_angle([turned["w"], *turned["xyz"]], body.quat_wxyz) < 1e-7


@every_pickled
def test_formats_of_the_shadow_hand_say_so(grasps: Grasps, three: Hand, tmp_path: Path, name: str) -> None:
    renamed = replace(three, joint_names=tuple(f"j{i}" for i in range(len(three.joint_names))))
    other = replace(of_hand(grasps, three), joint_names=renamed.joint_names)
    with pytest.raises(InputError, match=r"of the Shadow Hand only, not of three_digits"):
        save(tmp_path, name, other)
    path = save(tmp_path, name, grasps)
    with pytest.raises(InputError, match="of the Shadow Hand only, not of three_digits"):
        load_grasps(path, trust_pickle=True, assume=Assumptions(hand=renamed))


# -- hand in contact


@every_pickled
def test_contact_comes_from_a_trial_unless_the_target_is_asked_for(
    drawn: Grasps, outcomes: Outcomes, tmp_path: Path, name: str
) -> None:
    rows = np.flatnonzero((drawn.object_name == "box_medium") & outcomes.held)[:1]
    with pytest.raises(InputError, match=r"only a trial tells.*run_trials.*contact='target'"):
        save(tmp_path, name, drawn[rows], ExportOptions())
    assert list(tmp_path.iterdir()) == []
    save(tmp_path, name, drawn[rows], ExportOptions(outcomes=outcomes[rows]))
    (tmp_path / "target").mkdir()
    save(tmp_path / "target", name, drawn[rows], ExportOptions(outcomes=outcomes[rows], contact="target"))
    measured = []
    for folder in (tmp_path, tmp_path / "target"):
        path = target_of(folder, name)
        row = bench_rows(path)[0] if path.is_dir() else np.load(path, allow_pickle=True)[0]
        measured.append(row["graspcascade"]["grasp"]["contact_measured"])
    assert measured == [True, False]


# -- batches of DexGraspBench and its relatives


def batch(tmp_path: Path, grasps: Grasps, **more: Any) -> dict[str, Any]:
    rows = bench_rows(save(tmp_path, "dexgraspbench", grasps))
    stacked = {key: np.stack([row[key] for row in rows]) for key in rows[0] if key.endswith("_qpos")}
    return stacked | {key: rows[0][key] for key in ("obj_path", "obj_scale", "obj_pose")} | more


def bench_grasps(tmp_path: Path, row: dict[str, Any]) -> Grasps:
    return load_grasps(save_row(tmp_path / "theirs.npy", row), trust_pickle=True, assume=Assumptions("tripod"))


def test_a_batch_of_grasps_in_one_dictionary_is_read(grasps: Grasps, tmp_path: Path) -> None:
    row = batch(tmp_path, grasps)
    assert_same(bench_grasps(tmp_path, row), grasps)
    row["obj_pose"] = np.tile(row["obj_pose"], (3, 1))
    assert_same(bench_grasps(tmp_path, row), grasps)


def test_robot_pose_holds_the_same_numbers(grasps: Grasps, tmp_path: Path) -> None:
    row = batch(tmp_path, grasps)
    states = [row.pop(name) for name in ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos")]
    found = bench_grasps(tmp_path, row | {"robot_pose": states[2]})
    assert_same(found, replace(grasps, pregrasp=grasps.posture))
    assert_same(bench_grasps(tmp_path, row | {"robot_pose": np.stack(states, axis=1)}), grasps)
    assert_same(
        bench_grasps(tmp_path, row | {"robot_pose": states[2][0]}), replace(grasps, pregrasp=grasps.posture)[:1]
    )


def test_joint_names_beside_the_numbers_say_their_order(grasps: Grasps, tmp_path: Path) -> None:
    row = batch(tmp_path, grasps)
    order = [7 + i for i in reversed(range(22))]
    for name in ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos"):
        row[name] = row[name][:, [*range(7), *order]]
    row["joint_names"] = [f"rh_{name}" for name in reversed(JOINTS)]
    assert_same(bench_grasps(tmp_path, row), grasps)


def test_bodex_poses_are_of_the_palm_with_the_thumb_first(grasps: Grasps, tmp_path: Path) -> None:
    row = batch(tmp_path, grasps)
    palm = grasps.X_hand_object.inverse()
    order = [grasps.joint_names.index(name) for name in (*JOINTS[17:], *JOINTS[:17])]
    pose = np.hstack([palm.position_m, palm.quat_wxyz])
    stages = [np.hstack([pose, angles[:, order]]) for angles in (grasps.pregrasp, grasps.posture, grasps.posture)]
    theirs = {
        "robot_pose": np.stack(stages, axis=1)[None],
        "obj_pose": row["obj_pose"][None],
        "obj_scale": np.array([1.0]),
        "obj_path": ["assets/object/box_medium/mesh/simplified.obj"],
    }
    found = bench_grasps(tmp_path, theirs)
    assert_same(found, grasps)
    assert set(found.object_name) == {"box_medium"}


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"grasp_qpos": np.zeros((2, 3, 29))}, r"grasp_qpos is batched as \(2, 3, 29\)"),
        ({"grasp_qpos": np.zeros((5, 29))}, "batched as different numbers of grasps"),
        ({"grasp_qpos": np.zeros((3, 23))}, r"grasp_qpos has 69 numbers.*batched \(n, 29\)"),
        ({"grasp_qpos": np.full((3, 29), np.nan)}, "grasp_qpos is nan"),
        ({"obj_pose": np.zeros((2, 7))}, "obj_pose has 2 entries for 3 grasps"),
        ({"obj_pose": None}, r"theirs\.npy: lacks obj_pose$"),
        ({"obj_path": ["a/box_small", "a/box_medium"]}, "obj_path has 2 entries for 3 grasps"),
        ({"obj_path": []}, "obj_path has 0 entries for 3 grasps"),
        ({"obj_scale": np.array([1.0, 1.2, 1.4])}, "3 grasps, but an obj_scale of several numbers is of a single one"),
        ({"graspcascade": {"grasp": {"number": 0}}}, "3 grasps, but the notes under 'graspcascade' are of a single"),
        ({"grasp_qpos": [[1, 2], [3]]}, r"grasp_qpos is \[\[1, 2\], \[3\]\], not an array of numbers"),
        ({"grasp_qpos": np.zeros((3, 29), dtype=complex)}, "not an array of numbers"),
        ({"joint_names": ["WRJ2", "WRJ1", *JOINTS]}, "joint_names has 24 names for 22 angles"),
    ],
)
def test_a_batch_that_does_not_fit_together_is_refused(
    grasps: Grasps, tmp_path: Path, change: dict[str, Any], word: str
) -> None:
    with pytest.raises(FileFormatError, match=word) as caught:
        bench_grasps(tmp_path, batch(tmp_path, grasps) | change)
    assert len(str(caught.value).splitlines()) == 1


def test_each_grasp_of_a_batch_may_have_its_own_object(grasps: Grasps, tmp_path: Path) -> None:
    names = ["box_small", "box_medium", "sphere_small"]
    read = bench_grasps(tmp_path, batch(tmp_path, grasps, obj_path=[f"assets/{name}" for name in names]))
    assert read.object_name.tolist() == names


@pytest.mark.parametrize("digits", [400, 5000], ids=["that no float holds", "that Python does not write"])
@pytest.mark.parametrize("key", ["grasp_qpos", "obj_pose", "obj_scale"])
def test_an_endless_integer_in_a_row_is_refused_with_its_place(
    grasps: Grasps, tmp_path: Path, key: str, digits: int
) -> None:
    row, huge = batch(tmp_path, grasps[:1]), 10**digits
    row[key] = huge if key == "obj_scale" else [huge, *np.ravel(row[key])[1:]]
    with pytest.raises(FileFormatError, match=rf"theirs\.npy: {key} is (\[?10+\.\.\.|a huge integer), not") as caught:
        bench_grasps(tmp_path, row)
    assert len(str(caught.value).splitlines()) == 1


def test_an_endless_integer_in_yaml_is_refused_with_its_place(grasps: Grasps, tmp_path: Path) -> None:
    path = save(tmp_path, "isaac_grasp", grasps)
    text = path.read_text()
    for written, digits, word in (
        ("object_scale: 1.0", 390, r"grasp_0: object_scale is 10+\.\.\., not a finite number"),
        ("format_version: 1.0", 390, r"has format_version 10+\.\.\.; this version reads 1.0"),
        ("object_scale: 1.0", 5_000, r"line \d+: a number longer than the 400 characters allowed"),
    ):
        path.write_text(text.replace(written, f"{written.split()[0]} 1{'0' * digits}"))
        with pytest.raises(FileFormatError, match=word):
            load_grasps(path)


# -- units and limits


@every_foreign
def test_degrees_are_refused_in_every_format(grasps: Grasps, tmp_path: Path, name: str) -> None:
    path = save(tmp_path, name, grasps)
    if name == "isaac_grasp":
        edit(path, lambda data: [row["cspace_position"].update(FFJ3=45.0) for row in rows_of(data)])
    elif name == "moveit_grasp":
        edit(path, lambda data: [set_last(row["grasp_posture"]) for row in rows_of(data)])
    elif name == "dexgraspbench":
        row = {key: value for key, value in bench_rows(path)[0].items() if key != "graspcascade"}
        row["squeeze_qpos"][8:] *= 180 / np.pi
        path = save_row(tmp_path / "theirs.npy", row)
    else:
        rows = [{"qpos": row["qpos"] | {"robot0:FFJ2": 45.0}} for row in np.load(path, allow_pickle=True)]
        np.save(path, np.array(rows, dtype=object), allow_pickle=True)
    with pytest.raises(FileFormatError, match="looks like degrees"):
        load_grasps(path, trust_pickle=True, assume=Assumptions("tripod"))


def set_last(trajectory: dict[str, Any]) -> None:
    trajectory["points"][0]["positions"][-1] = 45.0


def test_millimetres_are_refused_in_foreign_files(grasps: Grasps, tmp_path: Path) -> None:
    def change(data: Any) -> None:
        for row in rows_of(data):
            row["position"] = [1000 * value for value in row["position"]]

    with pytest.raises(FileFormatError, match=r"m from the palm.*millimetres"):
        load_grasps(edit(save(tmp_path, "isaac_grasp", grasps), change))
