"""Recorded postures from CSV: named joints in either unit, limits, and faults with their line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspcascade.errors import FileFormatError, InputError
from graspcascade.hands import HandModel
from graspcascade.postures import LabelledPostures, export_postures, import_postures
from graspcascade.taxonomy import GRASP_TYPES


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "recorded.csv"


def angle(found: LabelledPostures, joint: str) -> list[float]:
    return found.posture[:, found.joint_names.index(joint)].tolist()


def test_degrees_radians_and_types_are_read_by_column_name(hand: HandModel, file: Path) -> None:
    file.write_text("THJ4_deg,grasp_type,FFJ3_rad\n60,tripod,0.5\n45.5,Tip Pinch,-0.1\n")
    found = import_postures(file, hand)
    assert found.joint_names == hand.joint_names
    assert found.grasp_type.tolist() == ["tripod", "tip_pinch"]
    assert angle(found, "THJ4") == pytest.approx(np.radians([60, 45.5]).tolist(), abs=1e-15)
    assert angle(found, "FFJ3") == [0.5, -0.1]
    assert found.n_clipped == 0


def test_joints_without_a_column_are_zero(hand: HandModel, file: Path) -> None:
    file.write_text("type,FFJ3_rad\ntripod,0.5\n")
    found = import_postures(file, hand)
    assert np.count_nonzero(found.posture) == 1


def test_angles_beyond_limits_are_clipped_and_counted(hand: HandModel, file: Path) -> None:
    file.write_text("type,FFJ3_deg,FFJ1_deg\ntripod,200,-5\ntripod,30,10\n")
    found = import_postures(file, hand)
    assert found.n_clipped == 2
    assert np.degrees(angle(found, "FFJ3")).tolist() == pytest.approx([90, 30])
    assert np.degrees(angle(found, "FFJ1")).tolist() == pytest.approx([0, 10])


def test_a_limit_written_with_few_digits_is_not_beyond_it(hand: HandModel, file: Path) -> None:
    file.write_text("type,FFJ3_rad\ntripod,1.5707964\n")
    found = import_postures(file, hand)
    assert found.n_clipped == 0
    assert angle(found, "FFJ3") == [np.pi / 2]


def test_a_bare_joint_name_takes_the_unit_stated(hand: HandModel, file: Path) -> None:
    file.write_text("type,ffj3\ntripod,30\n")
    assert angle(import_postures(file, hand, unit="deg"), "FFJ3") == pytest.approx([np.pi / 6])
    with pytest.raises(FileFormatError, match="'ffj3' has no unit; name it ffj3_deg or ffj3_rad"):
        import_postures(file, hand)


def test_wrist_joints_notes_blank_lines_and_a_byte_order_mark_are_passed_over(hand: HandModel, file: Path) -> None:
    file.write_text("\ufefftype,subject,WRJ1_deg,FFJ3_deg\n\ntripod,anna,20,30\n,,,\ntripod,ben,20,40\n")
    assert len(import_postures(file, hand)) == 2


@pytest.mark.parametrize("cell", ["nan", "inf", "-inf", "", "abc", "1e999", "1,5"])
def test_a_row_that_is_not_finite_is_refused_with_its_line(hand: HandModel, file: Path, cell: str) -> None:
    file.write_text(f"type,FFJ3_deg\ntripod,30\n\ntripod,{cell}\n")
    with pytest.raises(FileFormatError, match="line 4") as caught:
        import_postures(file, hand)
    assert str(file) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_an_unknown_type_is_refused_with_its_line_and_the_nearest(hand: HandModel, file: Path) -> None:
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
        ("type,FFJ3_deg,FFJ0\ntripod,3,3\n", "no joint for FFJ0"),
        ("type,FFJ3_deg,FFJ3_rad\ntripod,3,3\n", "FFJ3 a second time"),
        ("type,FFJ3_deg\n", "holds no postures"),
        ("type,FFJ3_deg\ntripod\n", "line 2 has 1 fields, the header 2"),
    ],
)
def test_a_table_that_is_none_of_postures_is_refused(hand: HandModel, file: Path, text: str, word: str) -> None:
    file.write_text(text)
    with pytest.raises(FileFormatError, match=word):
        import_postures(file, hand)


def test_a_missing_or_binary_file_is_refused(hand: HandModel, file: Path) -> None:
    with pytest.raises(InputError, match="no file"):
        import_postures(file, hand)
    file.write_bytes(b"\xff\xfe\x00\x01" * 20)
    with pytest.raises(FileFormatError, match="not a CSV file"):
        import_postures(file, hand)


@given(st.integers(0, 2**32 - 1))
def test_exported_postures_come_back_the_same(
    hand: HandModel, tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    posture = rng.uniform(hand.lower_rad, hand.upper_rad, (5, len(hand.joint_names)))
    posture[0], posture[1] = hand.lower_rad, hand.upper_rad
    made = LabelledPostures(hand.joint_names, posture, rng.choice(list(GRASP_TYPES), 5))
    path = tmp_path_factory.mktemp("postures") / "made.csv"
    export_postures(path, made)
    found = import_postures(path, hand)
    np.testing.assert_array_equal(found.posture, made.posture)
    np.testing.assert_array_equal(found.grasp_type, made.grasp_type)
    assert found.n_clipped == 0


def test_exporting_into_a_missing_folder_is_refused_and_leaves_nothing(hand: HandModel, tmp_path: Path) -> None:
    made = LabelledPostures(hand.joint_names, np.zeros((1, len(hand.joint_names))), np.array(["tripod"]))
    with pytest.raises(InputError, match="does not exist"):
        export_postures(tmp_path / "absent" / "made.csv", made)
    with pytest.raises(ValueError, match="zip"):
        export_postures(tmp_path / "made.csv", replace(made, grasp_type=np.array(["tripod", "tripod"])))
    assert list(tmp_path.iterdir()) == []
