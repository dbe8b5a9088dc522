"""The section of the results page on the paper's experiment: its Tables I to III with our rates beside them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from statistics import stdev

from ..cascade import FACTORIZATIONS, Stage
from ..evaluation import HEURISTIC
from ..evaluation.record import Evaluation, Tally
from ..intervals import Difference
from ..trials import VERDICTS
from .gallery import POSE_FRAMES, TRAINING_CURVES, Gallery, pooled_heat_map_name
from .markdown import MISSING, over, pair, percent, plain, points, rate, table, widest
from .paper_runs import PaperRuns, Runs, metadata_differences, retraining_margin, settings
from .published import (
    FULL_MODEL,
    MAIN_MODELS,
    ORDERINGS,
    SUCCESS_PERCENT,
    TABLES,
    Ordering,
    PaperTable,
)

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


def paper_section(found: PaperRuns, gallery: Gallery) -> str:
    """Word the section; what was not run yet is said to be so, or left out."""
    blocks = ["## The paper's experiment", _opening(found)]
    blocks += [_table_section(paper, found.runs) for paper in TABLES]
    blocks += _orderings_section(found.runs)
    if found.notes:
        blocks += ["### What the orderings show", found.notes]
    if found.runs:
        blocks += [*_seed_section(found.runs), *_breakdown_section(found.runs, gallery), *_settings_section(found)]
    if found.training:
        blocks += _curve_section(found, gallery)
    if found.experiments:
        blocks += _experiment_section(found)
    blocks += gallery.show(
        POSE_FRAMES,
        "Where the hand goes about the medium box, one panel a grasp type: sampled from a trained cascade, where the "
        "paper's figure 5 shows collected grasps",
    )
    return "\n\n".join(blocks)


def _opening(found: PaperRuns) -> str:
    text = (
        "Gc is the posture, Gpos the object's position, Grot its rotation, Gt and Gs the type and size of the grasp, "
        "Ot and Os those of the object. Networks that are given Gc see the two opposing contact places that it implies "
        "beside the joint angles; those given Os see the side and its axis beside the object's size. The posture "
        "network is not given Os, as the paper's section IV and Table III have it; the formulas beside its Table I "
        "give it Os. The paper's rates are of 27,000 grasps each, executed in another simulator. Trials of all "
        "training seeds of a model count together: intervals speak of trials, the spread over seeds speaks of "
        "retraining."
    )
    if not found.runs:
        return text
    one = next(iter(found.runs.values())).pooled
    return f"Protocol `{one.protocol.name}`, hand `{one.hand}`, {len(one.cells)} cells of object and type.\n\n{text}"


def _table_section(paper: PaperTable, runs: Mapping[str, Runs]) -> str:
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
        total = runs[row.model].pooled.total
        full = None if row.model == FULL_MODEL or FULL_MODEL not in runs else runs[FULL_MODEL].pooled.total
        rows.append(
            [
                *about,
                rate(total.held_rate),
                rate(total.faithful_rate),
                str(total.n),
                *((MISSING, MISSING) if full is None else over(total, full)),
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


def _orderings_section(runs: Mapping[str, Runs]) -> list[str]:
    header = (
        "table", "the paper's ordering", "verdict", "paper, points", "held, points", "faithful, points",
        "retraining, points",
    )  # fmt: skip
    rows, verdicts = [], Counter[str]()
    for ordering in ORDERINGS:
        claim = SUCCESS_PERCENT[ordering.better] - SUCCESS_PERCENT[ordering.worse]
        word, *numbers = _compare(ordering, claim / 100, runs)
        verdicts[word.split(",")[0]] += 1
        name = f"`{ordering.better}` > `{ordering.worse}`"
        rows.append([ordering.table, name, word, f"{claim:+.2f}", *numbers])
    text = (
        "Reproduced: the difference of held rates is above zero with its whole interval, and larger than what "
        "retraining the same models with other seeds may do by itself. Not reproduced: the same below zero. "
        "Undecided: neither. Retraining: 95 % of differences between equal models would stay within so many points, "
        "by the spread over the seeds of the models that have several, Student's t; each seed has trials of its own, "
        "so that their chance is in it. Where no spread is known, trials alone decide. Each ordering is judged by "
        f"itself, at 95 %: one may come out wrong by chance. Of {len(ORDERINGS)} orderings: "
        + ", ".join(f"{count} {word}" for word, count in verdicts.most_common())
        + "."
    )
    return ["### The paper's orderings", text, table(header, rows, text_columns=3)]


def _compare(ordering: Ordering, claim: float, runs: Mapping[str, Runs]) -> tuple[str, str, str, str]:
    if not {ordering.better, ordering.worse} <= runs.keys():
        return NOT_RUN, MISSING, MISSING, MISSING
    better, worse = runs[ordering.better], runs[ordering.worse]
    one, other = better.pooled.total, worse.pooled.total
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


def _seed_section(runs: Mapping[str, Runs]) -> list[str]:
    several = [found for found in runs.values() if len(found.by_seed) > 1]
    if not several:
        return []
    rows = []
    for found in several:
        for seed, one in found.by_seed.items():
            rows.append([f"`{found.model}`", plain(seed), *_rates(one)])
        rows.append([f"`{found.model}`", "all", *_rates(found.pooled)])
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


def _rates(found: Evaluation) -> tuple[str, str, str]:
    return str(found.n), rate(found.held), rate(found.faithful)


def _range(rates: Sequence[float]) -> tuple[str, str]:
    return f"{percent(min(rates))} to {percent(max(rates))}", f"{100 * stdev(rates):.2f}"


def _breakdown_section(runs: Mapping[str, Runs], gallery: Gallery) -> list[str]:
    blocks = ["### Success by object and by grasp type", "Held % / faithful % of each model."]
    for tallies in (_by_object, _by_type):
        found = {name: tallies(run.pooled) for name, run in runs.items()}
        columns = next(iter(found.values()))
        rows = [[f"`{name}`", *(pair(split[column]) for column in columns)] for name, split in found.items()]
        reach = widest(tally for split in found.values() for tally in split.values())
        blocks += [
            table(("model", *columns), rows),
            f"The widest of these 95 % intervals reaches {reach} points to either side of its middle.",
        ]
    for name in MAIN_MODELS:
        if name in runs:
            caption = f"Success of {runs[name].title} on every object with every grasp type"
            blocks += gallery.show(pooled_heat_map_name(name), caption)
    verdicts = [
        [f"`{name}`", *(percent(count / run.pooled.n) for count in run.pooled.total.verdicts.values())]
        for name, run in runs.items()
    ]
    blocks += ["### How trials ended", table(("model", *(f"{name} %" for name in VERDICTS)), verdicts)]
    return blocks


def _by_object(found: Evaluation) -> Mapping[str, Tally]:
    return found.by_object


def _by_type(found: Evaluation) -> Mapping[str, Tally]:
    return found.by_type


def _settings_section(found: PaperRuns) -> list[str]:
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


def _curve_section(found: PaperRuns, gallery: Gallery) -> list[str]:
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
                    f"{values.train_kl[-1]:.4g}",
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
        "quantity. A grasp of a rare object and type that is repeated in training may be among the held-out rows too.",
        table(header, rows, text_columns=2),
        *gallery.show(TRAINING_CURVES, "Loss on held-out rows (solid) and on the training rows (dotted) by epoch"),
    ]


def _experiment_section(found: PaperRuns) -> list[str]:
    rows = []
    for label, one in found.experiments.items():
        base = found.base_of(one)
        rows.append(
            [
                label,
                MISSING if base is None else f"`{base.model}`",
                MISSING if base is None else metadata_differences(one, base) or MISSING,
                f"`{one.protocol.name}`",
                *_rates(one),
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
