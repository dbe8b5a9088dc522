"""Recorded postures from CSV: named joints in either unit, limits, and faults with their line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.hands import Hand
from graspcascade.studies.postures import LabelledPostures, export_postures, import_postures


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "recorded.csv"


def angle(postures: LabelledPostures, joint: str) -> list[float]:
    return postures.posture[:, postures.joint_names.index(joint)].tolist()


def test_degrees_radians_and_types_are_read_by_column_name(hand: Hand, file: Path) -> None:
    file.write_text("THJ4_deg,grasp_type,FFJ3_rad\n60,tripod,0.5\n45.5,Tip Pinch,-0.1\n")
    postures = import_postures(file, hand)
    assert postures.joint_names == hand.joint_names
    assert postures.grasp_type.tolist() == ["tripod", "tip_pinch"]
    assert angle(postures, "THJ4") == pytest.approx(np.radians([60, 45.5]).tolist(), abs=1e-15)
    assert angle(postures, "FFJ3") == [0.5, -0.1]
    assert postures.n_clipped == 0


def test_joints_without_a_column_are_zero(hand: Hand, file: Path) -> None:
    file.write_text("type,FFJ3_rad\ntripod,0.5\n")
    postures = import_postures(file, hand)
    assert np.count_nonzero(postures.posture) == 1


def test_angles_beyond_limits_are_clipped_and_counted(hand: Hand, file: Path) -> None:
    file.write_text("type,FFJ3_deg,FFJ1_deg\ntripod,200,-5\ntripod,30,10\n")
    postures = import_postures(file, hand)
    assert postures.n_clipped == 2
    assert postures.clipped == {"FFJ3": 1, "FFJ1": 1}
    assert np.degrees(angle(postures, "FFJ3")).tolist() == pytest.approx([90, 30])
    assert np.degrees(angle(postures, "FFJ1")).tolist() == pytest.approx([0, 10])


def test_a_limit_written_with_few_digits_is_not_beyond_it(hand: Hand, file: Path) -> None:
    file.write_text("type,FFJ3_rad\ntripod,1.5707964\n")
    postures = import_postures(file, hand)
    assert postures.n_clipped == 0
    assert angle(postures, "FFJ3") == [np.pi / 2]


def test_a_bare_joint_name_takes_the_unit_stated(hand: Hand, file: Path) -> None:
    file.write_text("type,ffj3\ntripod,30\n")
    assert angle(import_postures(file, hand, unit="deg"), "FFJ3") == pytest.approx([np.pi / 6])
    with pytest.raises(FileFormatError, match="'ffj3' has no unit; name it ffj3_deg or ffj3_rad"):
        import_postures(file, hand)


@pytest.mark.parametrize("prefix", ["rh_", "robot0:", "robot0:RH_", "/hand/"])
def test_a_prefix_that_all_joints_share_is_dropped(hand: Hand, file: Path, prefix: str) -> None:
    file.write_text(f"type,{prefix}FFJ3_deg,{prefix}THJ4_rad,{prefix}WRJ1_deg,speed\ntripod,30,0.5,3,4\n")
    postures = import_postures(file, hand)
    assert angle(postures, "FFJ3") == pytest.approx([np.pi / 6])
    assert angle(postures, "THJ4") == [0.5]
    assert np.count_nonzero(postures.posture) == 2


def test_a_coupled_column_is_shared_equally_by_its_joints(hand: Hand, file: Path) -> None:
    file.write_text("type,rh_FFJ0_deg,rh_MFJ0_rad\ntripod,120,1.5\ntripod,200,0.5\n")
    postures = import_postures(file, hand)
    for joint in ("FFJ2", "FFJ1"):
        assert np.degrees(angle(postures, joint)).tolist() == pytest.approx([60, 90])
    for joint in ("MFJ2", "MFJ1"):
        assert angle(postures, joint) == [0.75, 0.25]
    assert postures.clipped == {"FFJ2": 1, "FFJ1": 1}


@pytest.mark.parametrize(
    ("header", "rows", "words"),
    [
        ("FFJ3_rad,FFJ2_rad", ["0.5,41.5"], "in radians look like degrees, the largest is 41.5 under FFJ2_rad; .*_deg"),
        ("FFJ3_rad,FFJ2_rad", ["4,5", "3.5,1.2"], "in radians look like degrees, the largest is 5 under FFJ2_rad"),
        ("FFJ3_deg,FFJ0_deg", ["0.5,1.9", "1.2,-0.1"], "in degrees look like radians, the largest is 1.2 .*FFJ3_deg"),
        ("FFJ3,FFJ2", ["0.5,1.5"], "in degrees look like radians.* or state --unit rad"),
    ],
)
def test_angles_that_look_like_the_other_unit_are_refused(
    hand: Hand, file: Path, header: str, rows: list[str], words: str
) -> None:
    file.write_text("\n".join([f"type,{header}", *(f"tripod,{row}" for row in rows)]))
    with pytest.raises(FileFormatError, match=words) as caught:
        import_postures(file, hand, unit="deg")
    assert str(file) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("FFJ3_rad,FFJ2_rad,FFJ4_rad", "1.65,1.6,0.4"),  # a few degrees beyond every limit
        ("FFJ4_deg,MFJ4_deg", "1.5,-1.2"),  # far beyond the limits if they were radians
        ("FFJ3_deg,FFJ2_deg", "0,0"),
        ("FFJ3_deg,FFJ2_deg", "1.5,2.5"),
        ("FFJ3_deg,FFJ2_rad", "60,0.5"),
    ],
)
def test_small_angles_in_degrees_and_a_little_overshoot_in_radians_are_read(
    hand: Hand, file: Path, header: str, row: str
) -> None:
    file.write_text(f"type,{header}\ntripod,{row}\n")
    assert len(import_postures(file, hand)) == 1


@given(seed=st.integers(0, 2**32 - 1))
def test_random_postures_are_told_from_the_other_unit(
    hand: Hand, tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    posture = rng.uniform(hand.lower_rad, hand.upper_rad, (5, len(hand.joint_names)))
    path = tmp_path_factory.mktemp("postures") / "made.csv"
    export_postures(path, LabelledPostures(hand.joint_names, np.degrees(posture), np.full(5, "tripod")))
    with pytest.raises(FileFormatError, match="in radians look like degrees"):
        import_postures(path, hand)
    path.write_text(path.read_text().replace("_rad", "_deg"))
    np.testing.assert_allclose(import_postures(path, hand).posture, posture, atol=1e-12)
    export_postures(path, LabelledPostures(hand.joint_names, posture, np.full(5, "tripod")))
    path.write_text(path.read_text().replace("_rad", "_deg"))
    with pytest.raises(FileFormatError, match="in degrees look like radians"):
        import_postures(path, hand)


def test_wrist_joints_notes_blank_lines_and_a_byte_order_mark_are_passed_over(hand: Hand, file: Path) -> None:
    file.write_text("\ufefftype,subject,WRJ1_deg,FFJ3_deg\n\ntripod,anna,20,30\n,,,\ntripod,ben,20,40\n")
    assert len(import_postures(file, hand)) == 2


@pytest.mark.parametrize("cell", ["nan", "inf", "-inf", "", "abc", "1e999", "1,5"])
def test_a_row_that_is_not_finite_is_refused_with_its_line(hand: Hand, file: Path, cell: str) -> None:
    file.write_text(f"type,FFJ3_deg\ntripod,30\n\ntripod,{cell}\n")
    with pytest.raises(FileFormatError, match="line 4") as caught:
        import_postures(file, hand)
    assert str(file) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_an_unknown_type_is_refused_with_its_line_and_the_nearest(hand: Hand, file: Path) -> None:
    file.write_text("type,FFJ3_deg\ntripod,30\ntripodd,30\n")
    with pytest.raises(FileFormatError, match=r"line 3: .*Did you mean 'tripod'"):
        import_postures(file, hand)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "needs one column grasp_type"),
        ("FFJ3_deg\n30\n", "needs one column grasp_type"),
        ("type,grasp_type,FFJ3_deg\ntripod,tripod,30\n", "has 2"),
        ("type,speed\ntripod,3\n", "no joint column.*FFJ4"),
        ("type,FFJ3_deg,FFJ9_deg\ntripod,3,3\n", "no joint for FFJ9_deg.*Nearest: FFJ"),
        ("type,FFJ3_deg,thumb_rad\ntripod,3,3\n", "no joint for thumb_rad"),
        ("type,FFJ3_deg,FFJ8\ntripod,3,3\n", "no joint for FFJ8.*Nearest: FFJ"),
        ("type,rh_FFJ3_deg,rh_THJ44_deg\ntripod,3,3\n", "no joint for rh_THJ44_deg.*Nearest: THJ4"),
        ("type,FFJ3_deg,TJ4_rad\ntripod,3,3\n", "no joint for TJ4_rad.*Nearest: THJ4"),
        ("type,FFJ3_deg,FFJ3_rad\ntripod,3,3\n", "FFJ3 a second time"),
        ("type,FFJ0_deg,FFJ1_deg\ntripod,3,3\n", "'FFJ1_deg' gives joint FFJ1 a second time"),
        ("type,FFJ1_deg,FFJ0_deg\ntripod,3,3\n", "'FFJ0_deg' gives joint FFJ1 a second time"),
        ("type,rh_FFJ3_deg,FFJ4_deg\ntripod,3,3\n", "'rh_FFJ3_deg' and 'FFJ4_deg' must have the same prefix"),
        ("type,lh_FFJ3\ntripod,3\n", "'lh_FFJ3' is of a left hand; recordings of a right hand are needed"),
        ("type,robot0:left_FFJ3_deg\ntripod,3\n", "of a left hand"),
        ("type,FFJ3_deg\n", "holds no postures"),
        ("type,FFJ3_deg\ntripod\n", "line 2: 1 fields, the header has 2"),
    ],
)
def test_a_table_that_is_none_of_postures_is_refused(hand: Hand, file: Path, text: str, word: str) -> None:
    file.write_text(text)
    with pytest.raises(FileFormatError, match=word):
        import_postures(file, hand)


def test_a_missing_or_binary_file_is_refused(hand: Hand, file: Path) -> None:
    with pytest.raises(InputError, match="no file"):
        import_postures(file, hand)
    file.write_bytes(b"\xff\xfe\x00\x01" * 20)
    with pytest.raises(FileFormatError, match="not a CSV file"):
        import_postures(file, hand)


@given(st.integers(0, 2**32 - 1))
def test_exported_postures_come_back_the_same(hand: Hand, tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    rng = np.random.default_rng(seed)
    posture = rng.uniform(hand.lower_rad, hand.upper_rad, (5, len(hand.joint_names)))
    posture[0], posture[1] = hand.lower_rad, hand.upper_rad
    made = LabelledPostures(hand.joint_names, posture, rng.choice(list(GRASP_TYPES), 5))
    path = tmp_path_factory.mktemp("postures") / "made.csv"
    export_postures(path, made)
    postures = import_postures(path, hand)
    np.testing.assert_array_equal(postures.posture, made.posture)
    np.testing.assert_array_equal(postures.grasp_type, made.grasp_type)
    assert postures.n_clipped == 0


def test_exporting_into_a_missing_folder_is_refused_and_leaves_nothing(hand: Hand, tmp_path: Path) -> None:
    made = LabelledPostures(hand.joint_names, np.zeros((1, len(hand.joint_names))), np.array(["tripod"]))
    with pytest.raises(InputError, match="does not exist"):
        export_postures(tmp_path / "absent" / "made.csv", made)
    with pytest.raises(ValueError, match="zip"):
        export_postures(tmp_path / "made.csv", replace(made, grasp_type=np.array(["tripod", "tripod"])))
    assert list(tmp_path.iterdir()) == []
