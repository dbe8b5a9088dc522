"""Grasp files: exact round trips, self-describing content, and a clear word on everything that is not one."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspcascade import formats
from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.files import read_json
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import Box, GraspObject
from graspcascade.core.poses import Pose, canonical_quat, rotation_angle
from graspcascade.core.tasks import Task, Tasks
from graspcascade.formats import (
    FORMATS,
    FORMATS_BY_NAME,
    ExportOptions,
    load_document,
    load_executable,
    load_grasps,
    save_grasps,
)
from graspcascade.hands import Hand

METADATA = {"model": "model3", "asked": {"n": 4, "seed": 7, "side_cm": None}, "versions": {"numpy": "2"}}
WORLD = Pose.of([0.5, -0.2, 0.1], [0.5, 0.5, 0.5, 0.5])
every_format = pytest.mark.parametrize("suffix", list(FORMATS))


@pytest.fixture
def grasps(drawn: Grasps) -> Grasps:
    return drawn[[0, 20, 40, 53]]


@pytest.fixture
def stored(grasps: Grasps, tmp_path: Path) -> dict[str, Any]:
    """Give a sound JSON document, to be spoilt."""
    save_grasps(tmp_path / "sound.json", grasps, metadata=METADATA)
    return dict(json.loads((tmp_path / "sound.json").read_text()))


def assert_equal(one: Grasps, other: Grasps) -> None:
    assert (one.hand, one.joint_names) == (other.hand, other.joint_names)
    assert one.tasks.same_as(other.tasks)
    for name, column in one.columns().items():
        np.testing.assert_array_equal(column, other.columns()[name], err_msg=name)


# -- round trips


@every_format
def test_a_file_gives_back_every_bit_of_the_grasps_and_their_metadata(
    grasps: Grasps, tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / f"grasps{suffix}"
    save_grasps(path, grasps, metadata=METADATA)
    assert_equal(load_grasps(path), grasps)
    assert load_document(path).metadata == METADATA
    assert load_document(path).X_world_object is None


@given(st.integers(0, 2**32 - 1))
def test_json_is_exact_for_any_grasps(
    drawn: Grasps, hand: Hand, tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    n, joints = len(drawn), len(drawn.joint_names)
    changed = replace(
        drawn,
        posture=hand.clip(rng.normal(size=(n, joints)) * 10.0 ** rng.uniform(-12, 2, (n, joints))),
        X_hand_object=Pose(rng.uniform(-0.5, 0.5, (n, 3)), canonical_quat(rng.normal(size=(n, 4)))),
        probability=np.where(rng.uniform(size=n) < 0.5, np.nan, rng.uniform(size=n)),
    )
    path = tmp_path_factory.mktemp("exact") / "grasps.json"
    save_grasps(path, changed, metadata={})
    assert_equal(load_grasps(path), changed)


@every_format
def test_no_grasps_are_a_file_too(grasps: Grasps, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"none{suffix}"
    save_grasps(path, grasps[[]], metadata={})
    assert len(load_grasps(path)) == 0
    assert load_grasps(path).joint_names == grasps.joint_names


@every_format
def test_an_object_pose_in_the_world_brings_the_hand_poses(grasps: Grasps, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"grasps{suffix}"
    save_grasps(path, grasps, metadata={}, X_world_object=WORLD)
    assert_equal(load_grasps(path), grasps)
    found = load_document(path).X_world_object
    assert found is not None
    np.testing.assert_array_equal(found.position_m, WORLD.position_m)
    np.testing.assert_array_equal(found.quat_wxyz, WORLD.quat_wxyz)


def test_the_suffix_may_be_in_capitals(grasps: Grasps, tmp_path: Path) -> None:
    save_grasps(tmp_path / "GRASPS.JSON", grasps, metadata={})
    assert_equal(load_grasps(tmp_path / "GRASPS.JSON"), grasps)


# -- what a file says of itself


def test_json_names_units_frames_order_joints_and_objects(stored: dict[str, Any], grasps: Grasps) -> None:
    assert stored["schema_version"] == formats.SCHEMA_VERSION
    assert stored["units"] == {"length": "metre", "angle": "radian"}
    assert stored["quaternion_order"] == "wxyz"
    assert "X_hand_object" in stored["frames"]
    assert stored["joint_names"] == list(grasps.joint_names)
    assert set(stored["objects"]) == set(grasps.object_name.tolist())
    assert stored["written_by"].startswith("graspcascade ")


def test_json_carries_joints_by_name_and_unknown_sizes_as_null(stored: dict[str, Any], grasps: Grasps) -> None:
    assert len(stored["grasps"]) == len(grasps)
    row = stored["grasps"][2]
    assert row["posture"] == {name: grasps.posture[2, i] for i, name in enumerate(grasps.joint_names)}
    assert row["probability"] is None
    assert row["object_size_m"] is None
    assert row["grasp_size_m"] == grasps.grasp_size_m[2]


def test_joint_order_in_a_file_is_free(stored: dict[str, Any], grasps: Grasps, tmp_path: Path) -> None:
    for row in stored["grasps"]:
        row["posture"] = dict(reversed(row["posture"].items()))
    (tmp_path / "turned.json").write_text(json.dumps(stored))
    assert_equal(load_grasps(tmp_path / "turned.json"), grasps)


def test_hand_poses_in_the_file_put_the_object_where_it_was_said_to_be(grasps: Grasps, tmp_path: Path) -> None:
    save_grasps(tmp_path / "placed.json", grasps, metadata={}, X_world_object=WORLD)
    rows = json.loads((tmp_path / "placed.json").read_text())["grasps"]
    hand = Pose.of(*([row["X_world_hand"][key] for row in rows] for key in ("position_m", "quat_wxyz")))
    found = hand @ grasps.X_hand_object
    np.testing.assert_allclose(found.position_m, np.tile(WORLD.position_m, (len(grasps), 1)), atol=1e-12)
    assert rotation_angle(found.quat_wxyz, WORLD.quat_wxyz).max() < 1e-6


def test_parquet_has_plain_columns_for_any_reader(grasps: Grasps, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    save_grasps(tmp_path / "g.parquet", grasps, metadata={}, X_world_object=WORLD)
    table = pq.read_table(tmp_path / "g.parquet")
    assert table.num_rows == len(grasps)
    assert {"grasp_type", "posture_THJ4", "pregrasp_THJ4", "object_x_m", "object_qw", "world_hand_z_m"} <= set(
        table.column_names
    )
    assert table.column("probability").null_count == len(grasps)


# -- writing


def test_an_unknown_suffix_is_answered_with_the_valid_ones(grasps: Grasps, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.npy.*Valid: \.json .*\.parquet"):
        save_grasps(tmp_path / "grasps.npy", grasps, metadata={})
    with pytest.raises(InputError, match=r"\.parquet"):
        load_grasps(tmp_path / "grasps")
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_or_a_folder_in_the_way_is_named(grasps: Grasps, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no folder .*absent"):
        save_grasps(tmp_path / "absent" / "g.json", grasps, metadata={})
    (tmp_path / "g.json").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        save_grasps(tmp_path / "g.json", grasps, metadata={})


@every_format
@pytest.mark.parametrize("fault", ["metadata", "posture"])
def test_what_cannot_be_written_leaves_the_earlier_file_as_it_was(
    grasps: Grasps, tmp_path: Path, suffix: str, fault: str
) -> None:
    path = tmp_path / f"kept{suffix}"
    save_grasps(path, grasps, metadata=METADATA)
    before = path.read_bytes()
    spoilt = replace(grasps, posture=np.full_like(grasps.posture, np.nan)) if fault == "posture" else grasps
    metadata: dict[str, Any] = {"loss": float("nan")} if fault == "metadata" else {}
    with pytest.raises(InputError, match=fault):
        save_grasps(path, spoilt, metadata=metadata)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("name", list(FORMATS_BY_NAME))
@pytest.mark.parametrize("n_poses", [2, 4])
def test_an_object_pose_is_one_for_all_grasps(grasps: Grasps, tmp_path: Path, name: str, n_poses: int) -> None:
    several = Pose(np.tile(WORLD.position_m, (n_poses, 1)), np.tile(WORLD.quat_wxyz, (n_poses, 1)))
    path = tmp_path / ("folder" if FORMATS_BY_NAME[name].layout != "file" else f"g{FORMATS_BY_NAME[name].suffixes[0]}")
    options = ExportOptions(contact="target")
    with pytest.raises(InputError, match=rf"X_world_object: one pose.*got \({n_poses}, 3\)"):
        save_grasps(path, grasps, metadata={}, X_world_object=several, format=name, options=options)
    assert list(tmp_path.iterdir()) == []


def test_parquet_without_pyarrow_names_the_extra(
    grasps: Grasps, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"extra 'train'"):
        save_grasps(tmp_path / "g.parquet", grasps, metadata={})
    assert list(tmp_path.iterdir()) == []


# -- reading what is not sound


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no file .*absent\.json"):
        load_grasps(tmp_path / "absent.json")


@every_format
def test_a_file_cut_off_anywhere_is_refused_in_one_line(grasps: Grasps, tmp_path: Path, suffix: str) -> None:
    whole, cut = tmp_path / f"whole{suffix}", tmp_path / f"cut{suffix}"
    save_grasps(whole, grasps, metadata=METADATA)
    data = whole.read_bytes().rstrip()
    for length in [0, 1, 10, len(data) // 3, len(data) // 2, len(data) - 1]:
        cut.write_bytes(data[:length])
        with pytest.raises(FileFormatError) as caught:
            load_grasps(cut)
        assert str(cut) in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1


@every_format
def test_bytes_of_something_else_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"foreign{suffix}"
    for content in (b"\x00\xff\xfe" * 50, b"hello", b"[" * 100_000, b'{"kind": "other"}', b"[1, 2]", b"null"):
        path.write_bytes(content)
        with pytest.raises(FileFormatError):
            load_grasps(path)


def test_a_parquet_file_of_other_data_is_refused(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({"x": [1, 2]}), tmp_path / "other.parquet")
    with pytest.raises(FileFormatError, match="not a graspcascade grasp file"):
        load_grasps(tmp_path / "other.parquet")


def _change(path: list[Any], value: Any) -> Any:
    def change(document: dict[str, Any]) -> None:
        place: Any = document
        for key in path[:-1]:
            place = place[key]
        if value is None:
            del place[path[-1]]
        else:
            place[path[-1]] = value

    return change


@pytest.mark.parametrize(
    ("path", "value", "word"),
    [
        (["schema_version"], 99, "schema version 99"),
        (["schema_version"], "1", "schema version '1'; this version reads 1"),
        (["schema_version"], True, "schema version True"),
        (["quaternion_order"], "xyzw", "xyzw"),
        (["units"], {"length": "millimetre", "angle": "radian"}, "units is .*millimetre.*only metre and radian"),
        (["frames", "hand"], "forearm", "frames are other ones"),
        (["joint_names"], "FFJ4", "joint_names"),
        (["joint_names"], ["FFJ4", "FFJ4"], "twice"),
        (["metadata"], None, "metadata"),
        (["grasps"], {"a": 1}, "grasps is not a list"),
        (["grasps", 1], 5, "grasp 1"),
        (["grasps", 1, "posture", "THJ4"], None, "grasp 1: lacks 'THJ4'"),
        (["grasps", 1, "posture", "XXJ1"], 0.1, "grasp 1: posture has joints.*XXJ1"),
        (["grasps", 1, "posture", "THJ4"], "wide", "grasp 1: THJ4 is 'wide'"),
        (["grasps", 1, "posture", "THJ4"], True, "grasp 1: THJ4"),
        (["grasps", 1, "posture", "THJ4"], 10**400, r"grasp 1: THJ4 is 10+\.\.\., not a finite number"),
        (["grasps", 2, "grasp_type"], "tripodd", "grasp 2: .*Did you mean 'tripod'"),
        (["grasps", 2, "object_label"], "box_mediun", "grasp 2: .*Did you mean 'box_medium'"),
        (["grasps", 2, "side_axis"], "q", "grasp 2: unknown side axis 'q'"),
        (["grasps", 2, "side_axis"], 1, "grasp 2: side_axis is 1, not a name"),
        (["hand"], 5, "hand is 5, not a name"),
        (["X_world_object"], [1, 2], "X_world_object is damaged .not position_m and quat_wxyz of a pose"),
        (["objects", "box_small", "extents_m"], [0.02, 0.03], "three extents"),
        (["objects", "box_small", "shape"], "cone", "unknown shape 'cone'"),
        (["grasps", 2, "side_m"], -0.03, "grasp 2: side_m"),
        (["grasps", 3, "X_hand_object", "quat_wxyz"], [1.0, 1.0, 0.0, 0.0], "grasp 3: .*norm 1"),
        (["grasps", 3, "X_hand_object", "quat_wxyz"], [1.0, 0.0, 0.0], "grasp 3: quat_wxyz"),
        (["grasps", 3, "X_hand_object", "position_m"], [0.0, float("nan"), 0.0], "NaN is not a JSON number"),
        (["grasps", 3, "probability"], 1.5, "grasp 3: probability"),
        (
            ["X_world_object"],
            {"position_m": [0.0, 0.1], "quat_wxyz": [1.0, 0.0, 0.0, 0.0]},
            "X_world_object is damaged",
        ),
        (["X_world_object"], {"position_m": [10**400, 0, 0], "quat_wxyz": [1, 0, 0, 0]}, "X_world_object is damaged"),
        (["X_world_object"], {"position_m": [[0.0] * 3] * 2, "quat_wxyz": [[1.0, 0.0, 0.0, 0.0]] * 2}, "one pose"),
        (["X_world_object"], {"position_m": [[0.0] * 3] * 4, "quat_wxyz": [[1.0, 0.0, 0.0, 0.0]] * 4}, "one pose"),
    ],
)
def test_a_document_with_a_fault_is_refused_with_its_place(
    stored: dict[str, Any], tmp_path: Path, path: list[Any], value: Any, word: str
) -> None:
    _change(path, value)(stored)
    (tmp_path / "spoilt.json").write_text(json.dumps(stored))
    with pytest.raises(FileFormatError, match=word) as caught:
        load_grasps(tmp_path / "spoilt.json")
    assert len(str(caught.value).splitlines()) == 1


def test_a_key_that_stands_twice_is_refused(stored: dict[str, Any], tmp_path: Path) -> None:
    text = json.dumps(stored)
    for path in (tmp_path / "twice.json", tmp_path / "metadata.json"):
        path.write_text(text.replace('"side_m": ', '"side_m": 1, "side_m": ', 1))
        with pytest.raises(FileFormatError, match="the key 'side_m' twice"):
            load_grasps(path)
        with pytest.raises(FileFormatError, match="the key 'side_m' twice"):
            read_json(path)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (
            lambda columns: columns | {"posture_THJ4": ["0.1"] * 4},
            "column 'posture_THJ4' is of type string, not of num",
        ),
        (lambda columns: columns | {"posture_THJ4": [True] * 4}, "column 'posture_THJ4' is of type bool"),
        (lambda columns: columns | {"side_axis": [0] * 4}, "column 'side_axis' is of type int64, not of text"),
        (lambda columns: {k: v for k, v in columns.items() if k != "object_qw"}, r"parquet: lacks column 'object_qw'$"),
    ],
)
def test_parquet_columns_are_checked_by_name_and_type(grasps: Grasps, tmp_path: Path, change: Any, word: str) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = tmp_path / "g.parquet"
    save_grasps(path, grasps, metadata={})
    table = pq.read_table(path)
    columns = change({name: table[name] for name in table.column_names})
    pq.write_table(pa.table(columns).replace_schema_metadata(table.schema.metadata), path)
    with pytest.raises(FileFormatError, match=word):
        load_grasps(path)
    pq.write_table(table.append_column("side_m", table["side_m"]), path)
    with pytest.raises(FileFormatError, match="has column 'side_m' 2 times"):
        load_grasps(path)


def test_a_file_of_another_hand_is_told_and_one_of_a_left_hand_is_refused(
    stored: dict[str, Any], hand: Hand, tmp_path: Path
) -> None:
    stored["hand"] = "allegro"
    assert load_executable(_written(stored, tmp_path), hand).notes == (
        "the grasps are of hand 'allegro', not of 'shadow_hand_right'",
    )
    for name in ("shadow_hand_left", "lh_shadow", "L_hand"):
        stored["hand"] = name
        with pytest.raises(FileFormatError, match=f"of hand '{name}', which is not of the side of shadow_hand_right"):
            load_executable(_written(stored, tmp_path), hand)


def test_a_quaternion_with_negative_w_is_read_as_the_same_rotation(
    stored: dict[str, Any], grasps: Grasps, tmp_path: Path
) -> None:
    quat = stored["grasps"][0]["X_hand_object"]["quat_wxyz"]
    stored["grasps"][0]["X_hand_object"]["quat_wxyz"] = [-part for part in quat]
    (tmp_path / "turned.json").write_text(json.dumps(stored))
    found = load_grasps(tmp_path / "turned.json").X_hand_object.quat_wxyz[0]
    assert found[0] >= 0
    np.testing.assert_allclose(found, grasps.X_hand_object.quat_wxyz[0], atol=1e-15)


# -- hand and objects


def test_a_file_names_its_hand_and_one_that_does_not_is_of_the_shadow_hand(
    stored: dict[str, Any], grasps: Grasps, tmp_path: Path
) -> None:
    assert stored["hand"] == "shadow_hand_right"
    del stored["hand"]
    (tmp_path / "old.json").write_text(json.dumps(stored))
    assert_equal(load_grasps(tmp_path / "old.json"), grasps)


@every_format
def test_grasps_of_any_hand_and_object_read_back(grasps: Grasps, tmp_path: Path, suffix: str) -> None:
    own = GraspObject("my mug/2", Box(0.03, 0.05, 0.1), 950.0)
    kept = [0, 4, 17, 18]
    other = replace(
        grasps,
        hand="three_fingers",
        joint_names=tuple(f"j{i}" for i in kept),
        posture=grasps.posture[:, kept],
        pregrasp=grasps.pregrasp[:, kept],
        tasks=Tasks.repeat(Task.of("tripod", own, "x"), len(grasps)),
    )
    save_grasps(tmp_path / f"g{suffix}", other, metadata={})
    assert_equal(load_grasps(tmp_path / f"g{suffix}"), other)


@every_format
def test_an_object_of_another_size_is_tried_at_its_own(grasps: Grasps, tmp_path: Path, suffix: str) -> None:
    longer = GraspObject("box_medium", Box(0.03, 0.045, 0.08))
    changed = replace(grasps, tasks=Tasks.repeat(Task.of("tripod", longer, "x"), len(grasps)))
    save_grasps(tmp_path / f"g{suffix}", changed, metadata={})
    assert set(load_grasps(tmp_path / f"g{suffix}").tasks.objects.values()) == {longer}


def test_two_objects_of_one_name_are_not_written(grasps: Grasps, tmp_path: Path) -> None:
    two = [Task.of("tripod", GraspObject("mug", Box(0.03, y, 0.08)), "x") for y in (0.03, 0.04)]
    with pytest.raises(InputError, match="two different objects are named 'mug'"):
        save_grasps(tmp_path / "g.json", replace(grasps, tasks=Tasks.of(two * 2)), metadata={})


def test_an_executable_file_has_grasps_with_all_joints_of_the_hand(grasps: Grasps, hand: Hand, tmp_path: Path) -> None:
    save_grasps(tmp_path / "g.json", grasps, metadata={})
    assert_equal(load_executable(tmp_path / "g.json", hand).grasps, grasps)
    fewer = replace(
        grasps, joint_names=grasps.joint_names[1:], posture=grasps.posture[:, 1:], pregrasp=grasps.pregrasp[:, 1:]
    )
    save_grasps(tmp_path / "g.json", fewer, metadata={})
    with pytest.raises(InputError, match=r"g\.json lacks joints of shadow_hand_right: FFJ4"):
        load_executable(tmp_path / "g.json", hand)
    wrist = replace(
        grasps,
        joint_names=(*grasps.joint_names[1:], "FFJ4", "WRJ1"),
        **{name: np.pad(getattr(grasps, name), ((0, 0), (0, 1))) for name in ("posture", "pregrasp")},
    )
    save_grasps(tmp_path / "g.json", wrist, metadata={})
    with pytest.raises(InputError, match=r"has joints that shadow_hand_right lacks: WRJ1"):
        load_executable(tmp_path / "g.json", hand)
    save_grasps(tmp_path / "g.json", grasps[[]], metadata={})
    with pytest.raises(InputError, match="holds no grasps"):
        load_executable(tmp_path / "g.json", hand)


# -- units and limits


def _set_all(stored: dict[str, Any], change: Any) -> None:
    for row in stored["grasps"]:
        change(row)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda row: row["posture"].update(FFJ3=45.0), "grasp 0: posture has an angle of 45.*looks like degrees"),
        (lambda row: row["pregrasp"].update(THJ4=70.0), "pregrasp .*looks like degrees"),
        (lambda row: row["posture"].update(FFJ3=3.0, MFJ3=3.0, RFJ3=3.0), "most grasps.*posture.*look like degrees"),
        (lambda row: row["X_hand_object"].update(position_m=[1.0, -31.0, 90.0]), "95.1.* m from the palm.*millimetres"),
        (lambda row: row.update(side_m=3.0), "grasp 0: side_m is 3, but lengths are metres.*centimetres"),
        (lambda row: row.update(object_size_m=40.0), "object_size_m is 40, but lengths are metres.*millimetres"),
        (lambda row: row.update(side_m=0.0301), r"grasp 0: its side is 0\.0301 m wide, but side . of \w+ is"),
    ],
)
def test_other_units_are_refused_with_what_they_look_like(
    stored: dict[str, Any], tmp_path: Path, change: Any, word: str
) -> None:
    _set_all(stored, change)
    (tmp_path / "units.json").write_text(json.dumps(stored))
    with pytest.raises(FileFormatError, match=word) as caught:
        load_grasps(tmp_path / "units.json")
    assert len(str(caught.value).splitlines()) == 1


def test_angles_beyond_the_limits_are_kept_counted_and_told(
    stored: dict[str, Any], grasps: Grasps, hand: Hand, tmp_path: Path
) -> None:
    assert load_document(_written(stored, tmp_path)).notes == ()
    stored["grasps"][1]["posture"]["THJ3"] = 0.4
    stored["grasps"][2]["posture"] |= {"THJ3": -0.3, "FFJ2": -0.05}
    document = load_document(_written(stored, tmp_path))
    assert document.notes == (
        "posture is beyond the joint limits of shadow_hand_right in 2 grasps: "
        "FFJ2 1 (by up to 0.05 rad), THJ3 2 (by up to 0.19 rad)",
    )
    assert document.grasps.posture_by_name()["THJ3"].tolist()[1:3] == [0.4, -0.3]
    assert load_executable(tmp_path / "spoilt.json", hand).notes == document.notes


def test_rounding_beyond_a_limit_is_clipped(stored: dict[str, Any], hand: Hand, tmp_path: Path) -> None:
    stored["grasps"][0]["posture"] |= {"FFJ2": -0.0009, "FFJ3": 1.571}
    document = load_document(_written(stored, tmp_path))
    assert document.notes == ()
    assert document.grasps.posture_by_name()["FFJ2"][0] == 0.0
    assert document.grasps.posture_by_name()["FFJ3"][0] == hand.upper_rad[hand.joint_names.index("FFJ3")]


def _written(stored: dict[str, Any], folder: Path) -> Path:
    (folder / "spoilt.json").write_text(json.dumps(stored))
    return folder / "spoilt.json"


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"X_hand_object": Pose(np.full((4, 3), 1e308), np.tile([1.0, 0, 0, 0], (4, 1)))}, "from the palm"),
        ({"X_hand_object": Pose(np.zeros((4, 3)), np.tile([2.0, 0, 0, 0], (4, 1)))}, "norm 1, got norm 2"),
        ({"posture": np.full((4, 22), 30.0)}, "degrees"),
        ({"probability": np.full(4, 1.5)}, "probability is above 1"),
        ({"hand": None}, "hand is None, not a name"),
        ({"joint_names": ("FFJ4",) * 22}, "names a joint twice|lack joints"),
        ({"grasp_size_m": np.full(4, np.inf)}, "grasp_size_m"),
    ],
)
def test_values_that_no_reader_takes_are_not_written(
    grasps: Grasps, tmp_path: Path, change: dict[str, Any], word: str
) -> None:
    for name, known in FORMATS_BY_NAME.items():
        path = tmp_path / ("folder" if known.layout == "folder" else f"g{known.suffixes[0]}")
        one = replace(grasps, tasks=Tasks.repeat(Task.of("tripod", "box_medium", "x"), 4), **change)
        with pytest.raises(InputError, match=word):
            save_grasps(path, one, metadata={}, format=name, options=ExportOptions(contact="target"))
    assert list(tmp_path.iterdir()) == []


def test_postures_beyond_most_limits_are_not_written_for_a_hand(grasps: Grasps, hand: Hand, tmp_path: Path) -> None:
    far = replace(grasps, posture=np.full_like(grasps.posture, 3.0))
    with pytest.raises(InputError, match="far beyond the limits of shadow_hand_right"):
        save_grasps(tmp_path / "g.json", far, metadata={}, options=ExportOptions(hand=hand))


def test_a_place_that_is_nowhere_in_the_world_is_not_written(grasps: Grasps, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"X_world_object: a position of 1e\+308 m"):
        save_grasps(tmp_path / "g.json", grasps, metadata={}, X_world_object=Pose.of([1e308, 0, 0], [1, 0, 0, 0]))
