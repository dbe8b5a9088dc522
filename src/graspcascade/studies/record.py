"""`Evaluation`: what became of the trials of each object and type, and its JSON file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from ..core.errors import FileFormatError
from ..core.files import read_json, write_json
from ..core.intervals import Difference, Interval, newcombe, wilson
from ..core.outcomes import VERDICTS
from ..core.protocols import Protocol
from ..core.records import taxonomy_to_json, types_from_json

KIND = "graspcascade evaluation"
"""Marks the JSON of an evaluation among other files."""
SCHEMA_VERSION = 1
_IF_ANY = ("pushed_out", "turned")
"""Verdicts that files leave out where no trial ended so: few protocols give them, and earlier versions none."""


@dataclass(frozen=True)
class Tally:
    """Count trials by verdict.

    Raises:
        ValueError: other verdicts than `outcomes.VERDICTS`, a negative count, or more faithful or steady than held
            trials.

    Examples:
        >>> tally = Tally(dict.fromkeys(VERDICTS, 0) | {"held": 18, "dropped": 2}, faithful=9)
        >>> tally.n, tally.held_rate.rate, tally.faithful_of_held.rate
        (20, 0.9, 0.5)
    """

    verdicts: Mapping[str, int]
    faithful: int
    """Held trials in which every digit of the type touched the object."""
    steady: int | None = field(default=None, kw_only=True)
    """Held trials in which the object turned by less than `outcomes.STEADY_RAD`; None where turns were not recorded."""

    def __post_init__(self) -> None:
        if tuple(self.verdicts) != VERDICTS or min(self.verdicts.values()) < 0:
            raise ValueError(f"a tally needs a count of each of {', '.join(VERDICTS)}, got {dict(self.verdicts)}")
        for what, count in (("type-faithful", self.faithful), ("steady", self.steady)):
            if count is not None and not 0 <= count <= self.held:
                raise ValueError(f"{count} of {self.held} held trials cannot be {what}")

    @classmethod
    def sum(cls, tallies: Iterable[Tally]) -> Tally:
        """Count trials together."""
        parts = list(tallies)
        verdicts = {name: sum(part.verdicts[name] for part in parts) for name in VERDICTS}
        steady = [part.steady for part in parts if part.steady is not None]
        all_steady = sum(steady) if len(steady) == len(parts) else None
        return Tally(verdicts, sum(part.faithful for part in parts), steady=all_steady)

    def written(self) -> dict[str, int]:
        """Count by verdict as files do."""
        return {name: count for name, count in self.verdicts.items() if count or name not in _IF_ANY}

    @property
    def n(self) -> int:
        """Number of trials."""
        return sum(self.verdicts.values())

    @property
    def held(self) -> int:
        """Number of held trials."""
        return self.verdicts["held"]

    @property
    def held_rate(self) -> Interval:
        """Share of trials that held."""
        return wilson(self.held, self.n)

    @property
    def faithful_rate(self) -> Interval:
        """Share of trials that held and were type-faithful."""
        return wilson(self.faithful, self.n)

    @property
    def steady_rate(self) -> Interval | None:
        """Share of trials that held without a turn of `outcomes.STEADY_RAD`, None where turns were not recorded."""
        return None if self.steady is None else wilson(self.steady, self.n)

    @property
    def faithful_of_held(self) -> Interval:
        """Share of held trials that were type-faithful."""
        return wilson(self.faithful, self.held)

    def held_over(self, base: Tally) -> Difference:
        """Compute by how much more of these trials held than of others."""
        return newcombe(self.held, self.n, base.held, base.n)

    def faithful_over(self, base: Tally) -> Difference:
        """Compute by how much more of these trials held type-faithfully than of others."""
        return newcombe(self.faithful, self.n, base.faithful, base.n)


@dataclass(frozen=True)
class Cell(Tally):
    """Count the trials of one object and one grasp type."""

    grasp_type: str
    object_label: str

    def to_json(self) -> dict[str, Any]:
        """Describe names and counts."""
        steady = {} if self.steady is None else {"steady": self.steady}
        counts = {"n": self.n, "held": self.held, "faithful": self.faithful, **steady, "verdicts": self.written()}
        return {"grasp_type": self.grasp_type, "object": self.object_label, **counts}


@dataclass(frozen=True)
class Evaluation:
    """Hold the outcome of an evaluation; nothing in it depends on the machine's speed.

    Attributes:
        protocol: the trial, every number of it.
        model, hand: names of what was evaluated, and of the hand it was executed with.
        cells: counts for each object and grasp type.
        seed, per_cell: seed of every draw, and trials for each cell.
        versions: versions that the numbers depend on.
        model_metadata: what the caller says of the model.
        engine: name of the engine; evaluations of earlier versions do not say, and were MuJoCo's.
        taxonomy: whose rules the type-faithful were counted by (see `core.taxonomy.TAXONOMIES`).

    Examples:
        >>> from graspcascade import GraspSampler, as_object, as_type
        >>> from graspcascade.studies.evaluate import evaluate
        >>> cell = (as_object("box_small"), as_type("tripod"))
        >>> evaluation = evaluate(GraspSampler.pretrained(), per_cell=4, seed=0, cells=[cell])
        >>> evaluation.n, 0.0 <= evaluation.held.low <= evaluation.held.rate <= evaluation.held.high <= 1.0
        (4, True)
    """

    protocol: Protocol
    model: str
    hand: str
    cells: tuple[Cell, ...]
    seed: int
    per_cell: int
    versions: Mapping[str, str]
    model_metadata: Mapping[str, Any]
    engine: str = "mujoco"
    taxonomy: str = "paper"

    @cached_property
    def total(self) -> Tally:
        """Counts over all cells."""
        return Tally.sum(self.cells)

    @property
    def n(self) -> int:
        """Number of trials."""
        return self.total.n

    @property
    def held(self) -> Interval:
        """Rate of held trials."""
        return self.total.held_rate

    @property
    def faithful(self) -> Interval:
        """Rate of held, type-faithful trials."""
        return self.total.faithful_rate

    @cached_property
    def by_type(self) -> dict[str, Tally]:
        """Counts over the objects, by grasp type."""
        names = dict.fromkeys(cell.grasp_type for cell in self.cells)
        return {name: Tally.sum(cell for cell in self.cells if cell.grasp_type == name) for name in names}

    @cached_property
    def by_object(self) -> dict[str, Tally]:
        """Counts over the types, by object name."""
        labels = dict.fromkeys(cell.object_label for cell in self.cells)
        return {label: Tally.sum(cell for cell in self.cells if cell.object_label == label) for label in labels}

    def to_json(self) -> dict[str, Any]:
        """Describe the record as the command line prints it; totals are spelled out beside the cells they come from."""
        return {
            "kind": KIND,
            "schema_version": SCHEMA_VERSION,
            "protocol": self.protocol.name,
            "engine": self.engine,
            "model": self.model,
            "hand": self.hand,
            **taxonomy_to_json(self.taxonomy),
            "n": self.n,
            "held": self.held.to_json(),
            "faithful": self.faithful.to_json(),
            **({} if self.total.steady_rate is None else {"steady": self.total.steady_rate.to_json()}),
            "cells": [cell.to_json() for cell in self.cells],
            "verdicts": {
                "overall": self.total.written(),
                "by_type": {name: tally.written() for name, tally in self.by_type.items()},
                "by_object": {label: tally.written() for label, tally in self.by_object.items()},
            },
            "seed": self.seed,
            "per_cell": self.per_cell,
            "model_metadata": dict(self.model_metadata),
            "protocol_parameters": self.protocol.to_json(),
            "versions": dict(self.versions),
        }

    @classmethod
    def from_json(cls, data: Any) -> Evaluation:
        """Rebuild from `to_json()`.

        Raises:
            FileFormatError: it is something else, of another schema, or its totals are not those of its cells.
        """
        if not is_evaluation(data):
            raise FileFormatError(f'not an evaluation: it lacks "kind": "{KIND}"')
        if data.get("schema_version") != SCHEMA_VERSION:
            raise FileFormatError(f"schema version {data.get('schema_version')!r}; this version reads {SCHEMA_VERSION}")
        data = {"engine": "mujoco", "taxonomy": "paper"} | data
        types_from_json(data)
        try:
            kinds = {
                "model": str,
                "hand": str,
                "engine": str,
                "taxonomy": str,
                "seed": int,
                "per_cell": int,
                "versions": dict,
                "model_metadata": dict,
            }
            protocol, cells = Protocol.from_json(data["protocol_parameters"]), tuple(map(_cell, data["cells"]))
            evaluation = cls(protocol, cells=cells, **{name: kind(data[name]) for name, kind in kinds.items()})
        except KeyError as error:
            raise FileFormatError(f"the evaluation lacks {error.args[0]!r}") from error
        except (TypeError, ValueError) as error:
            raise FileFormatError(f"the evaluation is malformed: {error}") from error
        places = {(cell.object_label, cell.grasp_type) for cell in cells}
        if not cells or len(places) < len(cells) or {cell.n for cell in cells} != {evaluation.per_cell}:
            raise FileFormatError("the evaluation needs distinct cells of per_cell trials each")
        # Earlier versions wrote the same numbers of the protocol as one flat record.
        given = {**data, "protocol_parameters": evaluation.protocol.to_json()}
        if differing := [key for key, value in evaluation.to_json().items() if not _same(value, given.get(key))]:
            raise FileFormatError(f"the evaluation contradicts itself in {', '.join(differing)}")
        return evaluation

    def save(self, path: Path | str) -> None:
        """Write the JSON file atomically."""
        write_json(Path(path), self.to_json(), allow_nan=False)

    @classmethod
    def load(cls, path: Path | str) -> Evaluation:
        """Read an evaluation.

        Raises:
            FileFormatError: the file is missing, truncated or foreign.
        """
        data = read_json(Path(path))
        try:
            return cls.from_json(data)
        except FileFormatError as error:
            raise FileFormatError(f"{path}: {error}") from error


def is_evaluation(data: Any) -> bool:
    """Tell whether parsed JSON claims to be an evaluation."""
    return isinstance(data, dict) and data.get("kind") == KIND


def _cell(data: Mapping[str, Any]) -> Cell:
    verdicts = {name: int(data["verdicts"].get(name, 0)) for name in VERDICTS}
    steady = int(data["steady"]) if "steady" in data else None
    return Cell(verdicts, int(data["faithful"]), str(data["grasp_type"]), str(data["object"]), steady=steady)


def _same(one: Any, other: Any) -> bool:
    """Compare JSON values, real numbers up to the rounding of another machine."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_same(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(_same(a, b) for a, b in zip(one, other, strict=True))
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) <= 1e-9 * max(1.0, abs(one))
    return bool(one == other)
