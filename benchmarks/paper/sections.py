"""Sections of the results that the page only names: each is printed by ``report --section NAME``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from statistics import stdev
from typing import Any

from graspcascade.core.outcomes import VERDICTS
from graspcascade.proposals.heuristic import HEURISTIC
from graspcascade.studies.record import Evaluation, Tally

from . import tables
from .markdown import MISSING, measurement, over, pair, pair_rows, percent, plain, rate, rates, spread, table, widest
from .published import FULL_MODEL
from .runs import Entry, PaperRuns, ResultsFolder, Runs, metadata_differences, protocol_numbers, settings

_ROUNDING_NATS = 1e-6

Writer = Callable[[], str]


def sections(results: ResultsFolder) -> dict[str, tuple[str, Writer]]:
    """List what a folder of results has to say beside its page: by name, one line about it and what writes it."""
    listed: dict[str, tuple[str, Writer]] = {}
    paper = results.paper
    if paper is not None and paper.runs:
        runs = paper.runs
        listed |= {
            "orderings": ("the paper's comparisons one by one, and how they are judged", partial(_orderings, runs)),
            "breakdown": ("every model's rates by object and by grasp type", partial(_breakdown, runs)),
            "seeds": ("every training seed's rates and their spread", partial(_seeds, runs)),
            "settings": ("with which settings and versions the models were trained", partial(_settings, paper)),
        }
    if paper is not None and paper.training:
        listed["training"] = ("where each stage's training ended", partial(_training, paper))
    if paper is not None and paper.experiments:
        listed["experiments"] = (
            "other sizes, narrower networks, plainer training, a screened heuristic",
            partial(_experiments, paper),
        )
    if results.other:
        listed["conditions"] = (
            "other friction, density, finger strength, time step and open hand",
            partial(_conditions, results),
        )
    listed |= {
        "verdicts": ("how trials ended, for every evaluation", partial(_verdicts, results)),
        "cells": ("each model's rates and counts by type, by object and by both", partial(_cells, results.same)),
        "protocol": ("every number of the protocol", partial(_protocol, results.base)),
    }
    prior = results.base.evaluation.model_metadata.get("prior")
    for stem, data in results.measurements.items():
        about = str(data.get("title", stem))
        listed[stem] = (about[:1].lower() + about[1:], partial(measurement, stem, data, prior))
    return listed


def _join(*blocks: str) -> str:
    return "\n\n".join(blocks)


def _orderings(runs: Mapping[str, Runs]) -> str:
    return tables.orderings(runs)


def _protocol(base: Entry) -> str:
    protocol = base.evaluation.protocol
    rows = [(name, plain(value)) for name, value in protocol_numbers(protocol).items()]
    hand = f"Hand `{base.evaluation.hand}`."
    return _join(f"## Protocol `{protocol.name}`", hand, table(("parameter", "value"), rows))


def _breakdown(runs: Mapping[str, Runs]) -> str:
    blocks = ["## Rates by object and by grasp type", "Held % / faithful % of each model."]
    by_object = {name: run.pooled.by_object for name, run in runs.items()}
    by_type = {name: run.pooled.by_type for name, run in runs.items()}
    for split in (by_object, by_type):
        columns = next(iter(split.values()))
        rows = [[f"`{name}`", *(pair(tallies[column]) for column in columns)] for name, tallies in split.items()]
        reach = widest(tally for tallies in split.values() for tally in tallies.values())
        note = f"The widest of these 95 % intervals reaches {reach} points to either side of its middle."
        blocks += [table(("model", *columns), rows), note]
    return _join(*blocks)


def _seeds(runs: Mapping[str, Runs]) -> str:
    several = [run for run in runs.values() if len(run.by_seed) > 1]
    rows, spreads = [], []
    for run in several:
        rows += [[f"`{run.model}`", plain(seed), *rates(one)] for seed, one in run.by_seed.items()]
        rows.append([f"`{run.model}`", "all", *rates(run.pooled)])
        every = list(run.by_seed.values())
        held, faithful = _range([one.held.rate for one in every]), _range([one.faithful.rate for one in every])
        spreads.append([f"`{run.model}`", str(len(every)), *held, *faithful])
    header = (
        "model", "training seeds", "held, lowest to highest %", "standard deviation, points",
        "faithful, lowest to highest %", "standard deviation, points",
    )  # fmt: skip
    return _join(
        "## Training seeds",
        table(("model", "training seed", "trials", "held", "faithful"), rows, text_columns=2),
        "Spread over the seeds:",
        table(header, spreads),
    )


def _range(shares: Sequence[float]) -> tuple[str, str]:
    return f"{percent(min(shares))} to {percent(max(shares))}", f"{100 * stdev(shares):.2f}"


def _settings(paper: PaperRuns) -> str:
    every = [one for run in paper.runs.values() for one in run.by_seed.values()]
    versions = sorted({f"seed {one.seed}, {_versions(one)}" for one in every})
    blocks = ["## Settings", f"Evaluated with {'; '.join(versions)}."]
    if FULL_MODEL not in paper.runs:
        return _join(*blocks)
    seed, full = next(iter(paper.runs[FULL_MODEL].by_seed.items()))
    if full.model_metadata:
        facts = [(key, plain(value)) for key, value in settings(full)]
        blocks += [f"`{FULL_MODEL}`, training seed {plain(seed)}:", table(("setting", "value"), facts, text_columns=2)]
    differing = [
        [f"`{name}`", plain(seed), difference]
        for name, run in paper.runs.items()
        if name != HEURISTIC
        for seed, one in run.by_seed.items()
        if (difference := metadata_differences(one, full))
    ]
    if not differing:
        return _join(*blocks, "The other models were trained on the same data with the same settings.")
    text = "Not trained on the same data with the same settings:"
    return _join(*blocks, text, table(("model", "training seed", "what differs"), differing, text_columns=3))


def _versions(evaluation: Evaluation) -> str:
    return ", ".join(f"{name} {version}" for name, version in evaluation.versions.items())


def _training(paper: PaperRuns) -> str:
    rows = []
    for curves in paper.training:
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
    text = (
        "The last epoch of every stage (the curves are in `figures/training_curves.png`); losses of different stages, "
        "or of different outputs, are on different scales. The divergence's weight rises over the beginning of a run, "
        "so that losses of its first epochs are another quantity. A network with a divergence of 0 leaves its latents "
        "unused and draws nothing: its outputs follow from what it is given, as the heuristic's position follows from "
        "the posture. A grasp of a rare object and type that is repeated in training may be among the held-out rows "
        "too."
    )
    return _join("## Training", text, table(header, rows, text_columns=2))


def _divergence(nats: float) -> str:
    # That of unused latents is 0 but for rounding, of either sign.
    return "0" if abs(nats) < _ROUNDING_NATS else f"{nats:.4g}"


def _experiments(paper: PaperRuns) -> str:
    rows = []
    for label, one in paper.experiments.items():
        base = paper.base_of(one)
        made_of = (MISSING, MISSING)
        if base is not None:
            made_of = (f"`{base.model}`", metadata_differences(one, base) or MISSING)
        compared = over(one.total, base.total) if base is not None and paper.comparable(one) else (MISSING, MISSING)
        rows.append([label, *made_of, f"`{one.protocol.name}`", *rates(one), *compared])
    header = (
        "experiment", "made of", "settings that differ", "protocol", "trials", "held", "faithful",
        "held, points over it", "faithful, points over it",
    )  # fmt: skip
    text = (
        "Models with other settings, each compared with the model it is made of, of the same training seed, where hand,"
        " cells and protocol are the same. One training each: what retraining does by itself is in section `seeds`."
    )
    return _join("## Experiments", text, table(header, rows, text_columns=4), *_paired_experiments(paper))


def _paired_experiments(paper: PaperRuns) -> Iterable[str]:
    rows = []
    for setting, models in paper.by_setting.items():
        full = models[FULL_MODEL].total
        for name, one in models.items():
            if name != FULL_MODEL:
                held = (f"{rate(tally.held_rate)} of {tally.n}" for tally in (full, one.total))
                rows.append([setting, f"`{name}`", *held, *over(full, one.total)])
    if not rows:
        return
    header = (
        "setting", "compared with", f"`{FULL_MODEL}`, held", "the other, held",
        f"`{FULL_MODEL}` above it, held, points", "faithful, points",
    )  # fmt: skip
    yield (
        f"What the division into stages brings under a setting, which both models share: `{FULL_MODEL}` beside others "
        "of the same training seed."
    )
    yield table(header, rows, text_columns=2)


def _verdicts(results: ResultsFolder) -> str:
    evaluations = [(entry.label, entry.evaluation) for entry in results.entries]
    if results.paper is not None:
        own = [(entry.label, entry.evaluation) for entry in results.entries if entry.has_own_file]
        evaluations = [(run.title, run.pooled) for run in results.paper.runs.values()] + own
    rows = []
    for label, one in evaluations:
        shares = (percent(count / one.n) for count in one.total.verdicts.values())
        rows.append([label, f"`{one.protocol.name}`", str(one.n), *shares])
    header = ("model", "protocol", "trials", *(f"{verdict} %" for verdict in VERDICTS))
    text = "Share of trials that ended in each verdict; what the verdicts mean is on the page of the protocol."
    return _join("## How trials ended", text, table(header, rows, text_columns=2))


def _conditions(results: ResultsFolder) -> str:
    base = results.base
    name = base.evaluation.protocol.name
    header = (
        "model", "protocol", "what differs", "trials", "held", "faithful", f"held, points over `{name}`",
        f"faithful, points over `{name}`",
    )  # fmt: skip
    rows = []
    for entry in results.other:
        usual = _usual(entry, results)
        differing = [
            f"{key} {_condition(value)} (`{name}`: {_condition(there)})"
            for key, value, there in _differing(entry, base)
        ]
        rows.append(
            [
                entry.label,
                f"`{entry.evaluation.protocol.name}`",
                "; ".join(differing) or "the name alone",
                *rates(entry.evaluation),
                *((MISSING, MISSING) if usual is None or usual is entry else over(entry.total, usual.total)),
            ]
        )
    text = (
        f"Differences are to the same model under protocol `{name}` with hand `{base.evaluation.hand}`: to the row in "
        "which nothing but the name differs, where there is one of as many trials from the same seed. These are the "
        "same grasps, so that the intervals, which take them as independent, are rather too wide."
    )
    return _join("## Other conditions", text, table(header, rows, text_columns=3))


def _differing(entry: Entry, base: Entry) -> list[tuple[str, Any, Any]]:
    """List the conditions that differ: names, values, and what they are on the page."""
    usual = base.conditions
    return [
        (key, value, usual[key]) for key, value in entry.conditions.items() if key != "name" and value != usual[key]
    ]


def _usual(entry: Entry, results: ResultsFolder) -> Entry | None:
    """Find what an evaluation under other conditions is compared with; see `_conditions`."""

    def like(other: Entry) -> bool:
        return _same_model(other.evaluation, entry.evaluation)

    alike = (other for other in results.other if like(other) and not _differing(other, results.base))
    same_grasps = (other for other in alike if (other.seeds, other.total.n) == (entry.seeds, entry.total.n))
    return next(same_grasps, None) or next(filter(like, results.same), None)


def _same_model(one: Evaluation, other: Evaluation) -> bool:
    """Tell whether two evaluations are of one model, as far as both say of it."""
    ours, theirs = one.model_metadata, other.model_metadata
    return one.model == other.model and all(ours[key] == theirs[key] for key in ours.keys() & theirs.keys())


def _condition(value: Any) -> str:
    return f"{len(value)} of object and type" if isinstance(value, list) else plain(value)


def _cells(entries: Sequence[Entry]) -> str:
    return _join(*map(_model_cells, entries))


def _model_cells(entry: Entry) -> str:
    one = entry.evaluation
    source = f"File `{entry.stem}.json`" if entry.has_own_file else f"Folder `{entry.stem.partition('/')[0]}`"
    facts = [
        f"{source}, protocol `{one.protocol.name}`, hand `{one.hand}`, {one.n} trials, {one.per_cell} per cell, seed "
        f"{', '.join(map(str, entry.seeds))}; {_versions(one)}."
    ]
    # What is recorded of the paper's models stands in a section of its own.
    if entry.has_own_file and one.model_metadata:
        facts.append("; ".join(f"{key}: {plain(value)}" for key, value in spread(one.model_metadata)) + ".")
    return _join(
        f"## {entry.label}",
        *facts,
        _counted("grasp type", {**one.by_type, "all": one.total}),
        _counted("object", {**one.by_object, "all": one.total}),
        f"Held % / faithful % of each object and type under protocol `{one.protocol.name}`, {one.per_cell} trials "
        f"each; the widest of these 95 % intervals reaches {widest(one.cells)} points to either side of its middle:",
        table(("object", *one.by_type), pair_rows(one)),
    )


def _counted(kind: str, tallies: Mapping[str, Tally]) -> str:
    rows = [
        (
            name,
            str(tally.n),
            str(tally.held),
            rate(tally.held_rate),
            str(tally.faithful),
            rate(tally.faithful_rate),
            rate(tally.faithful_of_held),
        )
        for name, tally in tallies.items()
    ]
    return table((kind, "trials", "held", "held rate", "faithful", "faithful rate", "faithful of the held"), rows)
