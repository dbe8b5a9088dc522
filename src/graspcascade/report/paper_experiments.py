"""What else was tried with the paper's models, each beside the model it was made of."""

from __future__ import annotations

from .markdown import MISSING, over, rate, rates, table
from .paper_runs import PaperRuns, metadata_differences
from .published import FULL_MODEL


def experiment_section(found: PaperRuns) -> list[str]:
    """Compare every experiment with the model it was made of, and models that had the same done to them."""
    rows = []
    for label, one in found.experiments.items():
        base = found.base_of(one)
        rows.append(
            [
                label,
                MISSING if base is None else f"`{base.model}`",
                MISSING if base is None else metadata_differences(one, base) or MISSING,
                f"`{one.protocol.name}`",
                *rates(one),
                *(over(one.total, base.total) if base is not None and found.comparable(one) else (MISSING, MISSING)),
            ]
        )
    header = (
        "experiment", "made of", "settings that differ", "protocol", "trials", "held", "faithful",
        "held, points over it", "faithful, points over it",
    )  # fmt: skip
    text = (
        "Models with other settings than those above, each compared with the model it is made of, of the same training "
        "seed, where hand, cells and protocol are the same. One training each: what retraining does by itself is told "
        "above."
    )
    return ["### Experiments", text, table(header, rows, text_columns=4), *_paired_experiments(found)]


def _paired_experiments(found: PaperRuns) -> list[str]:
    """Compare the full model with others that had the same done to them."""
    rows = []
    for setting, models in found.by_setting.items():
        full = models[FULL_MODEL].total
        for name, one in models.items():
            if name != FULL_MODEL:
                rows.append(
                    [
                        setting,
                        f"`{name}`",
                        *(f"{rate(tally.held_rate)} of {tally.n}" for tally in (full, one.total)),
                        *over(full, one.total),
                    ]
                )
    if not rows:
        return []
    header = (
        "setting", "compared with", f"`{FULL_MODEL}`, held", "the other, held",
        f"`{FULL_MODEL}` above it, held, points", "faithful, points",
    )  # fmt: skip
    text = (
        f"What the division into stages brings under a setting, which both models share: `{FULL_MODEL}` beside others "
        "of the same training seed."
    )
    return [text, table(header, rows, text_columns=2)]
