"""Two models of the paper's experiment compared: over which training seeds, and what retraining may do by itself."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import variance

import numpy as np

from ..evaluation.record import Evaluation, pool
from .paper_runs import Runs


def shared_runs(one: Runs, other: Runs) -> tuple[Evaluation, Evaluation]:
    """Pool the runs of two models over the training seeds that both have; all runs, where they share none.

    Under the same seed models are asked for the same types, objects and sides, and networks that they have in common
    are the same.
    """
    seeds = _shared_seeds(one, other)
    if not seeds:
        return one.pooled, other.pooled
    return pool([one.by_seed[seed] for seed in seeds]), pool([other.by_seed[seed] for seed in seeds])


def retraining_margin(one: Runs, other: Runs, spread_of: Mapping[str, Runs]) -> float | None:
    """Give how far the held rates of two models may differ, in 95 of 100 cases, by retraining and drawing afresh.

    Compared over shared seeds, models differ by what is left of the rates of all models that have several seeds once
    the model's and the seed's own part are taken off (least squares); else by the variance between a model's seeds,
    pooled. Student's t for the degrees of freedom. Each seed's trials are drawn afresh, so that their chance is part of
    either.

    Args:
        one: runs of a model.
        other: runs of another.
        spread_of: runs of all models.

    Returns:
        A share, None where too few models have several seeds for it to be known.
    """
    from scipy.stats import t

    shared = _shared_seeds(one, other)
    several = [runs for runs in spread_of.values() if len(runs.by_seed) > 1]
    if shared:
        squares, freedom = _beside_model_and_seed(several)
        shares = 2.0 / len(shared)
    else:
        rates = [[found.held.rate for found in runs.by_seed.values()] for runs in several]
        freedom = sum(len(group) - 1 for group in rates)
        squares = sum((len(group) - 1) * variance(group) for group in rates)
        shares = sum(1 / len(runs.by_seed) for runs in (one, other) if None not in runs.by_seed)
    if freedom < 1:
        return None
    return float(t.ppf(0.975, freedom) * math.sqrt(squares / freedom * shares))


def _shared_seeds(one: Runs, other: Runs) -> list[int | None]:
    return [seed for seed in one.by_seed if seed is not None and seed in other.by_seed]


def _beside_model_and_seed(several: Sequence[Runs]) -> tuple[float, int]:
    """Give the sum of squares that models and seeds leave of the held rates, and its degrees of freedom."""
    found = [(number, seed, one.held.rate) for number, runs in enumerate(several) for seed, one in runs.by_seed.items()]
    if not found:
        return 0.0, 0
    models, seeds, rates = map(np.array, zip(*found, strict=True))
    design = np.hstack([np.equal.outer(column, np.unique(column)) for column in (models, seeds)]).astype(float)
    solution, _, rank, _ = np.linalg.lstsq(design, rates, rcond=None)
    return float(((rates - design @ solution) ** 2).sum()), len(rates) - int(rank)
