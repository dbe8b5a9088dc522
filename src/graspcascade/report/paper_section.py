"""The section of the results page on the paper's experiment: tables, orderings, training, experiments."""

from __future__ import annotations

from collections.abc import Mapping

from ..evaluation.record import Evaluation, Tally
from ..trials import VERDICTS
from .gallery import POSE_FRAMES, Gallery, pooled_heat_map_name
from .markdown import pair, percent, table, widest
from .paper_experiments import experiment_section
from .paper_runs import PaperRuns, Runs
from .paper_tables import orderings_section, table_section
from .paper_training import curve_section, seed_section, settings_section
from .published import MAIN_MODELS, TABLES


def paper_section(found: PaperRuns, gallery: Gallery) -> str:
    """Word the section; what was not run yet is said to be so, or left out."""
    blocks = ["## The paper's experiment", _opening(found)]
    blocks += [table_section(paper, found.runs) for paper in TABLES]
    blocks += orderings_section(found.runs)
    if found.notes:
        blocks += ["### What the orderings show", found.notes]
    if found.runs:
        blocks += [*seed_section(found.runs), *_breakdown_section(found.runs, gallery), *settings_section(found)]
    if found.training:
        blocks += curve_section(found, gallery)
    if found.experiments:
        blocks += experiment_section(found)
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
        "training seeds of a model count together, and differences are over the seeds that both models have. Intervals "
        "speak of trials, the spread over seeds speaks of retraining."
    )
    if not found.runs:
        return text
    one = next(iter(found.runs.values())).pooled
    return f"Protocol `{one.protocol.name}`, hand `{one.hand}`, {len(one.cells)} cells of object and type.\n\n{text}"


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
