"""Sweeps: the same grasps evaluated again and again while one condition of the trials changes."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InputError, check_name
from ..core.files import write_json
from ..core.protocols import PAPER, Protocol, Variation, as_protocol
from ..proposals import Proposal
from .evaluate import evaluate
from .record import Evaluation

SWEEP_FILE, PICTURE_FILE = "sweep.json", "sweep.png"
_MOST_VALUES = 100
_SPELLING = re.compile(r"(?P<name>[\w-]+)=(?P<values>[^=]+)")


@dataclass(frozen=True)
class Condition:
    """A number that a sweep may change: how a protocol takes it, and what it is called.

    Attributes:
        label: what a picture writes below its axis.
        apply: makes the protocol that differs from another by a value.
        least, most: bounds of the value.
        is_factor: values of a range are spread by equal ratios.
    """

    label: str
    apply: Callable[[Protocol, float], Protocol]
    least: float
    most: float
    is_factor: bool = False


def _physics(**numbers: Callable[[Protocol, float], float]) -> Callable[[Protocol, float], Protocol]:
    def apply(protocol: Protocol, value: float) -> Protocol:
        return protocol.with_physics(protocol.name, **{name: make(protocol, value) for name, make in numbers.items()})

    return apply


def _variation(name: str, unit: float) -> Callable[[Protocol, float], Protocol]:
    def apply(protocol: Protocol, value: float) -> Protocol:
        changed: dict[str, Any] = {name: value * unit}
        return replace(protocol, variation=replace(protocol.variation or Variation(), **changed))

    return apply


def _friction(protocol: Protocol, value: float) -> Protocol:
    variation = None if protocol.variation is None else replace(protocol.variation, friction=None)
    return replace(protocol.with_physics(protocol.name, friction=value), variation=variation)


CONDITIONS: Mapping[str, Condition] = {
    "friction": Condition("friction", _friction, 0.0, 10.0),
    "mass": Condition(
        "mass, times the object's own",
        _physics(density_factor=lambda protocol, value: protocol.physics.density_factor * value),
        1e-3,
        1e3,
        is_factor=True,
    ),
    "mass-g": Condition(
        "mass of every object, g", _physics(object_mass_kg=lambda _, value: value / 1000.0), 1e-3, 1e5, is_factor=True
    ),
    "gain": Condition(
        "position gains, times the protocol's",
        _physics(gain_factor=lambda protocol, value: protocol.physics.gain_factor * value),
        1e-3,
        1e3,
        is_factor=True,
    ),
    "position-mm": Condition(
        "error of the object's place, mm (standard deviation along each axis)",
        _variation("position_sd_m", 1e-3),
        0.0,
        100.0,
    ),
    "rotation-deg": Condition(
        "error of its orientation, degrees (standard deviation)",
        _variation("rotation_sd_rad", math.radians(1.0)),
        0.0,
        90.0,
    ),
    "size-mm": Condition("error of its extents, mm (up to, uniform)", _variation("size_error_m", 1e-3), 0.0, 20.0),
    "step-ms": Condition("time step, ms", _physics(time_step_s=lambda _, value: value / 1000.0), 0.1, 20.0),
}
"""Every condition by its name on the command line."""


@dataclass(frozen=True)
class Sweep:
    """One condition and the values it takes.

    Raises:
        InputError: an unknown condition, no value, one twice, too many, or one out of bounds.

    Examples:
        >>> Sweep.read("friction=0.4:1.2:5").values
        (0.4, 0.6, 0.8, 1.0, 1.2)
        >>> Sweep.read("mass=0.5:4:4").values
        (0.5, 1.0, 2.0, 4.0)
        >>> Sweep.read("mass-g=100").protocol(PAPER, 100).physics.object_mass_kg
        0.1
    """

    condition: str
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        check_name("condition of a sweep", self.condition, CONDITIONS)
        about = CONDITIONS[self.condition]
        if not 1 <= len(self.values) <= _MOST_VALUES or len(set(self.values)) < len(self.values):
            raise InputError(f"a sweep of {self.condition} needs 1 to {_MOST_VALUES} values, each of them once")
        for value in self.values:
            if not about.least <= value <= about.most:
                raise InputError(f"{self.condition} must be {about.least:g} to {about.most:g}, got {value:g}")

    @classmethod
    def read(cls, text: str) -> Sweep:
        """Read a sweep as it is typed: ``friction=0.4:1.2``, ``friction=0.4:1.2:9`` or ``friction=0.5,0.8``.

        A range has five values unless it says how many, evenly spread, and those of a factor by equal ratios.

        Raises:
            InputError: it is spelled in another way, or see `Sweep`.
        """
        spelled = _SPELLING.fullmatch(text.strip())
        examples = "like friction=0.4:1.2, mass=0.5:4:7 (seven values) or step-ms=1,2,4"
        if not spelled:
            raise InputError(f"{text[:80]!r} is no sweep; write it {examples}")
        name, given = spelled["name"].lower().replace("_", "-"), spelled["values"]
        check_name("condition of a sweep", name, CONDITIONS)
        try:
            numbers = tuple(map(float, re.split("[,:]", given)))
        except ValueError:
            raise InputError(f"{given[:80]!r} holds something that is no number; write a sweep {examples}") from None
        if ":" not in given:
            return cls(name, numbers)
        least, most, n = numbers if len(numbers) == 3 else (*numbers[:2], 5)
        if "," in given or len(numbers) > 3 or not least < most or n not in range(2, _MOST_VALUES + 1):
            raise InputError(f"a range is LESS:MORE or LESS:MORE:VALUES, 2 to {_MOST_VALUES} values, got {text[:80]!r}")
        cls(name, (least, most))
        spread = np.geomspace if CONDITIONS[name].is_factor else np.linspace
        return cls(name, tuple(float(f"{value:.6g}") for value in spread(least, most, int(n))))

    def protocol(self, base: Protocol, value: float) -> Protocol:
        """Make the protocol of one value; its name says what differs from the base."""
        changed = CONDITIONS[self.condition].apply(base, value)
        return replace(changed, name=f"{base.name}, {self.condition} {value:g}")


@dataclass(frozen=True)
class Point:
    """What became of the grasps at one value of a sweep."""

    condition: str
    value: float
    evaluation: Evaluation

    def to_json(self) -> dict[str, Any]:
        """Describe value and rates."""
        total = self.evaluation.total
        rates = {"held": total.held_rate, "faithful": total.faithful_rate, "steady": total.steady_rate}
        return {
            "condition": self.condition,
            "value": self.value,
            "protocol": self.evaluation.protocol.name,
            "n": total.n,
            **{name: rate.to_json() for name, rate in rates.items() if rate is not None},
            "verdicts": total.written(),
        }


def sweep(
    proposal: Proposal,
    sweeps: Sequence[Sweep | str],
    *,
    per_cell: int,
    seed: int,
    protocol: Protocol | str = PAPER,
    out: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> list[Point]:
    """Evaluate the same grasps at every value of every sweep, one sweep at a time.

    Args:
        proposal: draws the grasps.
        sweeps: what changes; as values, or as they are typed (see `Sweep.read`).
        per_cell: trials for each object and type at each value.
        seed: of every draw; grasps, and draws of a protocol that varies, are the same at all values.
        protocol: what the sweeps change, or its name.
        out: folder that keeps a folder for each value, which another call goes on from, and `sweep.json`, which lists
            the values of the last call.
        progress: called with trials done and trials in all.
        options: as in `evaluate`, such as `cells`, `hand`, `engine` and `workers`.

    Raises:
        InputError: nothing to sweep, a condition given twice, or see `evaluate`.

    Examples:
        >>> from graspcascade import GraspSampler, as_object, as_type
        >>> cells = [(as_object("box_medium"), as_type("tripod"))]
        >>> points = sweep(GraspSampler.pretrained(), ["friction=0.3,0.8"], per_cell=2, seed=0, cells=cells)
        >>> [point.value for point in points]
        [0.3, 0.8]
    """
    base = as_protocol(protocol)
    if out is not None and Path(out).exists() and not Path(out).is_dir():
        raise InputError(f"{out} is a file; a sweep is kept in a folder")
    chosen = [Sweep.read(each) if isinstance(each, str) else each for each in sweeps]
    names = [each.condition for each in chosen]
    if not names or len(set(names)) < len(names):
        raise InputError(f"give conditions to sweep, each once, got {', '.join(names) or 'none'}")
    # Every protocol is made before hours of trials: one of them may make no sense.
    planned = [(each.condition, value, each.protocol(base, value)) for each in chosen for value in each.values]
    points: list[Point] = []

    def tell(done: int, total: int) -> None:
        if progress is not None:
            progress(len(points) * total + done, len(planned) * total)

    for condition, value, changed in planned:
        folder = None if out is None else Path(out) / f"{condition}={value:.12g}"
        about: dict[str, Any] = options | {"protocol": changed, "out": folder, "progress": tell}
        points.append(Point(condition, value, evaluate(proposal, per_cell=per_cell, seed=seed, **about)))
    if out is not None:
        write_json(Path(out) / SWEEP_FILE, sweep_to_json(points, base), allow_nan=False)
    return points


def sweep_to_json(points: Sequence[Point], base: Protocol) -> dict[str, Any]:
    """Describe the points of sweeps, and what they share, as plain data."""
    first = points[0].evaluation
    shared = {name: getattr(first, name) for name in ("model", "hand", "engine", "seed", "per_cell")}
    about = {"versions": dict(first.versions), "model_metadata": dict(first.model_metadata)}
    used = {point.condition: CONDITIONS[point.condition] for point in points}
    conditions = {name: {"label": one.label, "is_factor": one.is_factor} for name, one in used.items()}
    rows = [point.to_json() for point in points]
    document = {"kind": "graspcascade sweep", "protocol": base.to_json(), **shared, **about}
    return document | {"conditions": conditions, "points": rows}
