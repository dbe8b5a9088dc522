"""``graspcascade bench``: how fast everything is on this machine, against stated yardsticks."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..bench import PARTS, BenchSpec, run_bench
from ..bench.run import check_parts
from ..errors import InputError
from ..files import write_json
from .console import bar, plain, print_json, print_table
from .needs import need


@dataclass(frozen=True)
class Bench:
    """Measure trials, sampling and training on this machine, each against a yardstick measured beside it.

    The gain of collection and evaluation is their trials per second over those of the bare engine that steps every
    trial of the full hand to its end.
    """

    only: tuple[str, ...] = ()
    """What to measure: raw, collection, evaluation, evaluation_heuristic, sampling, cold_start, training; all without
    it."""
    spec: BenchSpec = field(default_factory=BenchSpec)
    """How much."""
    data: Path | None = None
    """Folder of a dataset whose successes to train on; samples of the shipped cascade without it."""
    out: Path | None = None
    """Also write the numbers to this .json file."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        """Measure, then print and write."""
        parts = check_parts(self.only)
        if "collection" in parts or "training" in parts:
            need("pyarrow")
        if "training" in parts:
            need("torch")
        if self.out is not None and (self.out.suffix.lower() != ".json" or self.out.is_dir()):
            raise InputError(f"the numbers are written to a .json file, got {self.out.name!r}")
        with bar("bench") as progress:
            found = plain(
                run_bench(
                    self.spec,
                    self.only,
                    data=self.data,
                    report=lambda done, total, what: progress.show(done, total, note=what),
                )
            )
        if self.out is not None:
            write_json(self.out, found, allow_nan=False)
        if self.json:
            print_json(found)
        else:
            _print(found)


def _print(found: dict[str, Any]) -> None:
    about = found["environment"]
    print(f"{about['cpu']}, {about['logical_cores']} logical cores, {about['threads']} threads")
    rows = [row for part in PARTS if part in found for row in _ROWS.get(part, _trial_rows)(part, found[part])]
    print_table(["measured", "unit", "median", "min", "max"], rows, left=(0, 1))
    if found.get("training", {}).get("extrapolated"):
        epochs, measured = found["training"]["epochs"], found["training"]["epochs_measured"]
        print(f"training is extrapolated from {measured} to {epochs} epochs")


def _trial_rows(part: str, found: dict[str, Any]) -> list[list[str]]:
    name = part.replace("_", " ")
    rows = [
        [name, "trials/s", *_spread(found["trials_per_s"], "1f")],
        [name, "held/s", *_spread(found["held_per_s"], "1f")],
        [name, "gain", *_spread(found["gain"], "2f")],
    ]
    if "peak_rss_mb" in found:
        rows.append([name, "peak MB", f"{found['peak_rss_mb']:.0f}", "", ""])
    return rows


def _raw_rows(_: str, found: dict[str, Any]) -> list[list[str]]:
    return [["raw engine", "steps/s", *_spread(found["steps_per_s"], "0f")]]


def _sampling_rows(_: str, found: dict[str, Any]) -> list[list[str]]:
    name = f"sampling {found['grasps']} grasps"
    return [
        [name, "ms", *_spread(found["ms"], "2f")],
        ["its matrix products", "ms", *_spread(found["yardstick_ms"], "2f")],
        [name, "ratio", f"{found['ratio']:.2f}", "", ""],
    ]


def _cold_start_rows(_: str, found: dict[str, Any]) -> list[list[str]]:
    return [
        ["cold start of sample", "s", *_spread(found["s"], "3f")],
        [found["yardstick"], "s", *_spread(found["yardstick_s"], "3f")],
        ["cold start of sample", "ratio", f"{found['ratio']:.2f}", "", ""],
    ]


def _training_rows(_: str, found: dict[str, Any]) -> list[list[str]]:
    name = f"training on {found['rows']} grasps"
    return [
        [name, "s", f"{found['s']:.1f}", "", ""],
        ["its matrix products", "s", f"{found['yardstick_s']:.1f}", "", ""],
        [name, "ratio", f"{found['ratio']:.2f}", "", ""],
    ]


_ROWS = {
    "raw": _raw_rows,
    "sampling": _sampling_rows,
    "cold_start": _cold_start_rows,
    "training": _training_rows,
}


def _spread(found: dict[str, float], form: str) -> list[str]:
    return [format(found[name], f".{form}") for name in ("median", "min", "max")]
