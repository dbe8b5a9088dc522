"""Protocols: the phases a grasp goes through and what counts as success; and the physics they run under."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .errors import InputError, as_numbers, check_name, check_whole
from .poses import as_quat

Array = NDArray[np.float64]


class _Numbers:
    """A record that checks its numbers: finite, not negative, and above zero where named."""

    _above_zero: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for part in fields(self):  # type: ignore[arg-type]
            value, positive = getattr(self, part.name), part.name in self._above_zero
            if isinstance(value, int | float) and (not math.isfinite(value) or value < 0 or (value == 0 and positive)):
                least = "above 0" if positive else "at least 0"
                raise InputError(f"{part.name} must be a finite number {least}, got {value}")


@dataclass(frozen=True)
class Physics(_Numbers):
    """Numbers of a simulation that belong to no phase; SI units.

    Attributes:
        torsional_friction_m: torsional friction length of a contact.
        contact_time_constant_s: time constant of the contact's spring and damper (damping ratio 1).
        impratio: ratio of friction to normal constraint impedance, elliptic cones.
        noslip_iterations: most passes after the solver that take out the slow slip which soft friction leaves.
        gain_factor: position gains as a multiple of the hand model's own, or of `gain_nm_per_rad`.
        density_factor: object density as a multiple of the object's own, or of what makes `object_mass_kg`.
        gain_nm_per_rad: position gain of every actuator in place of the hand model's, None for the model's.
        force_limit_nm: greatest torque of every actuator, likewise.
        joint_friction_nm: dry friction of every joint, None for none.
        object_mass_kg: mass of every object whatever its size, None for what its own density makes.

    Raises:
        InputError: a number is negative, not finite, or 0 where that makes no sense.
    """

    time_step_s: float = 0.004
    friction: float = 0.8
    torsional_friction_m: float = 0.005
    contact_time_constant_s: float = 0.01
    impratio: float = 10.0
    noslip_iterations: int = 0
    gain_factor: float = 3.0
    density_factor: float = 1.0
    gain_nm_per_rad: float | None = None
    force_limit_nm: float | None = None
    joint_friction_nm: float | None = None
    object_mass_kg: float | None = None

    _above_zero = (
        *("time_step_s", "contact_time_constant_s", "impratio", "gain_factor", "density_factor"),
        *("gain_nm_per_rad", "force_limit_nm", "object_mass_kg"),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_whole("noslip_iterations", self.noslip_iterations, most=1000)


_BOUNDS: Mapping[str, tuple[float, float]] = {
    "friction": (0.0, 1e3),
    "density_factor": (1e-9, 1e9),
    "gain_factor": (1e-9, 1e9),
    "position_error_m": (-1.0, 1.0),
    "rotation_error_rad": (-math.pi, math.pi),
    "size_error_m": (-0.05, 0.05),
}
"""Least and greatest of each number in `Conditions`; beyond them it is a slip of the unit."""


@dataclass(frozen=True, eq=False)
class Conditions:
    """What may differ from trial to trial in one batch, a row each.

    Attributes:
        friction: ``(n,)`` as in `Physics`, and so are `density_factor` and `gain_factor`.
        position_error_m: ``(n, 3)`` shift of the object at the start, in the hand frame, metres.
        rotation_error_rad: ``(n, 3)`` turn of the object at the start about its centre: axis times angle, hand frame.
        size_error_m: ``(n,)`` by which every extent of the object is larger than it is said to be, metres.

    Raises:
        InputError: a column of another length or width, or a value out of range.
    """

    friction: Array
    density_factor: Array
    gain_factor: Array
    position_error_m: Array
    rotation_error_rad: Array
    size_error_m: Array

    def __post_init__(self) -> None:
        for part in fields(self):
            name, column, (low, high) = part.name, as_numbers(part.name, getattr(self, part.name)), _BOUNDS[part.name]
            shape = _shape(name, np.size(self.friction))
            if column.shape != shape:
                raise InputError(f"{name} of {shape[0]} trials has shape {column.shape}, expected {shape}")
            wrong = column[~((low <= column) & (column <= high))]
            if wrong.size:
                raise InputError(f"{name} must be {low:.4g} to {high:.4g}, got {wrong[0]:g}")
            object.__setattr__(self, name, column)

    def __len__(self) -> int:
        """Count the trials."""
        return len(self.friction)

    def __getitem__(self, rows: Any) -> Conditions:
        """Select rows by slice, index array or mask."""
        return Conditions(**{part.name: getattr(self, part.name)[rows] for part in fields(self)})

    @classmethod
    def of(cls, physics: Physics, n: int, **columns: Any) -> Conditions:
        """Make n rows with the numbers of a physics and no errors, but for columns given by name: one value or n."""
        made = {part.name: np.asarray(getattr(physics, part.name, 0.0), dtype=np.float64) for part in fields(cls)}
        for name, value in columns.items():
            check_name("condition of a trial", name, made)
            made[name] = as_numbers(name, value)
        for name, column in made.items():
            shape = _shape(name, n)
            try:
                made[name] = np.broadcast_to(column, shape).copy()
            except ValueError:
                raise InputError(f"{name} of {n} trials has shape {column.shape}, expected {shape}") from None
        return cls(**made)

    @property
    def rotation_error_quat_wxyz(self) -> Array:
        """Turns at the start as quaternions ``(n, 4)``."""
        from scipy.spatial.transform import Rotation

        return as_quat(Rotation.from_rotvec(self.rotation_error_rad))


@dataclass(frozen=True)
class Variation:
    """Say how the conditions of trials differ at random from a protocol's physics, by independent draws.

    Attributes:
        friction: least and greatest, uniform between; None leaves the physics' own.
        density_factor: least and greatest factor on the physics' own, log-uniform between.
        gain_factor: likewise.
        position_sd_m: standard deviation of the object's place at the start, along each axis.
        rotation_sd_rad: standard deviation of its turn at the start, about an axis drawn uniformly.
        size_error_m: most by which all its extents may be larger or smaller, uniform.

    Raises:
        InputError: bounds in the wrong order, or a number that is negative or not finite.
    """

    friction: tuple[float, float] | None = None
    density_factor: tuple[float, float] = (1.0, 1.0)
    gain_factor: tuple[float, float] = (1.0, 1.0)
    position_sd_m: float = 0.0
    rotation_sd_rad: float = 0.0
    size_error_m: float = 0.0

    def __post_init__(self) -> None:
        for part in fields(self):
            value, least = getattr(self, part.name), 1e-9 if part.name.endswith("_factor") else 0.0
            numbers = value if isinstance(value, tuple) else (0.0 if value is None else value,)
            if not all(least <= number < math.inf for number in numbers) or list(numbers) != sorted(numbers):
                raise InputError(f"{part.name} must be finite, positive and in ascending order, got {value}")

    def draw(self, physics: Physics, n: int, seed: int | Sequence[int]) -> Conditions:
        """Draw conditions of n trials; those of a trial depend on the seed and its row alone."""
        numbers = np.array([_draw(np.random.default_rng([*np.atleast_1d(seed), row])) for row in range(n)])
        uniform, normal = numbers[:, :4], numbers[:, 4:]
        axis = normal[:, 4:7] / np.linalg.norm(normal[:, 4:7], axis=1, keepdims=True)

        def between(low: float, high: float, column: int) -> Array:
            return np.asarray(low + (high - low) * uniform[:, column])

        columns = {}
        for column, name in enumerate(("density_factor", "gain_factor"), 1):
            low, high = np.log(getattr(self, name)).tolist()
            columns[name] = getattr(physics, name) * np.exp(between(low, high, column))
        if self.friction is not None:
            columns["friction"] = between(*self.friction, 0)
        columns["position_error_m"] = self.position_sd_m * normal[:, :3]
        columns["rotation_error_rad"] = self.rotation_sd_rad * normal[:, 3:4] * axis
        columns["size_error_m"] = between(-self.size_error_m, self.size_error_m, 3)
        return Conditions.of(physics, n, **columns)


def _draw(rng: np.random.Generator) -> Array:
    return np.concatenate([rng.uniform(size=4), rng.normal(size=7)])


def _shape(name: str, n: int) -> tuple[int, ...]:
    return (n, 3) if name in ("position_error_m", "rotation_error_rad") else (n,)


@dataclass(frozen=True)
class Phase(_Numbers, ABC):
    """What is done to a grasp during one stretch of a trial."""

    kind: ClassVar[str]
    lost: ClassVar[str] = "dropped"
    """Verdict of an object that leaves the hand during this phase."""
    steady: ClassVar[bool] = False
    """Whether the acceleration is the same in every step."""
    ramp: ClassVar[int] = -1
    """Way on which the targets move: 0 from pregrasp to contact, 1 from contact to posture, -1 where they stay."""

    @abstractmethod
    def _length_s(self) -> float: ...

    def n_steps(self, time_step_s: float) -> int:
        """Count the integration steps."""
        return round(self._length_s() / time_step_s)

    def acceleration(self, time_step_s: float) -> Array:
        """Compute the acceleration field in the hand frame during each step, ``(n_steps, 3)`` in m/s2."""
        return np.zeros((self.n_steps(time_step_s), 3))

    def force(self, time_step_s: float) -> Array:
        """Compute the force on the object's centre of mass during each step, ``(n_steps, 3)`` in N.

        Its axes are those that the object has at the start; they do not turn with it.
        """
        return np.zeros((self.n_steps(time_step_s), 3))

    def fraction(self, time_step_s: float) -> Array:
        """Compute how far on their way (0 to 1) the targets in force during each step are, ``(n_steps,)``."""
        return np.ones(self.n_steps(time_step_s))


@dataclass(frozen=True)
class Close(Phase):
    """Close the hand on the floating object: targets ramp from pregrasp to contact, which is then held.

    Contact is the grasp's posture itself, unless the protocol says how it is found (`Protocol.contact_by`).
    """

    ramp_s: float = 0.5
    settle_s: float = 0.2

    kind, lost, ramp = "close", "missed", 0
    _above_zero = ("ramp_s",)

    def _length_s(self) -> float:
        return self.ramp_s + self.settle_s

    def fraction(self, time_step_s: float) -> Array:
        """Compute the targets' way from pregrasp (0) to contact (1) in force during each step, ``(n_steps,)``."""
        steps = np.arange(1, self.n_steps(time_step_s) + 1)
        return np.asarray(np.minimum(steps * time_step_s / self.ramp_s, 1.0))


@dataclass(frozen=True)
class Shake(Phase):
    """Shake the hand's base along x, y and z, some cycles along each; in its frame gravity changes with time.

    The base is taken to swing already: the jolt of starting and stopping is left out.
    """

    amplitude_m: float = 0.020
    frequency_hz: float = 3.0
    cycles: int = 2

    kind, lost = "shake", "shaken_out"
    _above_zero = ("frequency_hz",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cycles % 1:
            raise InputError(f"cycles of a shake must be a whole number, got {self.cycles}")

    def _length_s(self) -> float:
        return 3 * self.cycles / self.frequency_hz

    def axis(self, step: Any, time_step_s: float) -> Any:
        """Tell which axis (0, 1 or 2) is shaken during a step, counted from 0."""
        return np.minimum(np.asarray(step) * 3 // max(self.n_steps(time_step_s), 1), 2)

    def acceleration(self, time_step_s: float) -> Array:
        """Compute the acceleration field as `Phase` does: A w^2 sin(w t), the base moving as A sin(w t)."""
        accelerations = super().acceleration(time_step_s)
        steps, omega = np.arange(len(accelerations)), 2 * np.pi * self.frequency_hz
        # Evaluated at mid-step: the exact mean of the field over the step up to second order.
        field = self.amplitude_m * omega**2 * np.sin(omega * ((steps + 0.5) * time_step_s))
        accelerations[steps, self.axis(steps, time_step_s)] = field
        return accelerations


@dataclass(frozen=True)
class Carry(Phase):
    """Let the object hang in the hand under its weight, from the fingers towards the palm (-z of the hand frame)."""

    duration_s: float = 5.0
    gravity_m_s2: float = 9.81

    kind, steady = "carry", True

    def _length_s(self) -> float:
        return self.duration_s

    def acceleration(self, time_step_s: float) -> Array:
        """Compute the acceleration field as `Phase` does: the weight in every step."""
        return super().acceleration(time_step_s) - [0.0, 0.0, self.gravity_m_s2]


@dataclass(frozen=True)
class Squeeze(Phase):
    """Squeeze the object: targets ramp from contact on to the grasp's posture, which lies inside the object."""

    ramp_s: float = 0.4

    kind, ramp = "squeeze", 1
    _above_zero = ("ramp_s",)

    def _length_s(self) -> float:
        return self.ramp_s

    def fraction(self, time_step_s: float) -> Array:
        """Compute the targets' way from contact (0) to posture (1) in force during each step, ``(n_steps,)``."""
        return np.arange(1, self.n_steps(time_step_s) + 1) / self.n_steps(time_step_s)


DIRECTIONS: Mapping[str, tuple[float, float, float]] = {
    "-x": (-1.0, 0.0, 0.0),
    "+x": (1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-z": (0.0, 0.0, -1.0),
    "+z": (0.0, 0.0, 1.0),
}
"""Unit vectors of the six directions a `Push` may have."""


@dataclass(frozen=True)
class Push(Phase):
    """Push the object at its centre of mass, evenly, along an axis that it has at the start."""

    direction: str = "+x"
    force_n: float = 1.0
    duration_s: float = 2.0

    kind, lost = "push", "pushed_out"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_name("direction of a push", self.direction, DIRECTIONS)

    def _length_s(self) -> float:
        return self.duration_s

    def force(self, time_step_s: float) -> Array:
        """Compute the force as `Phase` does: the same in every step."""
        return super().force(time_step_s) + self.force_n * np.array(DIRECTIONS[self.direction])


PHASES: Mapping[str, type[Phase]] = {phase.kind: phase for phase in (Close, Shake, Carry, Squeeze, Push)}
"""Every phase by its name in files."""


@dataclass(frozen=True)
class Protocol(_Numbers):
    """What is done to a grasp and what counts as success; SI units.

    The hand base stands still with the fingers pointing up and the object floats at the proposed pose. A trial goes
    through the phases in order, the first of which closes the hand; it is held if at the end the thumb and a finger
    touch the object.

    Where turns are limited, the object's pose alone counts, at all times, and there may be several attempts: each
    closing starts one from pregrasp, hand and object being put back, and all must hold.

    Attributes:
        name: name that every success rate is quoted with.
        overlap_m: deeper overlap of hand and object at the start is the failure `overlap`.
        displacement_m: the object's centre must stay this near to where closing left it, or, where turns are limited,
            to where it started.
        turn_rad: the object must not turn by more from how it started; None where it may.
        physics: physics of every trial, unless a trial has conditions of its own.
        variation: how each trial's conditions differ from it, None where all are alike.
        contact_by: protocol whose closing, under its own physics, finds the joints in contact and the place of the
            object that a trial starts with; None closes to the posture, from where the grasp puts the object.

    Raises:
        InputError: a number out of range, no closing phase first, nothing after it, or a `contact_by` that limits turns
            or has its own contact found by another.

    Examples:
        >>> harder = PAPER.with_physics("paper, friction 0.5", friction=0.5)
        >>> [phase.kind for phase in harder.phases], harder.physics.friction
        (['close', 'shake', 'carry'], 0.5)
    """

    name: str
    phases: tuple[Phase, ...] = (Close(), Shake(), Carry())
    overlap_m: float = 0.001
    displacement_m: float = 0.050
    physics: Physics = Physics()
    variation: Variation | None = None
    turn_rad: float | None = None
    contact_by: Protocol | None = None

    _above_zero = ("displacement_m", "turn_rad")

    def __post_init__(self) -> None:
        super().__post_init__()
        step = self.physics.time_step_s
        kinds = [phase.kind for phase in self.phases]
        if kinds[:1] != ["close"] or (kinds.count("close") > 1 and self.turn_rad is None):
            raise InputError(f"a protocol begins with its one closing phase, got phases {', '.join(kinds) or 'none'}")
        first = self.contact_by
        if first is not None and (first.turn_rad is not None or first.contact_by is not None):
            raise InputError(f"contact is found by one plain closing, not by protocol {first.name}")
        if self.phases[0].n_steps(step) < 1 or sum(phase.n_steps(step) for phase in self.phases[1:]) < 1:
            raise InputError(f"closing, and what follows it, must each last at least one time step of {step} s")

    @property
    def closing(self) -> Close:
        """The phase that closes the hand."""
        return self.phases[0]  # type: ignore[return-value]

    @cached_property
    def schedule(self) -> Schedule:
        """Phases laid out in time steps of the protocol's physics."""
        step = self.physics.time_step_s
        counts = [phase.n_steps(step) for phase in self.phases]
        ends, phase_of_step = tuple(np.cumsum(counts).tolist()), np.repeat(np.arange(len(counts)), counts)
        fraction, acceleration, force = (
            np.concatenate([getattr(phase, name)(step) for phase in self.phases])
            for name in ("fraction", "acceleration", "force")
        )
        return Schedule(self.phases, ends, fraction, acceleration, force, phase_of_step)

    def with_physics(self, name: str, **numbers: Any) -> Protocol:
        """Make a protocol of the same phases under other physics, numbers being named as in `Physics`."""
        for number in numbers:
            check_name("number of physics", number, [part.name for part in fields(Physics)])
        return replace(self, name=name, physics=replace(self.physics, **numbers))

    def conditions(self, n: int, seed: int | Sequence[int] = 0) -> Conditions | None:
        """Draw the conditions of n trials (see `Variation.draw`); None where all are as in the physics."""
        return None if self.variation is None else self.variation.draw(self.physics, n, seed)

    def to_json(self) -> dict[str, Any]:
        """Describe name, phases, criterion and physics as plain data."""
        phases = [{"phase": phase.kind} | asdict(phase) for phase in self.phases]
        data = {part.name: getattr(self, part.name) for part in fields(self)} | {"phases": phases}
        # Bounds as lists, as they come back from a file: records are compared.
        varied = {} if self.variation is None else asdict(self.variation)
        varied = {name: list(value) if isinstance(value, tuple) else value for name, value in varied.items()}
        data["variation"] = varied or None
        # What a protocol does without is left out, so that records keep their form when there is more to say.
        data["physics"] = {name: number for name, number in asdict(self.physics).items() if number is not None}
        data["contact_by"] = None if self.contact_by is None else self.contact_by.to_json()
        return {name: part for name, part in data.items() if part is not None or name == "variation"}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Protocol:
        """Rebuild from `to_json()`, or from the flat record of earlier versions.

        Raises:
            InputError: an unknown phase, or a number out of range.
            KeyError, TypeError: a part is missing, unknown or of another kind.
        """
        if "phases" not in data:
            flat = dict(data)
            closing = Close(flat.pop("close_s"), flat.pop("settle_s"))
            shake = Shake(*(flat.pop(f"shake_{name}") for name in ("amplitude_m", "frequency_hz", "cycles")))
            carry = Carry(flat.pop("gravity_s"), flat.pop("gravity_m_s2"))
            own = {name: flat.pop(name) for name in ("name", "overlap_m", "displacement_m")}
            return cls(phases=(closing, shake, carry), physics=Physics(**flat), **own)
        phases = []
        for about in data["phases"]:
            check_name("phase of a protocol", about.get("phase"), PHASES)
            phases.append(PHASES[about["phase"]](**{k: v for k, v in about.items() if k != "phase"}))
        varied: dict[str, Any] = data.get("variation") or {}
        varied = {name: tuple(value) if isinstance(value, list) else value for name, value in varied.items()}
        variation = Variation(**varied) if varied else None
        made = {"phases": tuple(phases), "physics": Physics(**data["physics"]), "variation": variation}
        if "contact_by" in data:
            made["contact_by"] = cls.from_json(data["contact_by"])
        return cls(**{**data, **made})


@dataclass(frozen=True, eq=False)
class Schedule:
    """The phases of a protocol, laid out in time steps.

    Attributes:
        ends: step count at the end of each phase.
        fraction: ``(total_steps,)`` way of the targets during each step, from 0 to 1 in each phase that moves them.
        acceleration: ``(total_steps, 3)`` field in the hand frame during each step, m/s2.
        force: ``(total_steps, 3)`` force on the object during each step along its axes at the start, N.
        phase: ``(total_steps,)`` place of the phase that each step belongs to.
    """

    phases: tuple[Phase, ...]
    ends: tuple[int, ...]
    fraction: Array
    acceleration: Array
    force: Array
    phase: NDArray[np.intp]

    @property
    def closing_steps(self) -> int:
        """Steps until the grasp is judged closed."""
        return self.ends[0]

    @property
    def total_steps(self) -> int:
        """Steps of a full-length trial."""
        return self.ends[-1]

    @property
    def carry_begins(self) -> int:
        """Step count at which the last phase begins if it is steady, otherwise the total."""
        return self.ends[-2] if self.phases[-1].steady else self.ends[-1]

    @property
    def restarts(self) -> list[int]:
        """Step counts at which a new attempt begins."""
        return [end for end, phase in zip(self.ends, self.phases[1:], strict=False) if isinstance(phase, Close)]

    def lost(self, step: NDArray[np.int64]) -> NDArray[np.str_]:
        """Name the verdict of objects that were lost by a step count ``(k,)``."""
        verdicts = np.array([phase.lost for phase in self.phases])
        return np.asarray(verdicts[np.searchsorted(self.ends, step).clip(0, len(verdicts) - 1)])


PAPER = Protocol(name="paper")
"""The protocol of the paper's tables."""
HOLD = PAPER.with_physics("hold", noslip_iterations=3)
"""`PAPER` with contacts that do not creep, so that a verdict hardly depends on how long the weight acts.

Its contact settings are the cheapest that keep the limits of ``benchmarks/physics/contacts.py``."""
VARIED = replace(
    HOLD,
    name="varied",
    variation=Variation(
        friction=(0.5, 1.0),
        density_factor=(0.5, 2.0),
        gain_factor=(0.7, 1.4),
        position_sd_m=0.002,
        rotation_sd_rad=math.radians(3.0),
        size_error_m=0.001,
    ),
)
"""`HOLD`, each trial with a draw of its own of what a user with a camera and a real hand meets."""
SIX_DIRECTIONS = Protocol(
    "six-directions",
    tuple(phase for way in DIRECTIONS for phase in (Close(0.4, 0.0), Squeeze(0.4), Push(way, 1.0, 2.0))),
    overlap_m=0.010,
    displacement_m=0.050,
    turn_rad=math.radians(15.0),
    physics=Physics(
        friction=0.6,
        torsional_friction_m=0.02,
        contact_time_constant_s=0.0125,
        noslip_iterations=2,
        gain_factor=1.0,
        gain_nm_per_rad=5.0,
        force_limit_nm=3.0,
        joint_friction_nm=0.01,
        object_mass_kg=0.1,
    ),
    contact_by=HOLD,
)
"""The rule of DexGraspBench's force-closure setting, with the numbers of that project's branch ``main``.

Contacts have two passes against slip, as there, and the mean time constant of its hand (5 ms) and objects (20 ms); the
joints' dry friction is that of its Shadow Hand."""
PROTOCOLS: Mapping[str, Protocol] = {each.name: each for each in (PAPER, HOLD, VARIED, SIX_DIRECTIONS)}
"""Every protocol by name."""


def as_protocol(given: Protocol | str) -> Protocol:
    """Read a protocol: one as it is, or its name; for an unknown name an InputError names the nearest."""
    if isinstance(given, Protocol):
        return given
    check_name("protocol", given, PROTOCOLS)
    return PROTOCOLS[given]
