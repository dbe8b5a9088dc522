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
from graspcascade.errors import FileFormatError, InputError
from graspcascade.formats import FORMATS, FORMATS_BY_NAME, load_document, load_grasps, save_grasps
from graspcascade.grasps import Grasps
from graspcascade.poses import Pose, canonical_quat, rotation_angle

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
    assert one.joint_names == other.joint_names
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
def test_json_is_exact_for_any_grasps(drawn: Grasps, tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, joints = len(drawn), len(drawn.joint_names)
    scale = 10.0 ** rng.uniform(-12, 2, (n, joints))
    changed = replace(
        drawn,
        posture=rng.normal(size=(n, joints)) * scale,
        X_hand_object=Pose(rng.normal(size=(n, 3)), canonical_quat(rng.normal(size=(n, 4)))),
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
    assert set(stored["objects"]) == set(grasps.object_label.tolist())
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
    with pytest.raises(InputError, match=rf"X_world_object: one pose.*got \({n_poses}, 3\)"):
        save_grasps(path, grasps, metadata={}, X_world_object=several, format=name)
    assert list(tmp_path.iterdir()) == []


def test_parquet_without_pyarrow_names_the_extra(
    grasps: Grasps, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"graspcascade\[train\]"):
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
        (["quaternion_order"], "xyzw", "xyzw"),
        (["joint_names"], "FFJ4", "joint_names"),
        (["joint_names"], ["FFJ4", "FFJ4"], "twice"),
        (["metadata"], None, "metadata"),
        (["grasps"], {"a": 1}, "grasps is not a list"),
        (["grasps", 1], 5, "grasp 1"),
        (["grasps", 1, "posture", "THJ4"], None, "grasp 1: lacks 'THJ4'"),
        (["grasps", 1, "posture", "XXJ1"], 0.1, "grasp 1: posture has joints.*XXJ1"),
        (["grasps", 1, "posture", "THJ4"], "wide", "grasp 1: THJ4 is 'wide'"),
        (["grasps", 1, "posture", "THJ4"], True, "grasp 1: THJ4"),
        (["grasps", 1, "posture", "THJ4"], 10**400, "grasp 1"),
        (["grasps", 2, "grasp_type"], "tripodd", "grasp 2: .*Did you mean 'tripod'"),
        (["grasps", 2, "object_label"], "box_mediun", "grasp 2: .*Did you mean 'box_medium'"),
        (["grasps", 2, "side_axis"], "q", "grasp 2: unknown side axis 'q'"),
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


def test_a_quaternion_with_negative_w_is_read_as_the_same_rotation(
    stored: dict[str, Any], grasps: Grasps, tmp_path: Path
) -> None:
    quat = stored["grasps"][0]["X_hand_object"]["quat_wxyz"]
    stored["grasps"][0]["X_hand_object"]["quat_wxyz"] = [-part for part in quat]
    (tmp_path / "turned.json").write_text(json.dumps(stored))
    found = load_grasps(tmp_path / "turned.json").X_hand_object.quat_wxyz[0]
    assert found[0] >= 0
    np.testing.assert_allclose(found, grasps.X_hand_object.quat_wxyz[0], atol=1e-15)
