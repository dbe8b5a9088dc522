"""Write the results page and its figures from committed JSON, or print one section of the results.

Examples::

    python -m benchmarks.paper.report
    python -m benchmarks.paper.report --figures docs/figures
    python -m benchmarks.paper.report --section conditions
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.common import command
from graspcascade.core.errors import InputError, check_name
from graspcascade.core.files import write_text
from graspcascade.core.protocols import Carry
from graspcascade.proposals.heuristic import HEURISTIC

from . import tables
from .markdown import fill_blocks, rate, table
from .published import FULL_MODEL, TABLES
from .runs import Entry, ResultsFolder, read_results
from .sections import sections

MODULE = "benchmarks.paper.report"
MAX_LINES = 200
"""Lines that a reader can be expected to read; everything else is a section to be printed."""


@dataclass(frozen=True)
class Report:
    """Write the results page from a folder of evaluations, or print one section of the results."""

    results: Path = Path("docs/results")
    """Folder of JSON files, such as the evaluation.json of `graspcascade evaluate --out`."""
    out: Path = Path("docs/results.md")
    """Page to write, .md. Tables of a performance.md beside it are made from the folder `performance`, those of a
    protocol.md from engines.json, those of a model_card.md from the shipped cascade."""
    section: str = ""
    """Print this section as Markdown and write nothing; the page lists all sections."""
    figures: Path | None = None
    """Folder for heat maps, training curves, grasps of each type, the objects and sampled hand frames, all .png."""
    model: str = "default"
    """Name of a shipped cascade, or the folder of a trained one, that the pictures are sampled from."""


def main(report: Report) -> None:
    """Print a section, or write the page and then the figures.

    Raises:
        InputError: no such folder, section or page, or a package that draws is missing.
    """
    if not report.results.is_dir():
        raise InputError(f"there is no folder {report.results}")
    if report.section:
        print(section(report.results, report.section))
        return
    if report.out.suffix.lower() != ".md":
        raise InputError(f"a results page is a .md file, got {report.out.name!r}")
    if report.figures is not None:
        from graspcascade.viewer.pictures import need_matplotlib, need_renderer

        need_matplotlib()
        need_renderer()
    written = []
    if report.figures is not None:
        from .figures import draw_pictures, evaluation_figures

        # Drawn before the page is written, which shows the figures that exist beside it.
        written = [*evaluation_figures(report.results, report.figures), *draw_pictures(report.figures, report.model)]
    write_page(report.results, report.out)
    written += [report.out, *_fill_other_pages(report.results, report.out)]
    print("\n".join(f"wrote {path}" for path in written))


def section(folder: Path, name: str) -> str:
    """Write one section of the results as Markdown.

    Raises:
        InputError: no such section.
    """
    listed = sections(read_results(folder))
    check_name("section", name, listed)
    return listed[name][1]()


def write_page(folder: Path, page: Path) -> None:
    """Write the results page; the same files give the same page.

    Raises:
        InputError: the folder holds no evaluation.
        FileFormatError: a file is not JSON, or an evaluation that contradicts itself.
    """
    write_text(page, render(folder, page))


def render(folder: Path, page: Path) -> str:
    """Word the results page: the main rates, the paper's tables, where it fails, and the list of sections."""
    results = read_results(folder)
    blocks = [_first_screen(results, page)]
    if results.paper is not None:
        runs = results.paper.runs
        blocks += ["## Against the paper", _SYMBOLS, *(tables.paper_table(one, runs) for one in TABLES)]
        blocks += ["### What the paper concludes", _JUDGED, tables.statement_table(runs)]
        if results.paper.notes:
            blocks += ["## What falls short of the paper, and why", results.paper.notes]
    if results.notes:
        blocks += ["## Where grasps fail", results.notes]
    return "\n\n".join([*blocks, _section_list(results)]) + "\n"


def _first_screen(results: ResultsFolder, page: Path) -> str:
    base = results.base.evaluation
    shown = next((one for one in results.same if one.evaluation.model == FULL_MODEL), results.base)
    rows = [row for one in results.same for row in _rates_of(one)]
    seconds = sum(phase.duration_s for phase in base.protocol.phases if isinstance(phase, Carry))
    blocks = [
        "# Results",
        f"Six precision grasp types on nine objects with `{base.hand}`, tried in simulation under [protocol "
        f"`{base.protocol.name}`](protocol.md): the hand closes on the object, is shaken, and carries it for "
        f"{seconds:g} seconds. Every grasp that a model gives is tried, none is screened out; the side "
        "to hold an object by is drawn uniformly.",
        table(("grasps of", "what counts", "grasps tried", "succeeded", "rate [95 % interval]"), rows, text_columns=2),
        "*Held*: at the end the thumb and a finger touch the object and it has stayed in place. *Type-faithful* "
        "(*faithful* in tables): held, and every digit that the grasp type needs touches it. The shipped cascade is "
        "one of these trainings; its own rates are on the [model card](model_card.md).",
    ]
    picture = f"success_{shown.stem.replace('/', '_')}.png"
    if (page.parent / "figures" / picture).is_file():
        blocks.append(f"![Rates of {shown.label} by object and grasp type, in %](figures/{picture})")
    blocks.append(
        f"Made by `python -m {MODULE}` from the JSON files in `docs/results/`: every number is in them. Square "
        "brackets are 95 % confidence intervals: Wilson's score interval for a rate (DOI "
        "`10.1080/01621459.1927.10502953`), Newcombe's hybrid score interval for a difference (DOI "
        "`10.1002/(SICI)1097-0258(19980430)17:8<873::AID-SIM779>3.0.CO;2-I`)."
    )
    return "\n\n".join(blocks)


def _rates_of(entry: Entry) -> list[list[str]]:
    total = entry.total
    rows = [[entry.label, "held", str(total.n), str(total.held), f"**{rate(total.held_rate)}**"]]
    if entry.evaluation.model != HEURISTIC:
        faithful = f"**{rate(total.faithful_rate)}**"
        rows.append([entry.label, "held, type-faithful", str(total.n), str(total.faithful), faithful])
    return rows


_SYMBOLS = (
    "Tables I to III of the paper, whose rates are of 27,000 grasps each in another simulator. Gc is the posture, Gpos "
    "the object's position, Grot its rotation; Gt and Gs are the type and size of the grasp, Ot and Os those of the "
    "object. Networks that are given Gc also see the two contact points that it opposes; those given Os also see the "
    "side and its axis. The posture network is not given Os, as in the paper's section IV and Table III (the formulas "
    "beside its Table I give it Os). All training seeds of a model count together; differences are over the seeds that "
    "both models have."
)
_JUDGED = (
    "*Reproduced*: the difference of held rates is above zero with its whole interval, and larger than what training "
    "the same models again may do by itself. *Undecided*: neither that nor its opposite. Each comparison by itself is "
    "in section `orderings`."
)


def _section_list(results: ResultsFolder) -> str:
    rows = [[f"`{name}`", about] for name, (about, _) in sections(results).items()]
    return "\n\n".join(
        [
            "## Everything else",
            f"Each section below is printed, as Markdown, by `python -m {MODULE} --section NAME` from the repository's "
            "root. The commands that measured them are on the page [Reproduce](reproduce.md).",
            table(("section", "what it holds"), rows, text_columns=2),
        ]
    )


def _fill_other_pages(results: Path, page: Path) -> list[Path]:
    """Write the generated blocks of the other pages again, where they lie beside the page."""
    filled = []
    protocol = page.with_name("protocol.md")
    if protocol.is_file() and (results / "engines.json").is_file():
        from benchmarks.physics.engines import page_blocks

        write_text(protocol, fill_blocks(protocol.read_text(encoding="utf-8"), page_blocks(results)))
        filled.append(protocol)
    performance, card = page.with_name("performance.md"), page.with_name("model_card.md")
    if performance.is_file() and (results / "performance").is_dir():
        from benchmarks.speed.page import fill_page

        fill_page(performance, results / "performance")
        filled.append(performance)
    if card.is_file():
        from .model_card import fill_model_card

        fill_model_card(card)
        filled.append(card)
    return filled


def run(argv: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit status."""
    return command(MODULE, Report, main, argv)


if __name__ == "__main__":
    sys.exit(run())
