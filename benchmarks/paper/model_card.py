"""The model card of a shipped cascade: what it learned from, how it was tested, and where it fails."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from graspcascade.core.files import write_text
from graspcascade.proposals.cascade.sampler import DEFAULT, EVALUATION_FILE, GraspSampler, shipped_folder
from graspcascade.studies.record import Evaluation, Tally

from .markdown import fill_blocks, pair, pair_rows, percent, plain, rate, spread, table, widest

_WEAK = 0.9
"""Cells that hold less often are listed as weak."""
_TOLD = ("learn_from", "object_pose", "training")
"""Settings that have a line of their own."""
_LOOP = {"epochs": "epochs at most", "max_steps": "steps at most"}
"""Settings of the loop that say more by another name: whichever ends first ends a training."""


def fill_model_card(page: Path) -> None:
    """Write the generated blocks of the model card of the default cascade again.

    Args:
        page: Markdown file with blocks "summary", "facts", "rates" and "limits", changed in place.

    Raises:
        InputError: a block of another name.
        FileFormatError: the cascade is shipped without its evaluation.
    """
    folder = shipped_folder()
    sampler, rates = GraspSampler.load(folder), Evaluation.load(folder / EVALUATION_FILE)
    write_text(page, fill_blocks(page.read_text(encoding="utf-8"), card_blocks(sampler, rates)))


def card_blocks(sampler: GraspSampler, rates: Evaluation) -> dict[str, Callable[[], str]]:
    """Name what writes each block of a card."""
    return {
        "summary": lambda: _summary(rates),
        "facts": lambda: _facts(sampler),
        "rates": lambda: _rates(rates),
        "limits": lambda: _limits(rates),
    }


def _facts(sampler: GraspSampler) -> str:
    stages = "; ".join(
        f"{stage.name} ({', '.join(stage.targets)} given {', '.join(stage.given)}; {stage.latent_dim} latents, "
        f"hidden layers of {' and '.join(map(str, stage.hidden))}, divergence weight {plain(stage.kl_weight)})"
        for stage in sampler.factorization.stages
    )
    about = sampler.metadata
    data, config = about["dataset"], about["config"]
    # The metric's weight follows from the fingertip error, in the stage that makes the posture.
    loop = {_LOOP.get(name, name): value for name, value in config["training"].items() if name != "metric_weight"}
    rows = [
        ("name", f"`{DEFAULT}`, weights {sampler.fingerprint()}"),
        ("factorization", f"`{sampler.factorization.name}`: {sampler.factorization.source}"),
        ("hand", f"`{sampler.hand.name}`"),
        ("stages", stages),
        ("learned from", f"{about['learned_from']} {config['learn_from']} grasps, objects as {config['object_pose']}"),
        ("data", _words(data)),
        ("training", _words({name: value for name, value in config.items() if name not in _TOLD})),
        ("training loop", _words(loop)),
        ("sizes asked for", f"`{sampler.size_mode}`"),
        ("made with", _words(about["versions"])),
    ]
    return table(("fact", "value"), rows, text_columns=2)


def _words(facts: Mapping[str, Any]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {plain(value)}" for name, value in spread(facts))


def _summary(rates: Evaluation) -> str:
    weak = min(rates.cells, key=lambda cell: cell.held_rate.rate)
    return (
        f"**{rate(rates.held)} of {rates.n} grasps were held, {rate(rates.faithful)} also as the type asks.** It is "
        f"weakest at {weak.grasp_type} on {weak.object_label} ({weak.held} of {weak.n} held); all weak pairs are in "
        "[the limits](#limits)."
    )


def _rates(rates: Evaluation) -> str:
    total = rates.total
    rows = [[*row, pair(tally)] for row, tally in zip(pair_rows(rates), rates.by_object.values(), strict=True)]
    rows.append(["all objects", *map(pair, rates.by_type.values()), pair(total)])
    return "\n\n".join(
        [
            f"Protocol `{rates.protocol.name}`, {rates.n} trials, {rates.per_cell} for each object and type, seed "
            f"{rates.seed}: **held {rate(total.held_rate)}, held and type-faithful {rate(total.faithful_rate)}**. "
            "Held % / faithful % of each object and type; the widest of these 95 % intervals reaches "
            f"{widest(rates.cells)} points to either side of its middle:",
            table(("object", *rates.by_type, "all types"), rows),
        ]
    )


def _limits(rates: Evaluation) -> str:
    weak = sorted((cell for cell in rates.cells if cell.held_rate.rate < _WEAK), key=lambda cell: cell.held / cell.n)
    if not weak:
        return f"No object and type holds in less than {percent(_WEAK)} % of its trials."
    header = ("object", "type", "held", "faithful", "lost to")
    rows = [
        [cell.object_label, cell.grasp_type, rate(cell.held_rate), rate(cell.faithful_rate), _lost(cell)]
        for cell in weak
    ]
    text = f"Objects and types that hold in less than {percent(_WEAK)} % of their trials, and how these trials ended:"
    return f"{text}\n\n{table(header, rows, text_columns=2)}"


def _lost(tally: Tally) -> str:
    """Name the ways in which trials failed, the commonest first."""
    failed = sorted(
        ((count, verdict) for verdict, count in tally.verdicts.items() if count and verdict != "held"), reverse=True
    )
    return ", ".join(f"{verdict} {percent(count / tally.n)} %" for count, verdict in failed)
