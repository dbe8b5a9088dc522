"""Training the scorer of grasps on trials, and how well its chances are kept (needs torch, the `train` extra)."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import rankdata

from ..core.errors import InputError
from ..core.grasps import Grasps
from ..core.machine import versions
from ..core.protocols import HOLD, Conditions
from ..hands import Hand
from ..nets import EpochRecord, HeadSpec, NumpyDecoder, TrainingSpec, VaeSpec
from ..nets.inference import Layer
from ..proposals.scorer import Scorer, Sight, View
from .dataset import Dataset, shards_digest

Array = NDArray[np.float64]
HELD_OUT = 0.1
"""Share of the objects on which the scorer is calibrated, and as many on which it is judged."""
_BINS = 15


@dataclass(frozen=True)
class ScorerTraining:
    """Say what the scorer sees and how long it learns."""

    sight: Sight = field(default_factory=Sight)
    """What the scorer sees."""
    hidden: tuple[int, ...] = (128, 128)
    """Widths of the hidden layers."""
    training: TrainingSpec = field(
        default_factory=lambda: TrainingSpec(
            epochs=20, max_steps=12_000, batch_size=512, learning_rate=2e-3, weight_decay=1e-3, validation_fraction=0.0
        )
    )
    """The training loop."""


@dataclass(frozen=True)
class Judgement:
    """How well chances were kept on objects that the scorer did not learn from.

    Attributes:
        n: grasps judged.
        auc: chance that a success is ranked above a failure.
        calibration_error: expected calibration error over 15 bins of equal count (DOI 10.48550/arXiv.1706.04599).
        rate: share of successes.
        rate_of_best_quarter: the same of the quarter ranked highest.
    """

    n: int
    auc: float
    calibration_error: float
    rate: float
    rate_of_best_quarter: float

    @classmethod
    def of(cls, chance: Array, happened: NDArray[np.bool_]) -> Judgement:
        """Judge chances ``(n,)`` by what happened ``(n,)``."""
        n, hits = len(chance), int(happened.sum())
        ranks = rankdata(chance)[happened].sum() - hits * (hits + 1) / 2
        order = np.argsort(chance, kind="stable")
        parts = np.array_split(order, _BINS)
        gaps = [abs(chance[part].mean() - happened[part].mean()) * len(part) for part in parts if len(part)]
        best = happened[order[-max(1, n // 4) :]].mean()
        area = ranks / max(1, hits * (n - hits))
        return cls(n, *(round(float(v), 5) for v in (area, sum(gaps) / n, happened.mean(), best)))


@dataclass(frozen=True, eq=False)
class FittedScorer:
    """Hold a trained scorer, its training curve, and judgements by event and by whether poses were exact."""

    scorer: Scorer
    history: tuple[EpochRecord, ...]
    judged: dict[str, Judgement]


def fit_scorer(
    hand: Hand,
    datasets: Sequence[Dataset],
    config: ScorerTraining | None = None,
    progress: Callable[[EpochRecord], None] | None = None,
) -> FittedScorer:
    """Train a scorer on successes and failures, calibrate it and judge it, each on objects of its own.

    Every trial is learned from twice: as it was, with the errors that its conditions drew, and as it was said to be.

    Args:
        hand: the hand that the datasets are of.
        datasets: trials, those of one taxonomy.
        config: what to see and how long to learn.
        progress: called after each epoch.

    Raises:
        InputError: no datasets, or they are of other hands.
        FloatingPointError: the loss stopped being finite.
    """
    # torch is an optional extra: only fitting needs it.
    from ..nets.training import fit

    config = config or ScorerTraining()
    if not datasets or any(each.grasps.hand != hand.name for each in datasets):
        raise InputError(f"a scorer learns from datasets of {hand.name}, at least one")
    kinds = list(dict.fromkeys(task.grasp_type for each in datasets for task in each.grasps.tasks.distinct))
    view = View.of(hand, [kind.name for kind in kinds], config.sight)
    known, said, happened, share = [], [], [], []
    tried: dict[str, list[Array]] = {"friction": [], "mass_g": []}
    for each in datasets:
        about = each.conditions or Conditions.of(HOLD.physics, len(each.grasps))
        known.append(view.encode(hand, each.grasps, about, is_exact=True))
        said.append(view.encode(hand, each.grasps, without_errors(about), is_exact=False))
        happened.append(np.stack([each.outcomes.held, each.outcomes.faithful(each.grasps)], axis=1))
        share.append(_share(each.grasps))
        tried["friction"].append(about.friction)
        mass_g = each.grasps.tasks.column(lambda task: 1000 * task.object.mass_kg, np.float64)
        tried["mass_g"].append(mass_g * about.density_factor)
    seen, events, shares = (np.concatenate(parts) for parts in ([*known, *said], happened * 2, share * 2))
    train, calibrate = shares >= 2 * HELD_OUT, shares < HELD_OUT
    spec = VaeSpec(view.width(hand), (HeadSpec("chance", 2),), latent_dim=0, hidden=config.hidden)
    fitted = fit(spec, config.training, events[train].astype(np.float32), seen[train], progress=progress)
    decoder = calibrated(NumpyDecoder.from_fitted(fitted), seen[calibrate], events[calibrate])
    about_it: dict[str, Any] = {
        "config": asdict(config),
        "trials": sum(len(each.grasps) for each in datasets),
        "seen": {name: _range(np.concatenate(parts)) for name, parts in tried.items()},
        "shards": [shards_digest(each.metadata) for each in datasets],
        "versions": versions() | {"torch": version("torch")},
    }
    scorer = Scorer(hand, view, decoder, about_it)
    judged = {}
    exact = np.arange(len(seen)) < len(seen) // 2
    for pose, rows in (("exact", exact), ("uncertain", ~exact)):
        rows &= ~train & ~calibrate
        chance = decoder.sample(seen[rows], np.random.default_rng(0))
        for column, event in enumerate(("held", "faithful")):
            judged[f"{event}, {pose}"] = Judgement.of(chance[:, column], events[rows, column])
    about_it["judged"] = {name: asdict(each) for name, each in judged.items()}
    return FittedScorer(scorer, fitted.history, judged)


def without_errors(conditions: Conditions) -> Conditions:
    """Make the conditions that one knows who takes the object for what it is said to be."""
    still = np.zeros_like(conditions.position_error_m)
    return replace(conditions, position_error_m=still, rotation_error_rad=still, size_error_m=still[:, 0])


def calibrated(decoder: NumpyDecoder, seen: NDArray[np.float32], events: NDArray[np.bool_]) -> NumpyDecoder:
    """Stretch and shift the outputs of a decoder of chances so that they fit what happened best (Platt's scaling)."""
    raw = decoder.decode(np.empty((len(seen), 0)), seen).astype(np.float64)
    last = decoder.layers[-1]
    matrix, bias = last.matrix.astype(np.float64), last.bias.astype(np.float64)
    for column in range(raw.shape[1]):
        sign, logit = np.where(events[:, column], -1.0, 1.0), raw[:, column]

        def loss(by: Array, sign: Array = sign, logit: Array = logit) -> float:
            return float(np.logaddexp(0.0, sign * (by[0] * logit + by[1])).mean())

        stretch, shift = minimize(loss, [1.0, 0.0], method="BFGS").x
        matrix[:, column] *= stretch
        bias[column] = stretch * bias[column] + shift
    layer = Layer(np.ascontiguousarray(matrix, dtype=np.float32), bias.astype(np.float32))
    return replace(decoder, layers=(*decoder.layers[:-1], layer))


def _range(values: Array) -> list[float]:
    return [round(float(bound), 2) for bound in (values.min(), values.max())]


def _share(grasps: Grasps) -> Array:
    """Draw a number from 0 to 1 for each grasp ``(n,)``, the same for all of one object."""
    names = {task.object.name for task in grasps.tasks.distinct}
    drawn = {name: int(hashlib.sha256(name.encode()).hexdigest()[:8], 16) / 2**32 for name in names}
    return grasps.tasks.column(lambda task: drawn[task.object.name], np.float64)
