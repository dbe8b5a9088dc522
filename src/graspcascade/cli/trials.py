"""``graspcascade trial``, ``verify`` and ``evaluate``: grasps executed in physics."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray
from tyro.conf import Positional, arg

from ..core.errors import MAX_SEED, InputError, check_whole
from ..core.files import write_json
from ..core.grasps import Grasps
from ..core.intervals import wilson
from ..core.outcomes import STEADY_RAD, VERDICTS, Outcomes
from ..core.protocols import Protocol, as_protocol
from ..engines import as_engine
from ..formats import GraspDocument, check_target, load_executable, save_grasps
from ..hands import Hand, executing_hand, load_hand
from ..proposals import Proposal
from . import console
from .console import (
    EngineName,
    HandName,
    Json,
    ModelName,
    OwnHand,
    PriorFile,
    ProtocolName,
    Raw,
    Threads,
    Trust,
    Workers,
)

if TYPE_CHECKING:
    from ..studies.sweep import Sweep


@dataclass(frozen=True)
class Trial:
    """Execute every grasp of a file in physics and print what became of it."""

    grasps: Annotated[Positional[Path], arg(metavar="GRASPS")]
    """Grasp file in any format that can be read, such as .json or .parquet."""
    trust_pickle: Trust = False
    hand: HandName = "shadow"
    protocol: ProtocolName = "paper"
    engine: EngineName = "mujoco"
    seed: int = 0
    """Seed of what a protocol draws for each trial."""
    out: Path | None = None
    """Also write the report to this .json file."""
    held_out: Path | None = None
    """Also write the grasps that held to this file (.json, .parquet)."""
    threads: Threads = 0
    json: Json = False

    def run(self) -> None:
        """Execute, then print and write."""
        console.check_threads(threads=self.threads)
        protocol, engine = as_protocol(self.protocol), as_engine(self.engine, n_threads=self.threads)
        if self.out is not None:
            console.check_out(self.out, ".json", "a trial report")
        if self.held_out is not None:
            check_target(self.held_out)
        _check_apart(self.grasps, self.out, self.held_out)
        hand = load_hand(self.hand)
        document = _executable(self.grasps, hand, self.trust_pickle, "trial")
        grasps = document.grasps
        check_whole("seed", self.seed, most=MAX_SEED)
        conditions = protocol.conditions(len(grasps), self.seed)
        with console.bar("trials", len(grasps)) as progress:
            outcomes = engine.run(hand, grasps, protocol, conditions, progress=progress.advance)
        tried = {"protocol": protocol.name, "engine": engine.name, "model": document.metadata.get("model")}
        report = console.plain(tried | _report(grasps, outcomes))
        if self.out is not None:
            write_json(self.out, report, allow_nan=False)
        console.print_json(report) if self.json else _print_report(report)
        if self.held_out is not None:
            about = {"protocol": protocol.name, "engine": engine.name, "seed": self.seed, "of": len(grasps)}
            metadata = document.metadata | {"held": about}
            _keep(self.held_out, document, outcomes.held, grasps, metadata, "trial")


def _check_apart(grasps: Path, *written: Path | None) -> None:
    """Refuse to write over the grasps that are read, or twice to one file."""
    targets = [path.resolve() for path in written if path is not None]
    for number, path in enumerate(targets):
        if path in (grasps.resolve(), *targets[:number]):
            holds = "holds the grasps" if path == grasps.resolve() else "would be written twice"
            raise InputError(f"{path.name} {holds}; give what is written another name")


def _executable(path: Path, hand: Hand, trust_pickle: bool, verb: str) -> GraspDocument:
    console.check_exists(path)
    document = load_executable(path, hand, trust_pickle=trust_pickle)
    console.say(verb, *document.notes)
    return document


def _keep(
    path: Path, document: GraspDocument, kept: NDArray[np.bool_], grasps: Grasps, metadata: dict[str, Any], verb: str
) -> None:
    """Write the grasps that are kept, or say that there are none."""
    if not kept.any():
        console.say(verb, f"no grasp is kept, {path} is not written")
        return
    save_grasps(path, grasps[kept], metadata=metadata, X_world_object=document.X_world_object)
    print(f"wrote {int(kept.sum())} of {len(grasps)} grasps to {path}", file=sys.stderr)


@dataclass(frozen=True)
class Verify:
    """Try each grasp of a file under several draws of friction, weight and errors; print the share that held.

    With --out the grasps are written with that share as their probability.
    """

    grasps: Annotated[Positional[Path], arg(metavar="GRASPS")]
    """Grasp file in any format that can be read, such as .json or .parquet."""
    trust_pickle: Trust = False
    draws: int = 8
    """Trials of each grasp."""
    keep: float | None = None
    """With --out, write only grasps of which at least this share held, from 0 to 1."""
    hand: HandName = "shadow"
    protocol: ProtocolName = "varied"
    engine: EngineName = "mujoco"
    seed: int = 0
    """Seed of the draws."""
    out: Path | None = None
    """File to write (.json, .parquet)."""
    threads: Threads = 0
    workers: Workers = 1
    json: Json = False

    def run(self) -> None:
        """Verify, then print and write."""
        from ..studies.verify import verify

        console.check_threads(threads=self.threads, workers=self.workers)
        if self.keep is not None and not (0.0 <= self.keep <= 1.0 and self.out is not None):
            raise InputError(f"--keep is a share from 0 to 1 and needs --out, got {self.keep}")
        if self.out is not None:
            check_target(self.out)
        _check_apart(self.grasps, self.out)
        hand, engine = load_hand(self.hand), as_engine(self.engine, n_threads=self.threads)
        document = _executable(self.grasps, hand, self.trust_pickle, "verify")
        n = len(document.grasps)
        with console.bar("trials", n * self.draws) as progress:
            verified = verify(
                document.grasps,
                draws=self.draws,
                seed=self.seed,
                protocol=self.protocol,
                hand=hand,
                engine=engine,
                workers=self.workers,
                progress=progress.advance,
            )
        about: dict[str, Any] = {"protocol": verified.protocol, "engine": verified.engine}
        about |= {"draws": self.draws, "seed": self.seed}
        grasps, tried = verified.grasps, {name: getattr(verified, name) for name in ("held", "faithful", "steady")}
        # The draws of one grasp are not independent, so that a rate counts grasps.
        rates = {name: wilson(float(flags.mean(axis=1).sum()), n).to_json() for name, flags in tried.items()}
        if self.json:
            columns = {"grasp_type": grasps.grasp_type, "object": grasps.object_name}
            columns |= {name: flags.sum(axis=1) for name, flags in tried.items()}
            rows = zip(*(column.tolist() for column in columns.values()), strict=True)
            named = [dict(zip(columns, row, strict=True)) for row in rows]
            console.print_json({**about, "n": n, **rates, "grasps": named})
        else:
            self._print(grasps, verified.held.sum(axis=1).tolist())
            print(f"protocol {verified.protocol}, engine {verified.engine}, {n} grasps tried {self.draws} times each")
            for name, rate in rates.items():
                print(f"{name} {console.interval(rate)}")
        if self.out is not None:
            kept = np.full(n, True) if self.keep is None else grasps.probability >= self.keep
            about |= {} if self.keep is None else {"kept_from": self.keep, "of": n}
            _keep(self.out, document, kept, grasps, document.metadata | {"verified": about}, "verify")

    def _print(self, grasps: Grasps, held: list[int]) -> None:
        rows = []
        names = zip(grasps.grasp_type.tolist(), grasps.object_name.tolist(), grasps.side_axis.tolist(), strict=True)
        for number, (named, count) in enumerate(zip(names, held, strict=True)):
            share = wilson(count, self.draws)
            rows.append([str(number), *named, str(count), f"{share.rate:.0%} [{share.low:.0%}, {share.high:.0%}]"])
        console.print_table(["#", "type", "object", "side", "held", "chance"], rows, left=(0, 1, 2, 3))


def _report(grasps: Grasps, outcomes: Outcomes) -> dict[str, Any]:
    held, faithful, places = outcomes.held, outcomes.faithful(grasps), np.array(outcomes.touch_columns)
    columns: dict[str, Any] = {"grasp_type": grasps.grasp_type, "object": grasps.object_name}
    columns |= {"side_axis": grasps.side_axis, "verdict": outcomes.verdict, "held": held, "faithful": faithful}
    columns["steady"] = outcomes.steady
    for name in ("touching_closed", "touching_end", "object_size_m", "displacement_m", "turn_rad", "duration_s"):
        columns[name] = getattr(outcomes, name)
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*(c.tolist() for c in columns.values()), strict=True)]
    for row in rows:
        row |= {name: places[row[name]].tolist() for name in ("touching_closed", "touching_end")}
    report: dict[str, Any] = {"n": len(grasps)}
    report |= {name: wilson(int(columns[name].sum()), len(grasps)).to_json() for name in ("held", "faithful", "steady")}
    verdicts = {verdict: int((outcomes.verdict == verdict).sum()) for verdict in VERDICTS}
    return report | {"verdicts": verdicts, "grasps": rows}


def _print_report(report: dict[str, Any]) -> None:
    rows = []
    for number, row in enumerate(report["grasps"]):
        verdict = row["verdict"] + (", faithful" if row["faithful"] else "")
        moved = "-" if row["displacement_m"] is None else f"{row['displacement_m'] * 1000:.1f}"
        touching = ", ".join(row["touching_end"] or row["touching_closed"]) or "-"
        turned = "-" if row["turn_rad"] is None else f"{math.degrees(row['turn_rad']):.0f}"
        rows.append([str(number), row["grasp_type"], row["object"], row["side_axis"], verdict, moved, turned, touching])
    titles = ["#", "type", "object", "side", "verdict", "moved\nmm", "turned\ndeg", "touching"]
    console.print_table(titles, rows, left=(0, 1, 2, 3, 4, 7))
    _print_rates(report)


def _print_rates(report: dict[str, Any]) -> None:
    verdicts = report["verdicts"].get("overall", report["verdicts"])
    print(", ".join(f"{count} {verdict}" for verdict, count in verdicts.items() if count))
    tried_in = f"protocol {report['protocol']}, engine {report['engine']}"
    print(f"{tried_in}, {report['n']} trials: held {console.interval(report['held'])}")
    print(f"held and type-faithful {console.interval(report['faithful'])}")
    if "steady" in report:
        print(f"held and turned by less than {math.degrees(STEADY_RAD):g} degrees {console.interval(report['steady'])}")


@dataclass(frozen=True)
class Evaluate:
    """Execute grasps of a model, or of the heuristic, for every object and type and print the rates."""

    model: ModelName = "default"
    per_cell: int = 500
    """Trials for each object and grasp type."""
    objects: console.Objects = ()
    protocol: ProtocolName = "paper"
    engine: EngineName = "mujoco"
    raw: Raw = False
    hand: OwnHand = None
    prior: PriorFile = None
    seed: int = 0
    """Seed of every draw."""
    out: Path | None = None
    """Folder for finished rounds and evaluation.json; the same command goes on where an earlier one stopped."""
    sweep: tuple[str, ...] | None = None
    """Try the same grasps at several values of a condition, like friction=0.4:1.2 or mass=0.5,1,2; each of several in
    turn. With --out, sweep.json and sweep.png show the values of this call."""
    threads: Threads = 0
    workers: Workers = 1
    json: Json = False

    def run(self) -> None:
        """Evaluate, then print."""
        from ..studies.evaluate import evaluate
        from ..studies.sweep import Sweep

        sweeps = [Sweep.read(text) for text in self.sweep or ()]
        if self.sweep is not None and not sweeps:
            raise InputError("--sweep needs a condition, like friction=0.4:1.2")
        console.check_threads(threads=self.threads, workers=self.workers)
        protocol, engine = as_protocol(self.protocol), as_engine(self.engine, n_threads=self.threads)
        proposal = console.load_proposal(self.model, self.hand, self.prior, raw=self.raw)
        hand = executing_hand(proposal.hand, self.hand)
        cells = console.possible_cells(proposal, hand, "evaluate", self.objects)
        asked: dict[str, Any] = {"per_cell": self.per_cell, "seed": self.seed, "protocol": protocol, "hand": hand}
        asked |= {"engine": engine, "workers": self.workers, "out": self.out, "cells": cells}
        if sweeps:
            self._sweep(sweeps, proposal, protocol, asked)
            return
        with console.bar(f"trials of {proposal.name}") as progress:
            evaluation = evaluate(proposal, progress=progress.show, **asked)
        if self.json:
            console.print_json(evaluation.to_json())
            return
        # Every user's model has the name of its factorization; the folder tells which it is.
        name = evaluation.model if evaluation.model == self.model else f"{evaluation.model} ({self.model})"
        rates = "% held / % held and type-faithful"
        print(f"{name} under protocol {protocol.name}, {self.per_cell} trials a cell: {rates}")
        tried = {(cell.object_label, cell.grasp_type): cell for cell in evaluation.cells}
        rows = [
            [obj, *(_pair(tried.get((obj, kind))) for kind in evaluation.by_type), _pair(tally)]
            for obj, tally in evaluation.by_object.items()
        ]
        rows.append(["all objects", *map(_pair, evaluation.by_type.values()), _pair(evaluation.total)])
        headings = [name.replace("_", "\n") for name in evaluation.by_type]
        console.print_table(["object", *headings, "all\ntypes"], rows)
        _print_rates(evaluation.to_json())

    def _sweep(self, sweeps: Sequence[Sweep], proposal: Proposal, protocol: Protocol, asked: dict[str, Any]) -> None:
        from ..studies.sweep import PICTURE_FILE, sweep, sweep_to_json
        from ..viewer.pictures import draw_sweep, need_matplotlib, save_png

        with console.bar(f"trials of {proposal.name}") as progress:
            points = sweep(proposal, sweeps, progress=progress.show, **asked)
        document = console.plain(sweep_to_json(points, protocol))
        if self.json:
            console.print_json(document)
        else:
            rates = ("held", "faithful", "steady")
            print(f"{proposal.name} under protocol {protocol.name}, {document['points'][0]['n']} trials of each value")
            rows = [
                [row["condition"], f"{row['value']:g}", *(console.interval(row[name]) for name in rates)]
                for row in document["points"]
            ]
            console.print_table(["condition", "value", *rates], rows, left=(0,))
        if self.out is not None:
            try:
                need_matplotlib()
            except InputError as error:
                console.say("evaluate", f"no picture is drawn: {error}")
                return
            save_png(draw_sweep(document), self.out / PICTURE_FILE)


def _pair(tally: Any) -> str:
    return "-" if tally is None else f"{100 * tally.held_rate.rate:.0f}/{100 * tally.faithful_rate.rate:.0f}"
