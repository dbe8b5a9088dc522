"""What grasp size and object size to ask for when a user names a side: offsets measured on trials."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ...core.errors import InputError, check_name
from ...core.intervals import wilson_bounds
from ...core.tasks import Task
from .encoding import Request

Array = NDArray[np.float64]
SizeMode = Literal["best", "median", "drawn", "paper"]

PAPER_GRASP_OFFSET_M = -0.005
"""The paper's grasp size minus side (section V)."""
PAPER_OBJECT_OFFSET_M = 0.010
"""The paper's object size minus side (section V)."""
_KNOTS = np.linspace(0.05, 0.95, 19)
_MIN_GRASPS = 10
"""Fewer in a cell say little, so that a wider one speaks for it."""
_WINDOW_M = 0.003
"""Half-width of the window of grasp sizes over which a success rate is measured."""
_LEAST_SHARE = 0.02
"""Windows with a smaller share of the trials are not considered: one success in one trial says nothing."""
_CONSIDERED = (0.05, 0.75)
"""Quantiles of the successes' sizes between which the best is looked for. Postures that cannot touch were screened out,
so that rates near the wide edge flatter."""
_TIE = 0.01
"""Windows whose rates differ by no more than this share count as equally good."""


@dataclass(frozen=True)
class SizeRule:
    """Choose sizes for requests, from tables keyed "type/object/axis", "type/object" and "type", finest first.

    Attributes:
        best_offset_m: grasp size minus side where trials succeeded most often.
        grasp_offsets_m: the 5 to 95 % quantiles of grasp size minus side among successes.
        object_offset_m: median of object size minus side among successes.

    Examples:
        >>> from graspcascade import Task, Tasks, as_object, as_type
        >>> rule = SizeRule({"tripod": -0.01}, {"tripod": [-0.02] * 19}, {"tripod": 0.008})
        >>> tasks = Tasks.of([Task.of(as_type("tripod"), as_object("box_medium"), "x")])
        >>> request = Request(tasks, np.zeros(1), np.zeros(1))
        >>> grasp_size_m, object_size_m = rule.apply(request, "best", np.random.default_rng(0))
        >>> tasks.side_m.tolist(), grasp_size_m.round(3).tolist(), object_size_m.round(3).tolist()
        ([0.03], [0.02], [0.038])
    """

    best_offset_m: dict[str, float]
    grasp_offsets_m: dict[str, list[float]]
    object_offset_m: dict[str, float]

    def __post_init__(self) -> None:
        keys, lengths = self.best_offset_m.keys(), {len(knots) for knots in self.grasp_offsets_m.values()}
        if not keys == self.grasp_offsets_m.keys() == self.object_offset_m.keys() or lengths - {len(_KNOTS)}:
            raise InputError(f"tables of sizes need the same entries, grasp_offsets_m {len(_KNOTS)} numbers in each")

    @classmethod
    def measure(cls, request: Request, success: NDArray[np.bool_], held: NDArray[np.bool_]) -> SizeRule:
        """Measure the offsets on trials.

        Args:
            request: what was tried, with the sizes of each.
            success: ``(n,)`` the successes to learn from.
            held: ``(n,)`` all that held, for cells where too few of the former exist.
        """
        tasks = request.tasks
        grasp, obj = request.grasp_size_m - tasks.side_m, request.object_size_m - tasks.side_m
        rule = cls({}, {}, {})
        levels = tasks.column(_levels, str).reshape(len(tasks), 3)
        for level in levels.T:
            for key in np.unique(level):
                rows = level == key
                good = _measured_on(rows, success, held, is_type="/" not in key)
                if good is None:
                    continue
                some = rows & good
                low, high = np.quantile(grasp[some], _CONSIDERED)
                best = _best(grasp[rows], good[rows], float(low), float(high))
                rule.best_offset_m[str(key)] = round(best, 5)
                rule.grasp_offsets_m[str(key)] = [round(float(v), 5) for v in np.quantile(grasp[some], _KNOTS)]
                rule.object_offset_m[str(key)] = round(float(np.median(obj[some])), 5)
        return rule

    def apply(self, request: Request, mode: SizeMode, rng: np.random.Generator) -> tuple[Array, Array]:
        """Compute grasp sizes and object sizes ``(n,)`` in metres for each row's side.

        Args:
            request: its own sizes are ignored.
            mode: where trials succeeded "best"; the "median" of successes, or "drawn" from them; the "paper" constants.
            rng: source of the draws; used in every mode, so that modes stay comparable.

        Raises:
            InputError: an unknown mode, or a type that the tables lack.
        """
        check_name("size mode", mode, get_args(SizeMode))
        tasks, side_m = request.tasks, request.tasks.side_m
        share = rng.uniform(size=len(side_m))
        if mode == "paper":
            return side_m + PAPER_GRASP_OFFSET_M, side_m + PAPER_OBJECT_OFFSET_M
        at = share if mode == "drawn" else np.full_like(share, 0.5)
        grasp_offset, object_offset = np.empty_like(share), np.empty_like(share)
        for place in tasks.used:
            rows, key = tasks.row == place, self._finest(tasks.table[place])
            object_offset[rows] = self.object_offset_m[key]
            best = self.best_offset_m[key]
            grasp_offset[rows] = best if mode == "best" else np.interp(at[rows], _KNOTS, self.grasp_offsets_m[key])
        return side_m + grasp_offset, side_m + object_offset

    def _finest(self, task: Task) -> str:
        levels = _levels(task)
        measured = next((level for level in levels if level in self.best_offset_m), None)
        if measured is None:
            raise InputError(f"there are no sizes of type {levels[-1]!r}")
        return measured


def _measured_on(
    rows: NDArray[np.bool_], success: NDArray[np.bool_], held: NDArray[np.bool_], *, is_type: bool
) -> NDArray[np.bool_] | None:
    """Choose what to measure a cell on, the successes or all that held; None where both are too few."""
    choices = [(success, _MIN_GRASPS), (held, _MIN_GRASPS)]
    if is_type:  # Nothing is wider, and every grasp that is learned from needs a size.
        choices.append((success, 1))
    return next((good for good, least in choices if (rows & good).sum() >= least), None)


def _levels(task: Task) -> tuple[str, str, str]:
    """Widen a task: "type/object/axis", "type/object", "type"."""
    kind, name = task.grasp_type.name, task.object.name
    return f"{kind}/{name}/{task.site.name}", f"{kind}/{name}", kind


def _best(offset: Array, success: NDArray[np.bool_], low: float, high: float) -> float:
    """Find the offset between two bounds around which successes are most frequent, wary of windows with few trials.

    A window's rate counts by the lower bound of its 95 % interval.
    """
    grid = np.arange(low, high + 0.0005, 0.0005)
    order = np.argsort(offset)
    totals = np.concatenate([[0], np.cumsum(success[order])])
    first = np.searchsorted(offset[order], grid - _WINDOW_M)
    last = np.searchsorted(offset[order], grid + _WINDOW_M, side="right")
    rate, _ = wilson_bounds(totals[last] - totals[first], last - first)
    enough = last - first >= _LEAST_SHARE * len(offset)
    rate = np.where(enough | ~enough.any(), rate, 0.0)
    best = int(np.argmax(rate))
    # Of a run of equally good windows the middle one: farthest from where it gets worse.
    worse = np.flatnonzero(rate < (1.0 - _TIE) * rate[best])
    begin = worse[worse < best].max(initial=-1) + 1
    end = worse[worse > best].min(initial=len(grid)) - 1
    return float((grid[begin] + grid[end]) / 2)
