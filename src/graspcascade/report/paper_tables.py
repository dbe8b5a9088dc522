"""The paper's Tables I to III with our rates beside its own, and its orderings judged by them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from ..cascade import FACTORIZATIONS, Stage
from ..evaluation import HEURISTIC
from ..intervals import Difference
from .markdown import MISSING, over, points, rate, table
from .paper_runs import Runs
from .published import FULL_MODEL, ORDERINGS, STATEMENTS, SUCCESS_PERCENT, Ordering, PaperTable
from .retraining import retraining_margin, shared_runs

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


def table_section(paper: PaperTable, runs: Mapping[str, Runs]) -> str:
    """Word one of the paper's tables; models that were not run say so."""
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
        found = runs[row.model]
        total = found.pooled.total
        full = None if row.model == FULL_MODEL else runs.get(FULL_MODEL)
        rows.append(
            [
                *about,
                rate(total.held_rate),
                rate(total.faithful_rate),
                str(total.n),
                *((MISSING, MISSING) if full is None else over(*(one.total for one in shared_runs(found, full)))),
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


def orderings_section(runs: Mapping[str, Runs]) -> list[str]:
    """Judge every ordering of the paper's tables by the trials and by what retraining does by itself."""
    header = (
        "table", "the paper's ordering", "verdict", "paper, points", "held, points", "faithful, points",
        "retraining, points",
    )  # fmt: skip
    rows, verdicts, statements = [], Counter[str](), []
    for statement in STATEMENTS:
        found = Counter[str]()
        for ordering in statement.orderings:
            claim = SUCCESS_PERCENT[ordering.better] - SUCCESS_PERCENT[ordering.worse]
            word, *numbers = _compare(ordering, claim / 100, runs)
            found[word.split(",")[0]] += 1
            name = f"`{ordering.better}` > `{ordering.worse}`"
            rows.append([ordering.table, name, word, f"{claim:+.2f}", *numbers])
        statements.append([statement.words, statement.orderings[0].table, str(found.total()), _counts(found)])
        verdicts += found
    text = (
        "Differences are over the training seeds that both models have: under the same seed they are asked for the "
        "same types, objects and sides, and networks that they have in common are the same. "
        "Reproduced: the difference of held rates is above zero with its whole interval, and larger than what "
        "retraining the same models with other seeds may do by itself. Not reproduced: the same below zero. "
        "Undecided: neither. Retraining: 95 % of differences between equal models would stay within so many points, "
        "by what model and seed leave of the spread of the rates of all models that have several seeds, Student's t; "
        "between models without a common seed, by the spread over seeds. Each seed has trials of its own, so that "
        "their chance is in it. Where no spread is known, trials alone decide. Each ordering is judged by "
        f"itself, at 95 %: one may come out wrong by chance. Of {len(ORDERINGS)} orderings: {_counts(verdicts)}; those "
        "of one statement stand and fall together, so that statements count:"
    )
    summary = table(("what the paper concludes", "table", "orderings", "verdicts"), statements, text_columns=2)
    return ["### The paper's orderings", text, summary, table(header, rows, text_columns=3)]


def _counts(verdicts: Counter[str]) -> str:
    return ", ".join(f"{count} {word}" for word, count in verdicts.most_common())


def _compare(ordering: Ordering, claim: float, runs: Mapping[str, Runs]) -> tuple[str, str, str, str]:
    if not {ordering.better, ordering.worse} <= runs.keys():
        return NOT_RUN, MISSING, MISSING, MISSING
    better, worse = runs[ordering.better], runs[ordering.worse]
    one, other = (found.total for found in shared_runs(better, worse))
    margin = retraining_margin(better, worse, runs)
    word = judge(one.held_over(other), claim, margin)
    return word, *over(one, other), MISSING if margin is None else f"±{100 * margin:.1f}"


def judge(found: Difference, claim: float, margin: float | None = None) -> str:
    """Say whether a difference that the paper claims, a share above 0, is found here.

    Args:
        found: the same difference here.
        claim: the paper's.
        margin: how large a difference retraining may make by itself, None where that is not known.
    """
    margin = margin or 0.0
    if found.low > 0 and found.difference > margin:
        return "reproduced"
    if found.high < 0 and found.difference < -margin:
        return f"not reproduced, difference {points(found)}"
    most = max(found.high, found.difference + margin)
    return "undecided, but smaller than the paper's" if most < claim else "undecided"
