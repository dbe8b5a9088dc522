"""The paper's Tables I to III with our rates beside its own, and its comparisons judged by them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from graspcascade.core.intervals import Difference
from graspcascade.proposals.cascade.stages import FACTORIZATIONS, Stage
from graspcascade.proposals.heuristic import HEURISTIC

from .markdown import MISSING, over, points, rate, table
from .published import FULL_MODEL, ORDERINGS, STATEMENTS, SUCCESS_PERCENT, Ordering, PaperTable, Statement
from .runs import Runs, retraining_margin, shared_runs

NOT_RUN = "not yet run"
_SYMBOLS = {
    "posture": "Gc",
    "position": "Gpos",
    "rotation": "Grot",
    "grasp_type": "Gt",
    "grasp_size": "Gs",
    "object_type": "Ot",
    "object_size": "Os",
}
"""The paper's symbols."""
_HEADS = {
    "vmf": "drawn from a von Mises-Fisher distribution",
    "vmf_mixture": "drawn from a mixture of von Mises-Fisher distributions",
    "unit": "a network's output, normalised",
}


def paper_table(paper: PaperTable, runs: Mapping[str, Runs]) -> str:
    """Write one of the paper's tables with our rates beside its own; models that were not run say so."""
    header = (
        "paper's row", "model", _CONTRASTS[paper.contrast][0], "paper %", "held", "faithful", "trials",
        f"held, points over `{FULL_MODEL}`", f"faithful, points over `{FULL_MODEL}`",
    )  # fmt: skip
    rows = []
    for row in paper.rows:
        about = [row.label, f"`{row.model}`", _contrast(paper, row.model), f"{row.success_percent:.2f}"]
        if row.model not in runs:
            rows.append([*about, NOT_RUN, *[MISSING] * 4])
            continue
        ours = runs[row.model]
        total = ours.pooled.total
        full = None if row.model == FULL_MODEL else runs.get(FULL_MODEL)
        rows.append(
            [
                *about,
                rate(total.held_rate),
                rate(total.faithful_rate),
                str(total.n),
                *((MISSING, MISSING) if full is None else over(*(one.total for one in shared_runs(ours, full)))),
            ]
        )
    return f"### Table {paper.number}: {paper.question}\n\n{table(header, rows, text_columns=3)}"


def _stages(stages: Sequence[Stage]) -> str:
    return " ".join(f"P({_symbols(stage.targets)} | {_symbols(stage.given)})" for stage in stages)


def _head(stages: Sequence[Stage]) -> str:
    return next(_HEADS[stage.rotation_head] for stage in stages if "rotation" in stage.targets)


def _given(stages: Sequence[Stage]) -> str:
    return "; ".join(f"{stage.name}: {_symbols(stage.given)}" for stage in stages if stage.name != "posture")


_CONTRASTS: dict[str, tuple[str, Callable[[Sequence[Stage]], str]]] = {
    "stages": ("networks", _stages),
    "head": ("rotation", _head),
    "given": ("what networks are given", _given),
}


def _contrast(paper: PaperTable, model: str) -> str:
    return "none" if model == HEURISTIC else _CONTRASTS[paper.contrast][1](FACTORIZATIONS[model].stages)


def _symbols(quantities: Sequence[str]) -> str:
    return ", ".join(_SYMBOLS[name] for name in quantities)


def statement_table(runs: Mapping[str, Runs]) -> str:
    """Count, for each of the paper's conclusions, how its comparisons came out here."""
    rows = []
    for statement in STATEMENTS:
        rows.append([statement.words, statement.orderings[0].table, str(len(statement.orderings))])
        rows[-1].append(_counts(_verdicts(statement, runs)))
    return table(("what the paper concludes", "table", "comparisons", "here"), rows, text_columns=2)


def orderings(runs: Mapping[str, Runs]) -> str:
    """Judge every comparison of the paper's tables by the trials and by what training again does by itself."""
    header = (
        "table", "the paper's ordering", "verdict", "paper, points", "held, points", "faithful, points",
        "retraining, points",
    )  # fmt: skip
    rows = [_compare(ordering, runs) for ordering in ORDERINGS]
    verdicts = sum((_verdicts(statement, runs) for statement in STATEMENTS), Counter[str]())
    text = (
        "Differences are over the training seeds that both models have: under the same seed they are asked for the "
        "same types, objects and sides, and networks that they have in common are the same. "
        "Reproduced: the difference of held rates is above zero with its whole interval, and larger than what "
        "retraining the same models with other seeds may do by itself. Not reproduced: the same below zero. "
        "Undecided: neither. Retraining: 95 % of differences between equal models would stay within so many points "
        "(residual of a two-way additive model, model + seed, of the rates of all models that have several seeds; "
        "Student's t); between models without a common seed, by the spread over seeds. Each seed has trials of its "
        "own, so that their chance is in it. Where no spread is known, trials alone decide. Each comparison is judged "
        f"by itself, at 95 %: one may come out wrong by chance. Of {len(ORDERINGS)} comparisons: {_counts(verdicts)}; "
        "those of one conclusion stand and fall together, so that conclusions count:"
    )
    return "\n\n".join(
        ["## The paper's comparisons, one by one", text, statement_table(runs), table(header, rows, text_columns=3)]
    )


def _counts(verdicts: Counter[str]) -> str:
    return ", ".join(f"{count} {word}" for word, count in verdicts.most_common())


def _verdicts(statement: Statement, runs: Mapping[str, Runs]) -> Counter[str]:
    return Counter(_compare(ordering, runs)[2].split(",")[0] for ordering in statement.orderings)


def _compare(ordering: Ordering, runs: Mapping[str, Runs]) -> list[str]:
    claim = SUCCESS_PERCENT[ordering.better] - SUCCESS_PERCENT[ordering.worse]
    about = [ordering.table, f"`{ordering.better}` > `{ordering.worse}`"]
    if not {ordering.better, ordering.worse} <= runs.keys():
        return [*about, NOT_RUN, f"{claim:+.2f}", MISSING, MISSING, MISSING]
    better, worse = runs[ordering.better], runs[ordering.worse]
    one, other = (evaluation.total for evaluation in shared_runs(better, worse))
    margin = retraining_margin(better, worse, runs)
    word = judge(one.held_over(other), claim / 100, margin)
    spread = MISSING if margin is None else f"±{100 * margin:.1f}"
    return [*about, word, f"{claim:+.2f}", *over(one, other), spread]


def judge(ours: Difference, claim: float, margin: float | None = None) -> str:
    """Say whether a difference that the paper claims, a share above 0, shows here.

    Args:
        ours: the same difference here.
        claim: the paper's.
        margin: how large a difference retraining may make by itself, None where that is not known.
    """
    margin = margin or 0.0
    if ours.low > 0 and ours.difference > margin:
        return "reproduced"
    if ours.high < 0 and ours.difference < -margin:
        return f"not reproduced, difference {points(ours)}"
    most = max(ours.high, ours.difference + margin)
    return "undecided, but smaller than the paper's" if most < claim else "undecided"
