"""How the models of the paper's experiment were trained: spread over seeds, settings, curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import stdev

from ..evaluation import HEURISTIC
from .gallery import TRAINING_CURVES, Gallery
from .markdown import MISSING, percent, plain, rates, table
from .paper_runs import PaperRuns, Runs, metadata_differences, settings
from .published import FULL_MODEL

_ROUNDING_NATS = 1e-6


def seed_section(runs: Mapping[str, Runs]) -> list[str]:
    """List the rates of every training seed and their spread; nothing where no model has several."""
    several = [found for found in runs.values() if len(found.by_seed) > 1]
    if not several:
        return []
    rows = []
    for found in several:
        for seed, one in found.by_seed.items():
            rows.append([f"`{found.model}`", plain(seed), *rates(one)])
        rows.append([f"`{found.model}`", "all", *rates(found.pooled)])
    spreads = [
        [
            f"`{found.model}`",
            str(len(found.by_seed)),
            *_range([one.held.rate for one in found.by_seed.values()]),
            *_range([one.faithful.rate for one in found.by_seed.values()]),
        ]
        for found in several
    ]
    header = (
        "model", "training seeds", "held, lowest to highest %", "standard deviation, points",
        "faithful, lowest to highest %", "standard deviation, points",
    )  # fmt: skip
    return [
        "### Training seeds",
        table(("model", "training seed", "trials", "held", "faithful"), rows, text_columns=2),
        "Spread over the seeds:",
        table(header, spreads),
    ]


def _range(shares: Sequence[float]) -> tuple[str, str]:
    return f"{percent(min(shares))} to {percent(max(shares))}", f"{100 * stdev(shares):.2f}"


def settings_section(found: PaperRuns) -> list[str]:
    """Say how models were trained, and which of them differently, which a comparison of them must know."""
    versions = sorted(
        {
            ", ".join([f"seed {one.seed}", *(f"{name} {version}" for name, version in one.versions.items())])
            for run in found.runs.values()
            for one in run.by_seed.values()
        }
    )
    blocks = ["### Settings", f"Evaluated with {'; '.join(versions)}."]
    if FULL_MODEL not in found.runs:
        return blocks
    seed, full = next(iter(found.runs[FULL_MODEL].by_seed.items()))
    if full.model_metadata:
        facts = [(key, plain(value)) for key, value in settings(full)]
        blocks += [f"`{FULL_MODEL}`, training seed {plain(seed)}:", table(("setting", "value"), facts, text_columns=2)]
    differing = [
        [f"`{name}`", plain(seed), difference]
        for name, run in found.runs.items()
        if name != HEURISTIC
        for seed, one in run.by_seed.items()
        if (difference := metadata_differences(one, full))
    ]
    if not differing:
        return [*blocks, "The other models were trained on the same data with the same settings."]
    text = "Not trained on the same data with the same settings:"
    return [*blocks, text, table(("model", "training seed", "what differs"), differing, text_columns=3)]


def _divergence(nats: float) -> str:
    # That of unused latents is 0 but for rounding, of either sign.
    return "0" if abs(nats) < _ROUNDING_NATS else f"{nats:.4g}"


def curve_section(found: PaperRuns, gallery: Gallery) -> list[str]:
    """List where every training ended, and show the curves."""
    rows = []
    for curves in found.training:
        for stage, values in curves.stages.items():
            validation = values.validation_loss[-1]
            rows.append(
                [
                    f"`{curves.model}`",
                    curves.panel(stage),
                    str(curves.seed),
                    str(values.epoch[-1]),
                    f"{values.train_loss[-1]:.4g}",
                    f"{values.train_reconstruction[-1]:.4g}",
                    _divergence(values.train_kl[-1]),
                    MISSING if validation is None else f"{validation:.4g}",
                ]
            )
    header = (
        "model", "stage", "training seed", "epochs", "loss", "reconstruction", "divergence", "loss of held-out rows",
    )  # fmt: skip
    return [
        "### Training curves",
        "The last epoch of every stage; losses of different stages, or of different outputs, are on different scales. "
        "The divergence's weight rises over the beginning of a run, so that losses of its first epochs are another "
        "quantity. A network with a divergence of 0 leaves its latents unused and draws nothing: its outputs follow "
        "from what it is given, as the heuristic's position follows from the posture. A grasp of a rare object and "
        "type that is repeated in training may be among the held-out rows too.",
        table(header, rows, text_columns=2),
        *gallery.show(TRAINING_CURVES, "Loss on held-out rows (solid) and on the training rows (dotted) by epoch"),
    ]
