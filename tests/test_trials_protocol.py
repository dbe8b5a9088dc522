"""The protocol: its phases and numbers, and that its shake is what a really moving base does."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspcascade.errors import InputError
from graspcascade.grasps import Grasps
from graspcascade.hands import SHADOW_HAND, HandModel
from graspcascade.objects import grasp_object
from graspcascade.trials import PAPER, Outcomes, Protocol, Scene, build_scene, protocol

STEPS_PER_SHAKE_AXIS = 500 / 3


def shaken_axis(step: int) -> int:
    """Name the axis that is shaken during a step of the paper protocol's shake, counted from its start."""
    return int(step / STEPS_PER_SHAKE_AXIS)


def test_the_paper_protocol_is_the_papers() -> None:
    assert protocol("paper") is PAPER
    assert PAPER.closing_steps == 175
    assert PAPER.shake_steps == 500
    assert PAPER.total_steps == 1925
    assert PAPER.total_steps * PAPER.time_step_s == pytest.approx(7.7)
    assert (PAPER.shake_amplitude_m, PAPER.shake_frequency_hz, PAPER.shake_cycles) == (0.020, 3.0, 2)
    assert (PAPER.overlap_m, PAPER.displacement_m, PAPER.gravity_m_s2) == (0.001, 0.050, 9.81)
    assert (PAPER.friction, PAPER.impratio, PAPER.gain_factor) == (0.8, 10.0, 3.0)


def test_an_unknown_protocol_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"unknown protocol 'papers'\. Did you mean 'paper'\?"):
        protocol("papers")


def test_a_protocol_is_plain_numbers_by_name() -> None:
    assert Protocol(**PAPER.to_json()) == PAPER


@pytest.mark.parametrize("name", [name for name in PAPER.to_json() if name != "name"])
def test_no_number_of_a_protocol_is_negative_or_endless(name: str) -> None:
    for wrong in (-0.001, float("nan"), float("inf"), float("-inf")):
        with pytest.raises(InputError, match=f"{name} of a protocol must be a finite number"):
            replace(PAPER, **{name: wrong})


@pytest.mark.parametrize("name", ["time_step_s", "close_s", "shake_frequency_hz", "displacement_m", "density_factor"])
def test_what_no_trial_can_do_without_is_above_zero(name: str) -> None:
    with pytest.raises(InputError, match=f"{name} of a protocol must be a finite number above 0, got 0"):
        replace(PAPER, **{name: 0})


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"shake_cycles": 1.5}, "whole number, got 1.5"),
        ({"close_s": 0.001, "settle_s": 0.0}, "at least one time step"),
        ({"shake_cycles": 0, "gravity_s": 0.0}, "at least one time step"),
    ],
)
def test_a_protocol_without_a_phase_is_refused(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(PAPER, **wrong)


@pytest.mark.parametrize("absent", [{"shake_cycles": 0}, {"gravity_s": 0.0}, {"settle_s": 0.0}, {"overlap_m": 0.0}])
def test_what_a_trial_can_do_without_may_be_zero(absent: dict[str, float]) -> None:
    varied = replace(PAPER, **absent)
    steps = (varied.closing_steps, varied.shake_steps, round(varied.gravity_s / varied.time_step_s))
    assert varied.gravity.shape == (sum(steps), 3)
    assert (varied.gravity[sum(steps[:2]) :] == [0.0, 0.0, -9.81]).all()


@given(time_step_s=st.sampled_from([0.001, 0.002, 0.003, 0.004, 0.005]), close_s=st.sampled_from([0.2, 0.5, 1.0]))
def test_the_targets_ramp_evenly_from_pregrasp_to_posture_and_stay(time_step_s: float, close_s: float) -> None:
    varied = replace(PAPER, time_step_s=time_step_s, close_s=close_s)
    fraction = varied.closing_fraction
    assert fraction.shape == (varied.total_steps,)
    assert 0 < fraction[0] <= 1.001 * time_step_s / close_s
    assert (np.diff(fraction) >= 0).all()
    ramp = fraction[: int(close_s / time_step_s) - 1]
    np.testing.assert_allclose(np.diff(ramp), time_step_s / close_s)
    assert (fraction[round(close_s / time_step_s) :] == 1).all()


def test_there_is_no_weight_while_closing_and_full_weight_after_the_shake() -> None:
    gravity = PAPER.gravity
    assert gravity.shape == (PAPER.total_steps, 3)
    assert not gravity[: PAPER.closing_steps].any()
    end = gravity[PAPER.closing_steps + PAPER.shake_steps :]
    assert len(end) * PAPER.time_step_s == pytest.approx(5.0)
    assert (end == [0.0, 0.0, -9.81]).all()


def test_the_shake_is_two_cycles_of_the_stated_amplitude_along_each_axis_in_turn() -> None:
    shake = PAPER.gravity[PAPER.closing_steps :][: PAPER.shake_steps]
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
        assert abs(field.sum() * PAPER.time_step_s) < 0.01 * peak / (2 * np.pi * 3.0)


@given(amplitude=st.floats(0.001, 0.1), frequency=st.sampled_from([1.0, 2.0, 3.0, 5.0]), cycles=st.integers(1, 4))
def test_the_shakes_peak_is_amplitude_times_angular_frequency_squared(
    amplitude: float, frequency: float, cycles: int
) -> None:
    varied = replace(PAPER, shake_amplitude_m=amplitude, shake_frequency_hz=frequency, shake_cycles=cycles)
    shake = varied.gravity[varied.closing_steps :][: varied.shake_steps]
    assert np.abs(shake).max() == pytest.approx(amplitude * (2 * np.pi * frequency) ** 2, rel=5e-3)
    assert varied.shake_steps * varied.time_step_s == pytest.approx(3 * cycles / frequency, abs=varied.time_step_s)


def test_an_object_left_alone_in_the_field_moves_as_seen_from_the_oscillating_base() -> None:
    """Integrate the field twice: a free body must trace A (w t - sin w t) about a base that moves as A sin(w t)."""
    shake = PAPER.gravity[PAPER.closing_steps :][: PAPER.shake_steps, 0]
    n = int(STEPS_PER_SHAKE_AXIS)
    velocity = np.cumsum(shake[:n]) * PAPER.time_step_s
    position = np.cumsum(velocity) * PAPER.time_step_s
    time, omega = np.arange(1, n + 1) * PAPER.time_step_s, 2 * np.pi * 3.0
    expected = 0.020 * (omega * time - np.sin(omega * time))
    np.testing.assert_allclose(position, expected, atol=0.02 * 0.020 * omega)


# A really moving base

_HEAVY_KG = 1e5
_RAILS = "".join(
    f'<joint name="base_{name}" type="slide" axis="{axis}" armature="{_HEAVY_KG}" damping="0"/>'
    for name, axis in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"), strict=True)
)


class OnRails:
    """Move a scene's heavy base as A sin(w t) along one axis after another."""

    def __init__(self, scene: Scene, data: mujoco.MjData) -> None:
        self._data = data
        self._dofs = [scene.model.joint(f"base_{axis}").dofadr[0] for axis in "xyz"]
        self._places = [scene.model.joint(f"base_{axis}").qposadr[0] for axis in "xyz"]
        self._object = scene.model.joint("object").dofadr[0] + np.arange(3)
        self._boost, self.middle = np.zeros(3), np.zeros(3)
        self._omega = 2 * np.pi * PAPER.shake_frequency_hz
        self.top_speed = PAPER.shake_amplitude_m * self._omega

    @property
    def position(self) -> np.ndarray:
        return self._data.qpos[self._places].copy()

    @property
    def velocity(self) -> np.ndarray:
        return self._data.qvel[self._dofs].copy()

    def push(self, step: int) -> None:
        """Apply the force that accelerates the base for one step."""
        self._data.qfrc_applied[self._dofs] = -_HEAVY_KG * PAPER.gravity[step]
        if step < PAPER.closing_steps:
            return
        boost = self.top_speed * np.eye(3)[shaken_axis(step - PAPER.closing_steps)]
        if (boost != self._boost).any():
            # Each axis starts in full swing, base, hand and object alike: a change of who looks on, not of the physics.
            self._data.qvel[self._dofs] += boost - self._boost
            self._data.qvel[self._object] += boost - self._boost
            self._boost, self.middle = boost, self.position

    def velocity_of_a_sine(self, step: int) -> np.ndarray:
        """Give the velocity at the end of a step of a base that moves as A sin(w t) along its axis."""
        return np.asarray(self._boost * np.cos(self._omega * (step + 1 - PAPER.closing_steps) * PAPER.time_step_s))


@pytest.fixture
def moving_scene(tmp_path: Path, drawn: Grasps, held_trial: int) -> Scene:
    """Build the trial scene with the forearm on three rails, so heavy that fingers and object cannot push it."""
    path = tmp_path / "on_rails.xml"
    text = SHADOW_HAND.mjcf.read_text()
    assert text.count('<body name="forearm">') == 1
    path.write_text(text.replace('<body name="forearm">', f'<body name="forearm">{_RAILS}'))
    obj = grasp_object(str(drawn.object_label[held_trial]))
    scene = build_scene(SHADOW_HAND.with_model(path, "on_rails", ""), obj, PAPER)
    # The solver's stopping rule is relative to the model's mean inertia, which the heavy base must not loosen.
    scene.model.stat.meaninertia = build_scene(SHADOW_HAND, obj, PAPER).model.stat.meaninertia
    return scene


@pytest.fixture
def held_trial(outcomes: Outcomes) -> int:
    return int(np.flatnonzero(outcomes.held)[0])


def start(scene: Scene, hand: HandModel, grasps: Grasps, row: int) -> mujoco.MjData:
    scene.model.opt.tolerance = 1e-14
    data = mujoco.MjData(scene.model)
    data.qpos[scene.joint_qpos] = hand.pregrasp
    data.qpos[scene.object_qpos :][:7] = [*grasps.X_hand_object.position_m[row], *grasps.X_hand_object.quat_wxyz[row]]
    return data


def test_the_shaking_field_equals_a_really_moving_base(
    hand: HandModel, drawn: Grasps, held_trial: int, moving_scene: Scene
) -> None:
    """Shake the same held grasp by gravity and by moving the hand: seen from the hand, nothing differs."""
    fixed_scene = build_scene(SHADOW_HAND, grasp_object(str(drawn.object_label[held_trial])), PAPER)
    fixed, moving = (start(scene, hand, drawn, held_trial) for scene in (fixed_scene, moving_scene))
    base, swing = OnRails(moving_scene, moving), []
    change = drawn.posture[held_trial] - hand.pregrasp
    for step in range(PAPER.closing_steps + PAPER.shake_steps):
        for scene, data in ((fixed_scene, fixed), (moving_scene, moving)):
            data.ctrl[:] = (hand.pregrasp + PAPER.closing_fraction[step] * change) @ scene.control_map
        fixed_scene.model.opt.gravity[:] = PAPER.gravity[step]
        base.push(step)
        mujoco.mj_step(fixed_scene.model, fixed)
        mujoco.mj_step(moving_scene.model, moving)
        seen = moving.qpos[moving_scene.object_qpos :][:7].copy()
        seen[:3] -= base.position
        expected = fixed.qpos[fixed_scene.object_qpos :][:7]
        np.testing.assert_allclose(seen[:3], expected[:3], rtol=0, atol=5e-5)
        np.testing.assert_allclose(seen[3:], expected[3:], rtol=0, atol=2e-3)
        if step >= PAPER.closing_steps:
            swing.append(base.position - base.middle)
            np.testing.assert_allclose(base.velocity, base.velocity_of_a_sine(step), atol=0.02 * base.top_speed)
    assert (np.max(swing, axis=0) > 0.018).all(), "the base swung 20 mm to one side along every axis"
    assert (np.min(swing, axis=0) < -0.018).all(), "and to the other"
    moved = fixed.qpos[fixed_scene.object_qpos :][:3] - drawn.X_hand_object.position_m[held_trial]
    assert np.linalg.norm(moved) > 1e-4, "the object did move in the hand"
