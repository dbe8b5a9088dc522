"""Protocols: phases and numbers, conditions of single trials, and that the shake is what a really moving base does."""

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import GraspObject
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.poses import as_rotation
from graspcascade.core.protocols import (
    HOLD,
    PAPER,
    SIX_DIRECTIONS,
    VARIED,
    Carry,
    Close,
    Conditions,
    Physics,
    Protocol,
    Push,
    Shake,
    Squeeze,
    Variation,
    as_protocol,
)
from graspcascade.hands import Hand
from graspcascade.worlds.world import World, build_world
from hand_files import edited

STEP_S = 0.004
CLOSING, SHAKEN, TOTAL = 175, 675, 1925
STEPS_PER_SHAKE_AXIS = 500 / 3


def shaken_axis(step: int) -> int:
    """Name the axis that is shaken during a step of the paper protocol's shake, counted from its start."""
    return int(step / STEPS_PER_SHAKE_AXIS)


def test_the_paper_protocol_is_the_papers() -> None:
    assert as_protocol("paper") is PAPER
    assert as_protocol(PAPER) is PAPER
    assert PAPER.phases == (Close(0.5, 0.2), Shake(0.020, 3.0, 2), Carry(5.0, 9.81))
    assert (PAPER.overlap_m, PAPER.displacement_m) == (0.001, 0.050)
    assert PAPER.physics == Physics(
        time_step_s=STEP_S,
        friction=0.8,
        torsional_friction_m=0.005,
        contact_time_constant_s=0.01,
        impratio=10.0,
        gain_factor=3.0,
        density_factor=1.0,
    )


def test_the_paper_protocols_schedule_is_closing_shake_and_carrying() -> None:
    schedule = PAPER.schedule
    assert schedule.ends == (CLOSING, SHAKEN, TOTAL)
    assert np.diff([0, *schedule.ends]).tolist() == [175, 500, 1250]
    assert (schedule.closing_steps, schedule.carry_begins, schedule.total_steps) == (CLOSING, SHAKEN, TOTAL)
    assert schedule.phase.tolist() == [0] * 175 + [1] * 500 + [2] * 1250
    assert schedule.fraction.shape == (TOTAL,)
    assert (schedule.fraction[CLOSING:] == 1.0).all()
    assert schedule.acceleration.shape == (TOTAL, 3)
    assert schedule.total_steps * STEP_S == pytest.approx(7.7)


def test_what_is_lost_is_named_by_the_phase_it_was_lost_in() -> None:
    steps = np.array([CLOSING + 1, SHAKEN, SHAKEN + 1, TOTAL])
    assert PAPER.schedule.lost(steps).tolist() == ["shaken_out", "shaken_out", "dropped", "dropped"]


def test_an_unknown_protocol_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"unknown protocol 'papers'\. Did you mean 'paper'\?"):
        as_protocol("papers")


# -- protocols in files


OTHERS = [
    PAPER,
    VARIED,
    SIX_DIRECTIONS,
    replace(VARIED, name="only pushed", variation=Variation(position_sd_m=0.001)),
    Protocol("still", (Close(), Carry(1.0))),
    Protocol("shaken only", (Close(0.3, 0.0), Shake(cycles=1)), overlap_m=0.002, displacement_m=0.03),
    Protocol(
        "twice", (Close(), Carry(1.0), Shake(), Carry(2.0, 1.6)), physics=Physics(friction=0.5, time_step_s=0.002)
    ),
]


def test_records_of_the_other_protocols_say_nothing_of_what_only_pushes_need() -> None:
    for protocol in (PAPER, HOLD, VARIED):
        assert set(protocol.to_json()) == {"name", "phases", "overlap_m", "displacement_m", "physics", "variation"}
        assert set(protocol.to_json()["physics"]) == {
            *("time_step_s", "friction", "torsional_friction_m", "contact_time_constant_s"),
            *("impratio", "noslip_iterations", "gain_factor", "density_factor"),
        }


def test_six_directions_are_those_of_the_rule() -> None:
    rule, physics = SIX_DIRECTIONS, SIX_DIRECTIONS.physics
    assert [phase.kind for phase in rule.phases] == ["close", "squeeze", "push"] * 6
    pushes = [phase for phase in rule.phases if isinstance(phase, Push)]
    assert [(one.direction, one.force_n, one.duration_s) for one in pushes] == [
        (f"{sign}{axis}", 1.0, 2.0) for axis in "xyz" for sign in "-+"
    ]
    assert np.diff([0, *rule.schedule.ends]).tolist() == [100, 100, 500] * 6
    assert rule.schedule.restarts == [700, 1400, 2100, 2800, 3500]
    assert (rule.overlap_m, rule.displacement_m, rule.turn_rad) == (0.010, 0.050, pytest.approx(np.radians(15)))
    assert (physics.friction, physics.torsional_friction_m, physics.impratio) == (0.6, 0.02, 10.0)
    assert (physics.time_step_s, physics.object_mass_kg) == (0.004, 0.1)
    assert (physics.gain_nm_per_rad, physics.force_limit_nm, physics.joint_friction_nm) == (5.0, 3.0, 0.01)
    assert not rule.schedule.acceleration.any()
    np.testing.assert_allclose(np.linalg.norm(rule.schedule.force, axis=1), [*[0.0] * 200, *[1.0] * 500] * 6)


@pytest.mark.parametrize("finder", [SIX_DIRECTIONS, replace(HOLD, turn_rad=1.0)])
def test_contact_is_found_by_one_plain_closing(finder: Protocol) -> None:
    with pytest.raises(InputError, match=f"not by protocol {finder.name}"):
        replace(SIX_DIRECTIONS, contact_by=finder)


def test_an_unknown_direction_is_refused() -> None:
    with pytest.raises(InputError, match=r"unknown direction of a push 'up'.*-x, \+x"):
        Push("up")


@pytest.mark.parametrize("protocol", OTHERS, ids=lambda protocol: protocol.name)
def test_a_protocol_survives_the_way_through_plain_data(protocol: Protocol) -> None:
    again = Protocol.from_json(protocol.to_json())
    assert again == protocol
    # A study compares what it is asked for with what its folder says.
    assert json.loads(json.dumps(protocol.to_json())) == protocol.to_json()
    assert again.schedule.ends == protocol.schedule.ends


def test_the_flat_record_of_earlier_versions_reads_as_the_paper_protocol() -> None:
    flat = {
        "name": "paper",
        "time_step_s": 0.004,
        "overlap_m": 0.001,
        "close_s": 0.5,
        "settle_s": 0.2,
        "shake_amplitude_m": 0.02,
        "shake_frequency_hz": 3.0,
        "shake_cycles": 2,
        "gravity_m_s2": 9.81,
        "gravity_s": 5.0,
        "displacement_m": 0.05,
        "friction": 0.8,
        "torsional_friction_m": 0.005,
        "contact_time_constant_s": 0.01,
        "impratio": 10.0,
        "gain_factor": 3.0,
        "density_factor": 1.0,
    }
    record = dict(flat)
    assert Protocol.from_json(record) == PAPER
    assert record == flat, "reading leaves the record alone"
    other = Protocol.from_json(flat | {"name": "varied", "friction": 0.6, "gravity_s": 2.0, "shake_cycles": 1})
    assert other == Protocol("varied", (Close(), Shake(cycles=1), Carry(2.0)), physics=Physics(friction=0.6))


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"phases": [{"phase": "throw"}]}, InputError),
        ({"phases": [{"phase": "close", "wobble": 1}]}, TypeError),
        ({"physics": {"gravity": 1}}, TypeError),
        ({"physics": {"friction": -1.0}}, InputError),
        ({"surprise": 1}, TypeError),
    ],
)
def test_plain_data_that_is_no_protocol_is_refused(change: dict, error: type[Exception]) -> None:
    with pytest.raises(error):
        Protocol.from_json(PAPER.to_json() | change)


# -- numbers


@pytest.mark.parametrize(
    "number",
    [
        (kind, part.name)
        for kind in (Close, Shake, Carry, Squeeze, Push, Physics)
        for part in fields(kind)
        if part.name != "direction"
    ],
)
def test_no_number_of_a_protocol_is_negative_or_endless(number: tuple[type, str]) -> None:
    kind, name = number
    for wrong in (-0.001, float("nan"), float("inf"), float("-inf")):
        with pytest.raises(InputError, match=f"{name} must be a finite number"):
            kind(**{name: wrong})


@pytest.mark.parametrize("name", ["overlap_m", "displacement_m", "turn_rad"])
@pytest.mark.parametrize("wrong", [-0.001, float("nan"), float("inf")])
def test_the_criterion_is_neither_negative_nor_endless(name: str, wrong: float) -> None:
    with pytest.raises(InputError, match=f"{name} must be a finite number"):
        replace(PAPER, **{name: wrong})


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (Physics, "time_step_s"),
        (Physics, "density_factor"),
        (Physics, "gain_factor"),
        (Physics, "object_mass_kg"),
        (Physics, "gain_nm_per_rad"),
        (Physics, "force_limit_nm"),
        (Close, "ramp_s"),
        (Shake, "frequency_hz"),
    ],
)
def test_what_no_trial_can_do_without_is_above_zero(kind: type, name: str) -> None:
    with pytest.raises(InputError, match=f"{name} must be a finite number above 0, got 0"):
        kind(**{name: 0})


@pytest.mark.parametrize(
    ("phases", "message"),
    [
        ((), "begins with its one closing phase, got phases none"),
        ((Shake(), Carry()), "begins with its one closing phase, got phases shake, carry"),
        ((Close(), Close(), Carry()), "begins with its one closing phase"),
        ((Carry(), Close()), "begins with its one closing phase"),
        ((Close(),), "at least one time step of 0.004 s"),
        ((Close(0.001, 0.0), Carry()), "at least one time step"),
        ((Close(), Shake(cycles=0), Carry(0.0)), "at least one time step"),
    ],
)
def test_a_protocol_that_does_not_close_and_then_try_is_refused(phases: tuple, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Protocol("wrong", phases)


def test_half_a_shake_is_refused() -> None:
    with pytest.raises(InputError, match=r"whole number, got 1\.5"):
        Shake(cycles=1.5)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "phases",
    [(Close(), Shake(cycles=0), Carry()), (Close(), Shake(), Carry(0.0)), (Close(settle_s=0.0), Shake(), Carry())],
)
def test_what_a_trial_can_do_without_may_be_zero(phases: tuple) -> None:
    schedule = Protocol("varied", phases, overlap_m=0.0).schedule
    assert schedule.acceleration.shape == (schedule.total_steps, 3)
    assert (schedule.acceleration[schedule.ends[1] :] == [0.0, 0.0, -9.81]).all()


def test_other_physics_keep_the_phases_and_take_a_name() -> None:
    harder = PAPER.with_physics("paper, friction 0.5", friction=0.5, gain_factor=1.0)
    assert (harder.name, harder.phases) == ("paper, friction 0.5", PAPER.phases)
    assert harder.physics == replace(PAPER.physics, friction=0.5, gain_factor=1.0)
    with pytest.raises(InputError, match=r"unknown number of physics .*Did you mean .friction."):
        PAPER.with_physics("wrong", frictoin=0.5)
    with pytest.raises(InputError, match="friction must be a finite number"):
        PAPER.with_physics("wrong", friction=-0.5)


# -- phases


@given(time_step_s=st.sampled_from([0.001, 0.002, 0.003, 0.004, 0.005]), ramp_s=st.sampled_from([0.2, 0.5, 1.0]))
def test_the_targets_ramp_evenly_from_pregrasp_to_posture_and_stay(time_step_s: float, ramp_s: float) -> None:
    fraction = Close(ramp_s, 0.2).fraction(time_step_s)
    assert fraction.shape == (round((ramp_s + 0.2) / time_step_s),)
    assert 0 < fraction[0] <= 1.001 * time_step_s / ramp_s
    assert (np.diff(fraction) >= 0).all()
    ramp = fraction[: int(ramp_s / time_step_s) - 1]
    np.testing.assert_allclose(np.diff(ramp), time_step_s / ramp_s)
    assert (fraction[round(ramp_s / time_step_s) :] == 1).all()


def test_there_is_no_weight_while_closing_and_full_weight_after_the_shake() -> None:
    acceleration = PAPER.schedule.acceleration
    assert not acceleration[:CLOSING].any()
    assert (acceleration[SHAKEN:] == [0.0, 0.0, -9.81]).all()


def test_the_shake_is_two_cycles_of_the_stated_amplitude_along_each_axis_in_turn() -> None:
    shake = PAPER.schedule.acceleration[CLOSING:SHAKEN]
    peak = 0.020 * (2 * np.pi * 3.0) ** 2
    axes = np.array([shaken_axis(step) for step in range(len(shake))])
    for axis in range(3):
        rows = axes == axis
        assert not np.delete(shake[rows], axis, axis=1).any(), "one axis at a time"
        field = shake[rows, axis]
        assert field.max() == pytest.approx(peak, rel=2e-3)
        assert field.min() == pytest.approx(-peak, rel=2e-3)
        # Two full cycles push to either side twice and leave no velocity behind.
        pushed = np.sign(field[np.abs(field) > 0.5 * peak])
        assert pushed[np.flatnonzero(np.diff(pushed, prepend=0))].tolist() == [1, -1, 1, -1]
        assert abs(field.sum() * STEP_S) < 0.01 * peak / (2 * np.pi * 3.0)


@given(amplitude=st.floats(0.001, 0.1), frequency=st.sampled_from([1.0, 2.0, 3.0, 5.0]), cycles=st.integers(1, 4))
def test_the_shakes_peak_is_amplitude_times_angular_frequency_squared(
    amplitude: float, frequency: float, cycles: int
) -> None:
    shake = Shake(amplitude, frequency, cycles)
    field = shake.acceleration(STEP_S)
    assert np.abs(field).max() == pytest.approx(amplitude * (2 * np.pi * frequency) ** 2, rel=5e-3)
    assert len(field) == shake.n_steps(STEP_S)
    assert len(field) * STEP_S == pytest.approx(3 * cycles / frequency, abs=STEP_S)


def test_an_object_left_alone_in_the_field_moves_as_seen_from_the_oscillating_base() -> None:
    """Integrate the field twice: a free body must trace A (w t - sin w t) about a base that moves as A sin(w t)."""
    shake = PAPER.schedule.acceleration[CLOSING:SHAKEN, 0]
    n = int(STEPS_PER_SHAKE_AXIS)
    velocity = np.cumsum(shake[:n]) * STEP_S
    position = np.cumsum(velocity) * STEP_S
    time, omega = np.arange(1, n + 1) * STEP_S, 2 * np.pi * 3.0
    expected = 0.020 * (omega * time - np.sin(omega * time))
    np.testing.assert_allclose(position, expected, atol=0.02 * 0.020 * omega)


# -- conditions of single trials


@pytest.fixture(scope="module")
def drawn_conditions() -> Conditions:
    conditions = VARIED.conditions(4000, 7)
    assert conditions is not None
    return conditions


def test_varied_draws_what_it_says(drawn_conditions: Conditions) -> None:
    c = drawn_conditions
    for column, low, high in ((c.friction, 0.5, 1.0), (c.size_error_m, -0.001, 0.001)):
        np.testing.assert_array_less(np.abs(column - (low + high) / 2), (high - low) / 2)
        np.testing.assert_allclose(np.quantile(column, [0.25, 0.75]), np.quantile([low, high], [0.25, 0.75]), atol=0.02)
    for column, low, high in ((c.density_factor, 0.5, 2.0), (c.gain_factor / 3.0, 0.7, 1.4)):
        middle = np.sqrt(low * high)
        assert low <= column.min() < column.max() <= high
        assert np.median(column) == pytest.approx(middle, rel=0.05)
        assert (column < middle * np.sqrt(middle / low)).mean() > 0.7
    np.testing.assert_allclose(c.position_error_m.std(axis=0), 0.002, rtol=0.05)
    assert np.sqrt((c.rotation_error_rad**2).sum(axis=1).mean()) == pytest.approx(np.radians(3.0), rel=0.05)
    np.testing.assert_allclose(c.rotation_error_rad.mean(axis=0), 0.0, atol=np.radians(0.15))


def test_a_trials_draw_depends_on_the_seed_and_its_row_alone(drawn_conditions: Conditions) -> None:
    few, other = VARIED.conditions(5, 7), VARIED.conditions(5, 8)
    assert few is not None
    assert other is not None
    for name, column in vars(few).items():
        np.testing.assert_array_equal(column, getattr(drawn_conditions, name)[:5])
        assert (column != getattr(other, name)).any()


def test_columns_are_drawn_independently(drawn_conditions: Conditions) -> None:
    c = drawn_conditions
    columns = [c.friction, np.log(c.density_factor), np.log(c.gain_factor), c.size_error_m, *c.position_error_m.T]
    correlations = np.corrcoef(columns) - np.eye(len(columns))
    assert np.abs(correlations).max() < 0.06


def test_what_does_not_vary_is_the_physics_own() -> None:
    assert PAPER.conditions(3) is None
    one = Variation(friction=(0.4, 0.4)).draw(replace(PAPER.physics, gain_factor=2.0), 3, 0)
    same = Conditions.of(PAPER.physics, 3, friction=0.4, gain_factor=2.0)
    for name, column in vars(one).items():
        np.testing.assert_allclose(column, getattr(same, name), atol=1e-15)


@pytest.mark.parametrize(
    "wrong",
    [
        {"friction": (0.9, 0.5)},
        {"friction": (-0.1, 0.5)},
        {"density_factor": (0.0, 1.0)},
        {"gain_factor": (1.0, np.inf)},
        {"position_sd_m": -0.001},
        {"size_error_m": np.nan},
    ],
)
def test_a_variation_that_cannot_be_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"{next(iter(wrong))} must be finite, positive and in ascending order"):
        Variation(**wrong)


def test_conditions_are_the_physics_own_unless_they_are_given() -> None:
    conditions = Conditions.of(Physics(friction=0.6, density_factor=2.0), 3, friction=[0.1, 0.2, 0.3], gain_factor=1.5)
    assert len(conditions) == 3
    assert conditions.friction.tolist() == [0.1, 0.2, 0.3]
    assert conditions.density_factor.tolist() == [2.0] * 3
    assert conditions.gain_factor.tolist() == [1.5] * 3
    for nothing in (conditions.position_error_m, conditions.rotation_error_rad):
        assert nothing.shape == (3, 3)
        assert not nothing.any()
    assert conditions.size_error_m.tolist() == [0.0] * 3
    assert conditions[[2, 0]].friction.tolist() == [0.3, 0.1]
    assert len(conditions[conditions.friction > 0.15]) == 2


def test_one_error_may_be_given_for_all_trials_or_one_each() -> None:
    shared = Conditions.of(Physics(), 2, position_error_m=[0.001, 0.0, 0.0])
    assert shared.position_error_m.tolist() == [[0.001, 0.0, 0.0]] * 2
    turned = Conditions.of(Physics(), 2, rotation_error_rad=[[0.0, 0.0, 0.3], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(
        as_rotation(turned.rotation_error_quat_wxyz).as_rotvec(), turned.rotation_error_rad, atol=1e-12
    )


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ({"frictoin": 0.5}, "unknown condition of a trial 'frictoin'. Did you mean 'friction'"),
        ({"friction": [0.5, 0.6]}, r"friction of 3 trials has shape \(2,\), expected \(3,\)"),
        ({"position_error_m": [0.1, 0.2]}, r"position_error_m of 3 trials has shape \(2,\), expected \(3, 3\)"),
        ({"friction": -0.1}, "friction must be 0 to 1000, got -0.1"),
        ({"friction": "a"}, "friction must be numbers: could not convert string"),
        ({"friction": 1 + 0j}, "friction must be numbers"),
        ({"friction": None}, "friction must be 0 to 1000, got nan"),
        ({"density_factor": 0.0}, "density_factor must be 1e-09 to 1e\\+09, got 0"),
        ({"gain_factor": [1.0, 1.0, 0.0]}, "gain_factor must be 1e-09 to 1e\\+09, got 0"),
        ({"size_error_m": np.nan}, "size_error_m must be -0.05 to 0.05, got nan"),
        ({"size_error_m": 1.0}, "size_error_m must be -0.05 to 0.05, got 1"),
        ({"rotation_error_rad": np.inf}, "rotation_error_rad must be -3.142 to 3.142, got inf"),
        ({"rotation_error_rad": 30.0}, "rotation_error_rad must be -3.142 to 3.142, got 30"),
        ({"position_error_m": 5.0}, "position_error_m must be -1 to 1, got 5"),
    ],
)
def test_conditions_that_cannot_be_are_refused(columns: dict, says: str) -> None:
    with pytest.raises(InputError, match=says):
        Conditions.of(Physics(), 3, **columns)


def test_columns_of_conditions_may_be_lists() -> None:
    lists = Conditions([0.8, 0.7], [1, 1], [1, 1], [[0, 0, 0]] * 2, [[0, 0, 0]] * 2, [0, 0])  # type: ignore[arg-type]
    assert lists[[1]].friction.tolist() == [0.7]


# A really moving base

_HEAVY_KG = 1e5
_RAILS = "".join(
    f'<joint name="base_{name}" type="slide" axis="{axis}" armature="{_HEAVY_KG}" damping="0"/>'
    for name, axis in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"), strict=True)
)


class OnRails:
    """Move a world's heavy base as A sin(w t) along one axis after another."""

    def __init__(self, world: World, data: mujoco.MjData) -> None:
        self._data = data
        self._dofs = [world.model.joint(f"base_{axis}").dofadr[0] for axis in "xyz"]
        self._places = [world.model.joint(f"base_{axis}").qposadr[0] for axis in "xyz"]
        self._object = world.model.joint("object").dofadr[0] + np.arange(3)
        self._boost, self.middle = np.zeros(3), np.zeros(3)
        self._omega = 2 * np.pi * 3.0
        self.top_speed = 0.020 * self._omega

    @property
    def position(self) -> np.ndarray:
        return self._data.qpos[self._places].copy()

    @property
    def velocity(self) -> np.ndarray:
        return self._data.qvel[self._dofs].copy()

    def push(self, step: int) -> None:
        """Apply the force that accelerates the base for one step."""
        self._data.qfrc_applied[self._dofs] = -_HEAVY_KG * PAPER.schedule.acceleration[step]
        if step < CLOSING:
            return
        boost = self.top_speed * np.eye(3)[shaken_axis(step - CLOSING)]
        if (boost != self._boost).any():
            # Each axis starts in full swing, base, hand and object alike: a change of who looks on, not of the physics.
            self._data.qvel[self._dofs] += boost - self._boost
            self._data.qvel[self._object] += boost - self._boost
            self._boost, self.middle = boost, self.position

    def velocity_of_a_sine(self, step: int) -> np.ndarray:
        """Compute the velocity at the end of a step of a base that moves as A sin(w t) along its axis."""
        return np.asarray(self._boost * np.cos(self._omega * (step + 1 - CLOSING) * STEP_S))


def object_of(grasps: Grasps, row: int) -> GraspObject:
    return next(iter(grasps[row].tasks)).object


@pytest.fixture
def moving_world(tmp_path: Path, hand: Hand, drawn: Grasps, held_trial: int) -> World:
    """Build the trial world with the forearm on three rails, so heavy that fingers and object cannot push it."""
    path = tmp_path / "on_rails.xml"
    path.write_text(edited(('<body name="forearm">', f'<body name="forearm">{_RAILS}')))
    obj = object_of(drawn, held_trial)
    world = build_world(replace(hand, name="on_rails", mjcf=path), obj, PAPER.physics)
    # The solver's stopping rule is relative to the model's mean inertia, which the heavy base must not loosen.
    world.model.stat.meaninertia = build_world(hand, obj, PAPER.physics).model.stat.meaninertia
    return world


@pytest.fixture
def held_trial(outcomes: Outcomes) -> int:
    return int(np.flatnonzero(outcomes.held)[0])


def start(world: World, hand: Hand, grasps: Grasps, row: int) -> mujoco.MjData:
    world.model.opt.tolerance = 1e-14
    data = mujoco.MjData(world.model)
    data.qpos[world.joint_qpos] = hand.pregrasp
    data.qpos[world.object_qpos :][:7] = [*grasps.X_hand_object.position_m[row], *grasps.X_hand_object.quat_wxyz[row]]
    return data


def test_the_shaking_field_equals_a_really_moving_base(
    hand: Hand, drawn: Grasps, held_trial: int, moving_world: World
) -> None:
    """Shake the same held grasp by gravity and by moving the hand: seen from the hand, nothing differs."""
    fixed_world = build_world(hand, object_of(drawn, held_trial), PAPER.physics)
    fixed, moving = (start(world, hand, drawn, held_trial) for world in (fixed_world, moving_world))
    base, swing = OnRails(moving_world, moving), []
    change = drawn.posture[held_trial] - hand.pregrasp
    for step in range(SHAKEN):
        fraction = PAPER.schedule.fraction[min(step, CLOSING - 1)]
        for world, data in ((fixed_world, fixed), (moving_world, moving)):
            data.ctrl[:] = (hand.pregrasp + fraction * change) @ world.control_map
        fixed_world.model.opt.gravity[:] = PAPER.schedule.acceleration[step]
        base.push(step)
        mujoco.mj_step(fixed_world.model, fixed)
        mujoco.mj_step(moving_world.model, moving)
        seen = moving.qpos[moving_world.object_qpos :][:7].copy()
        seen[:3] -= base.position
        expected = fixed.qpos[fixed_world.object_qpos :][:7]
        np.testing.assert_allclose(seen[:3], expected[:3], rtol=0, atol=5e-5)
        np.testing.assert_allclose(seen[3:], expected[3:], rtol=0, atol=2e-3)
        if step >= CLOSING:
            swing.append(base.position - base.middle)
            np.testing.assert_allclose(base.velocity, base.velocity_of_a_sine(step), atol=0.02 * base.top_speed)
    assert (np.max(swing, axis=0) > 0.018).all(), "the base swung 20 mm to one side along every axis"
    assert (np.min(swing, axis=0) < -0.018).all(), "and to the other"
    moved = fixed.qpos[fixed_world.object_qpos :][:3] - drawn.X_hand_object.position_m[held_trial]
    assert np.linalg.norm(moved) > 1e-4, "the object did move in the hand"
