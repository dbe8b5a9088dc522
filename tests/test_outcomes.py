"""`Outcomes` as a record, and the faithful rule."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import as_object
from graspcascade.core.outcomes import VERDICTS, Outcomes
from graspcascade.core.tasks import Task, Tasks
from graspcascade.core.taxonomy import AREAS, DIGITS, FEIX_TYPES

flags = hnp.arrays(bool, (len(DIGITS) + 1,))
LENGTHS = {"box:30x59x20mm": 59, "box:60x30x60mm": 60, "cylinder:30x90mm": 90, "sphere:62mm": 62}
"""Objects, and how long they are across a site along x, in millimetres."""


def assert_same(a: Outcomes, b: Outcomes) -> None:
    theirs = b.columns()
    assert set(a.columns()) == set(theirs)
    for name, column in a.columns().items():
        np.testing.assert_array_equal(column, theirs[name], err_msg=name)


def test_columns_rebuild_the_outcomes(outcomes: Outcomes) -> None:
    assert_same(Outcomes.from_columns(outcomes.digits, outcomes.columns()), outcomes)
    for column in outcomes.columns().values():
        assert len(column) == len(outcomes)


@given(cut=st.integers(1, 53))
def test_slices_join_to_the_whole(outcomes: Outcomes, cut: int) -> None:
    assert_same(Outcomes.concatenate([outcomes[:cut], outcomes[cut:]]), outcomes)


def test_rows_are_selected_by_number_index_and_mask(outcomes: Outcomes) -> None:
    assert len(outcomes[3]) == 1
    assert len(outcomes[[]]) == 0
    assert outcomes[outcomes.held].held.all()
    assert_same(outcomes[[4, 2]], Outcomes.concatenate([outcomes[4], outcomes[2]]))


def test_columns_of_contacts_are_the_digits_and_the_palm(outcomes: Outcomes) -> None:
    assert outcomes.touch_columns == (*DIGITS, "palm")
    assert outcomes.touching_closed.shape == outcomes.touching_end.shape == (len(outcomes), 6)
    two = Outcomes.blank(2, 9, ("thumb", "index"))
    assert two.touch_columns == ("thumb", "index", "palm")
    assert two.touching_end.shape == (2, 3)
    assert two[1:].digits == ("thumb", "index")


def test_a_batch_is_worded_in_one_line() -> None:
    blank = Outcomes.blank(3, 22)
    blank.verdict[:2] = ["held", "missed"]
    assert repr(blank) == "<Outcomes: 3 trials, 1 held, 1 missed, 1 unstable>"
    assert repr(blank[:0]) == "<Outcomes: 0 trials, none>"


def test_blank_outcomes_claim_nothing() -> None:
    blank = Outcomes.blank(3, 22)
    assert not blank.held.any()
    assert not blank.touching_end.any()
    assert blank.areas_closed.shape == blank.areas_end.shape == (3, 5)
    assert not blank.areas_closed.any()
    assert not blank.areas_end.any()
    assert np.isnan(blank.settled_posture).all()
    for verdict in VERDICTS:
        blank.verdict[0] = verdict
        assert blank.verdict[0] == verdict, "every verdict fits"


@given(touching=flags)
def test_a_held_grasp_is_faithful_when_its_types_digits_touch(drawn: Grasps, touching: np.ndarray) -> None:
    outcomes = Outcomes.blank(len(drawn), 22)
    outcomes.touching_end[:] = touching
    assert not outcomes.faithful(drawn).any(), "only what is held can be faithful"
    outcomes.verdict[:] = "held"
    touched = {digit for digit, flag in zip(DIGITS, touching, strict=False) if flag}
    for task, faithful in zip(drawn.tasks, outcomes.faithful(drawn), strict=True):
        assert faithful == all(set(contact.digits) & touched for contact in task.grasp_type.contacts)


def test_a_grasp_is_faithful_by_where_its_digits_touch_and_how_long_the_object_is(drawn: Grasps) -> None:
    tasks = [Task(FEIX_TYPES["parallel_extension"], obj, obj.site("x")) for obj in map(as_object, LENGTHS)]
    grasps = Grasps.from_columns(drawn.hand, drawn.joint_names, Tasks.of(tasks), drawn[: len(tasks)].columns())
    outcomes = Outcomes.blank(len(tasks), 22)
    outcomes.verdict[:], outcomes.touching_end[:, :5] = "held", True
    outcomes.areas_end[:] = 1 << AREAS.index("distal_pad")
    assert outcomes.faithful(grasps).all()
    outcomes.areas_end[:, 4] = 1 << AREAS.index("distal_radial")
    assert outcomes.faithful(grasps).tolist() == [length < 85 for length in LENGTHS.values()]
    outcomes.areas_end[:, 3] = 1 << AREAS.index("proximal_pad")
    assert outcomes.faithful(grasps).tolist() == [length < 60 for length in LENGTHS.values()]


@given(first=flags, more=flags)
def test_another_touch_never_makes_a_grasp_less_faithful(drawn: Grasps, first: np.ndarray, more: np.ndarray) -> None:
    outcomes = Outcomes.blank(len(drawn), 22)
    outcomes.verdict[:] = "held"
    outcomes.touching_end[:] = first
    before = outcomes.faithful(drawn)
    outcomes.touching_end[:] |= more
    assert (outcomes.faithful(drawn) >= before).all()
