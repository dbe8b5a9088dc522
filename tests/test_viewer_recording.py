"""Recordings: the same trial as `run`, frame by frame."""

from dataclasses import replace

import numpy as np
import pytest

from graspcascade.core.grasps import Grasps
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.protocols import PAPER, Carry, Close, Protocol, Shake
from graspcascade.hands import Hand
from graspcascade.viewer import Recording, record


@pytest.fixture(scope="module")
def some(drawn: Grasps, outcomes: Outcomes) -> tuple[Grasps, Outcomes]:
    """Choose trials of every verdict there is, two each."""
    rows = np.concatenate([np.flatnonzero(outcomes.verdict == verdict)[:2] for verdict in np.unique(outcomes.verdict)])
    return drawn[rows], outcomes[rows]


@pytest.fixture(scope="module")
def recordings(some: tuple[Grasps, Outcomes], hand: Hand, short: Protocol) -> list[Recording]:
    return record(some[0], hand, short)


def test_recording_a_trial_does_not_change_it(some: tuple[Grasps, Outcomes], recordings: list[Recording]) -> None:
    assert len({str(verdict) for verdict in some[1].verdict}) > 2
    held = some[1].held
    for name, column in some[1].columns().items():
        seen = np.concatenate([recording.outcome.columns()[name] for recording in recordings])
        if name in ("displacement_m", "turn_rad", "duration_s"):
            # A recording is looked at more often, so that it sees sooner what falls, and shows digits that are idle.
            np.testing.assert_allclose(seen[held], column[held], atol=1e-4, err_msg=name)
            assert name == "turn_rad" or (seen[~held] <= column[~held] + 1e-4).all()
        else:
            np.testing.assert_array_equal(seen, column, err_msg=name)


def test_frames_go_from_the_start_to_the_end_of_the_trial(
    some: tuple[Grasps, Outcomes], recordings: list[Recording]
) -> None:
    for row, recording in enumerate(recordings):
        np.testing.assert_array_equal(recording.posture[0], some[0].pregrasp[row])
        np.testing.assert_allclose(recording.X_hand_object.position_m[0], some[0].X_hand_object.position_m[row])
        assert recording.time_s[0] == 0
        assert recording.time_s[-1] == pytest.approx(recording.outcome.duration_s[0])
        np.testing.assert_allclose(np.diff(recording.time_s), 0.02)
        assert recording.posture.shape == (len(recording), some[0].posture.shape[1])
        assert len(recording) == round(recording.outcome.duration_s[0] / 0.02) + 1


def test_the_frame_at_closing_is_the_settled_state(recordings: list[Recording], short: Protocol) -> None:
    closed = [r for r in recordings if np.isfinite(r.outcome.settled_posture).all()]
    assert closed
    for recording in closed:
        frame = recording.frame(recording.row_at(short.schedule.closing_steps * short.physics.time_step_s))
        np.testing.assert_array_equal(frame.posture, recording.outcome.settled_posture[0])
        np.testing.assert_array_equal(
            frame.X_hand_object.position_m, recording.outcome.X_hand_object_settled.position_m[0]
        )


def full_length(recording: Recording, protocol: Protocol) -> Recording:
    """Stretch a recording over every step of a held trial."""
    return replace(recording, protocol=protocol, steps=np.arange(protocol.schedule.total_steps + 1))


def test_phases_come_in_the_order_of_the_protocol(recordings: list[Recording]) -> None:
    whole = full_length(recordings[0], PAPER)
    phases = [whole.phase(row)[1] for row in range(len(whole))]
    expected = ["start", "closing", "holding still", *(f"shake along {axis}" for axis in "xyz"), "carry"]
    assert list(dict.fromkeys(phases)) == expected
    assert [phases.count(name) for name in expected] == [1, 125, 50, 167, 167, 166, 1250]
    assert isinstance(whole.phase(0)[0], Close)


def test_phases_are_the_protocols_whatever_their_order(recordings: list[Recording]) -> None:
    turned = Protocol("turned", (Close(0.1, 0.0), Carry(0.2), Shake(cycles=1), Carry(0.1)))
    whole = full_length(recordings[0], turned)
    kinds = [type(whole.phase(row)[0]).__name__ for row in range(1, len(whole))]
    assert [kinds.count(name) for name in ("Close", "Carry", "Shake")] == [25, 75, 250]
    moved = np.flatnonzero(whole.base_m.any(axis=1))
    assert 75 < moved.min() < moved.max() < 75 + 250


def test_the_base_moves_as_the_field_of_the_shake_says(recordings: list[Recording]) -> None:
    moved, schedule = full_length(recordings[0], PAPER).base_m, PAPER.schedule
    shake, step_s = PAPER.phases[1], PAPER.physics.time_step_s
    assert isinstance(shake, Shake)
    first, last = schedule.ends[0], schedule.ends[1]
    assert not moved[: first + 1].any()
    assert not moved[last:].any()
    assert ((np.abs(moved) > 1e-12).sum(axis=1) <= 1).all()
    np.testing.assert_allclose(np.abs(moved).max(axis=0), shake.amplitude_m, rtol=0.01)
    # Away from the changes of axis, acceleration is the opposite of the field that stands for it.
    acceleration = np.diff(moved, n=2, axis=0) / step_s**2
    field = (schedule.acceleration[1:] + schedule.acceleration[:-1]) / 2
    steps = np.arange(first + 2, first + 160)
    np.testing.assert_allclose(acceleration[steps - 1], -field[steps - 1], atol=0.05)


def test_a_time_finds_its_frame(recordings: list[Recording]) -> None:
    longest = max(recordings, key=len)
    assert longest.row_at(-1.0) == 0
    assert longest.row_at(1e9) == len(longest) - 1
    assert [longest.row_at(float(time)) for time in longest.time_s] == list(range(len(longest)))
    assert longest.row_at(0.021) == 1


def test_an_overlap_is_one_frame(drawn: Grasps, hand: Hand, short: Protocol) -> None:
    inside = drawn[[0]]  # a list of rows copies: the shared grasps stay as they are
    inside.X_hand_object.position_m[:] = [0.01, 0.0, 0.05]
    (recording,) = record(inside, hand, short)
    assert (str(recording.outcome.verdict[0]), len(recording)) == ("overlap", 1)
