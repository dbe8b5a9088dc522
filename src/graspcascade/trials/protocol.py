"""The trial protocol: what is done to a grasp and what counts as success, as one frozen value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, check_name

_ABOVE_ZERO = (
    "time_step_s",
    "close_s",
    "shake_frequency_hz",
    "displacement_m",
    "contact_time_constant_s",
    "impratio",
    "gain_factor",
    "density_factor",
)
"""What a trial divides by or makes no sense without; the other numbers may be 0."""


@dataclass(frozen=True)
class Protocol:
    """Fix every number of a physical trial; SI units.

    The hand base stands still with the fingers pointing up. The object floats at the candidate pose while the hand
    closes, is then shaken along three axes, and at last carries its weight. The shake is a time-varying gravity: in
    the frame of an accelerated base every free body feels the opposite uniform acceleration.
    """

    name: str
    """Name that every success rate is quoted with."""
    time_step_s: float = 0.004
    """Integration step."""
    overlap_m: float = 0.001
    """Deeper overlap of hand and object at the start is the failure `overlap`."""
    close_s: float = 0.5
    """Targets ramp from pregrasp to posture for this long."""
    settle_s: float = 0.2
    """The posture is then held for this long."""
    shake_amplitude_m: float = 0.020
    """Amplitude of the base's oscillation."""
    shake_frequency_hz: float = 3.0
    """Frequency of the oscillation."""
    shake_cycles: int = 2
    """Cycles along each of the base's x, y and z axes, one axis after another."""
    gravity_m_s2: float = 9.81
    """Weight at the end, from the palm towards the forearm (-z of the hand frame)."""
    gravity_s: float = 5.0
    """Duration of the weight."""
    displacement_m: float = 0.050
    """The object's centre must stay this near to where closing left it."""
    friction: float = 0.8
    """Sliding friction of hand and object."""
    torsional_friction_m: float = 0.005
    """Torsional friction length of a contact."""
    contact_time_constant_s: float = 0.01
    """Time constant of the contact's spring and damper (damping ratio 1)."""
    impratio: float = 10.0
    """Ratio of friction to normal constraint impedance, elliptic cones."""
    gain_factor: float = 3.0
    """Position gains as a multiple of the hand model's own."""
    density_factor: float = 1.0
    """Object density as a multiple of the catalogue's."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InputError: one is negative, not finite, or 0 where that is no protocol; or a phase lacks its steps.
        """
        for name, value in self.to_json().items():
            if name == "name":
                continue
            least = "above 0" if name in _ABOVE_ZERO else "at least 0"
            if not math.isfinite(value) or value < 0 or (value == 0 and name in _ABOVE_ZERO):
                raise InputError(f"{name} of a protocol must be a finite number {least}, got {value}")
        if self.shake_cycles % 1:
            raise InputError(f"shake_cycles of a protocol must be a whole number, got {self.shake_cycles}")
        if self.closing_steps < 1 or self.total_steps == self.closing_steps:
            raise InputError(
                f"closing, and shake or weight, must last at least one time step of {self.time_step_s} s, got "
                f"{self.close_s + self.settle_s} s, and {self.shake_cycles} cycles or {self.gravity_s} s"
            )

    @property
    def closing_steps(self) -> int:
        """Count the steps until the grasp is judged closed."""
        return round((self.close_s + self.settle_s) / self.time_step_s)

    @property
    def shake_steps(self) -> int:
        """Count the steps of the shake."""
        return round(3 * self.shake_cycles / self.shake_frequency_hz / self.time_step_s)

    @property
    def total_steps(self) -> int:
        """Count the steps of a full-length trial."""
        return self.closing_steps + self.shake_steps + round(self.gravity_s / self.time_step_s)

    @cached_property
    def closing_fraction(self) -> NDArray[np.float64]:
        """Give the targets' way from pregrasp (0) to posture (1) in force during each step, ``(total_steps,)``."""
        steps = np.arange(1, self.total_steps + 1)
        return np.asarray(np.minimum(steps * self.time_step_s / self.close_s, 1.0))

    @cached_property
    def gravity(self) -> NDArray[np.float64]:
        """Give the acceleration field in the hand frame during each step, ``(total_steps, 3)`` in m/s2.

        A base that moves as x(t) = A sin(w t), seen from a frame in which it starts at rest, accelerates with
        -A w^2 sin(w t); bodies in its frame feel the opposite.
        """
        field = np.zeros((self.total_steps, 3))
        first, last = self.closing_steps, self.closing_steps + self.shake_steps
        steps = np.arange(self.shake_steps)
        omega = 2 * np.pi * self.shake_frequency_hz
        # Evaluated at mid-step: the exact mean of the field over the step up to second order.
        time = (steps + 0.5) * self.time_step_s
        axis = np.minimum(steps * 3 // self.shake_steps, 2)
        field[first + steps, axis] = self.shake_amplitude_m * omega**2 * np.sin(omega * time)
        field[last:, 2] = -self.gravity_m_s2
        return field

    def to_json(self) -> dict[str, Any]:
        """Give every number by name."""
        return asdict(self)


PAPER = Protocol(name="paper")
"""The protocol behind every success rate unless another is named."""

PROTOCOLS: Mapping[str, Protocol] = {PAPER.name: PAPER}


def protocol(name: str) -> Protocol:
    """Look up a protocol.

    Raises:
        InputError: the name is not one of `PROTOCOLS`.
    """
    check_name("protocol", name, PROTOCOLS)
    return PROTOCOLS[name]
