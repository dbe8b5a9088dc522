"""What the pages of the documentation show works as written, in page order, in an empty folder."""

import json
import re
import shlex
import shutil
from importlib.util import find_spec
from pathlib import Path

import pytest

from graspcascade.cli import main
from graspcascade.hands import load_hand
from hand_files import cut_hand

DOCS = Path(__file__).parents[1] / "docs"
PAGES = ["quickstart", "own_recordings", "formats", "own_hand", "protocol"]
BLOCK = re.compile(r'^```(\w+)(?: title="([^"\n]+)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)
RUN = ("sample", "trial", "export", "objects", "hands")
"""Commands that end within moments, without training, pages or pictures."""
NOT_HERE = ("--picture", "my_hand", "--model model", "my_model", "likely.json", "menagerie", "my_prior")
"""Parts of commands that need more than the page's own files and the plain install."""


def blocks(page: str) -> list[tuple[str, str, str]]:
    """List kind, title and text of each block of a page."""
    return BLOCK.findall((DOCS / f"{page}.md").read_text(encoding="utf-8"))


def commands(text: str) -> list[list[str]]:
    """List the arguments of the commands in a block that can be run here."""
    lines = [line for line in text.splitlines() if line.startswith("graspcascade ")]
    asked = [shlex.split(line, comments=True)[1:] for line in lines if not any(part in line for part in NOT_HERE)]
    return [arguments for arguments in asked if arguments[0] in RUN]


@pytest.mark.parametrize("page", PAGES)
def test_a_page_runs_from_top_to_bottom(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if page == "own_recordings" and find_spec("torch") is None:
        pytest.skip("needs the train extra")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for kind, title, text in blocks(page):
        if title:
            Path(title).parent.mkdir(exist_ok=True)
            Path(title).write_text(text, encoding="utf-8")
        elif kind == "python":
            exec(compile(text, f"{page}.md", "exec"), names)
        elif kind == "bash":
            for arguments in commands(text):
                assert main(arguments) == 0, arguments


def test_what_the_pages_do_is_tried_here() -> None:
    run = [
        arguments for page in PAGES for kind, _, text in blocks(page) if kind == "bash" for arguments in commands(text)
    ]
    assert len(run) >= 15
    assert {arguments[0] for arguments in run} == set(RUN)


def test_the_readme_runs_in_python() -> None:
    text = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    (code,) = (text for kind, _, text in BLOCK.findall(text) if kind == "python")
    exec(compile(code, "README.md", "exec"), {})


def test_the_hand_file_of_the_page_is_one(tmp_path: Path) -> None:
    (text,) = (text for _, title, text in blocks("own_hand") if title == "my_hand/hand.yaml")
    smaller = cut_hand(tmp_path, 4)
    shutil.move(tmp_path / "model.xml", tmp_path / "my_hand.xml")
    (tmp_path / "hand.yaml").write_text(text, encoding="utf-8")
    hand = load_hand(tmp_path / "hand.yaml")
    assert (hand.joint_names, list(hand.digits)) == (smaller.joint_names, list(smaller.digits))
    assert len(hand.grasp_types) == 6


def test_the_page_of_the_protocol_has_the_measured_errors_of_its_contacts() -> None:
    measured = json.loads((DOCS / "results" / "contacts.json").read_text(encoding="utf-8"))
    usual = {"cone": "elliptic", "solver": "newton", "integrator": "implicitfast", "time_step_s": 0.004}
    columns = [
        next(
            row
            for row in measured["rows"]
            if usual.items() <= row.items() and (row["impratio"], row["noslip_iterations"]) == settings
        )
        for settings in ((10, 0), (100, 0), (1000, 0), (10, 3))
    ]
    forms = {"gripped_mm": (1, 2), "three_pads_mm": (1, 2), "resting_mm": (1, 2), "sliding_error": (100, 1)}
    forms |= {"turned_deg": (1, 1), "slipping_error": (100, 1), "energy_gain": (100, 1)}
    page = (DOCS / "protocol.md").read_text(encoding="utf-8")
    for name, limit in measured["limits"].items():
        scale, digits = forms[name]
        cells = [f"{scale * row[name]:.{digits}f}" for row in columns]
        cells = [f"**{cell}**" if name in row["failed"] else cell for cell, row in zip(cells, columns, strict=True)]
        assert f"| {limit * scale:g} | {' | '.join(cells)} |" in page
    costs = " | ".join(f"{row['step_us']:.1f}" for row in columns)
    assert f"| {costs} |" in page
    assert columns[-1]["failed"] == []


def test_the_page_of_the_protocol_has_the_measured_stability_of_its_verdicts() -> None:
    rows = json.loads((DOCS / "results" / "stability.json").read_text(encoding="utf-8"))["conditions"]
    page = (DOCS / "protocol.md").read_text(encoding="utf-8")
    assert {row["n"] for row in rows} == {1080}
    for usual, longer, finer in zip(rows[::3], rows[1::3], rows[2::3], strict=True):
        assert (longer["gravity_s"], finer["time_step_s"]) == (20.0, 0.002)
        rates = [f"{100 * usual[f'{name} rate']['rate']:.1f}" for name in ("held", "faithful", "steady")]
        points = [f"{row['held, points over the protocol']:+.1f}" for row in (longer, finer)]
        assert f"| `{usual['protocol']}` | {' | '.join([*rates, *points])} |" in page
        if usual["protocol"] == "hold":
            assert max(abs(row["held, points over the protocol"]) for row in (longer, finer)) < 1.0


def test_the_page_of_the_protocol_has_the_measured_rates_in_six_directions() -> None:
    rows = json.loads((DOCS / "results" / "six_directions.json").read_text(encoding="utf-8"))["trials"]
    page = (DOCS / "protocol.md").read_text(encoding="utf-8")
    failures = ("overlap", "missed", "pushed_out", "turned", "unstable")
    assert {row["n"] for row in rows if row["type"] == "all"} == {1080}
    for row in rows:
        assert row["n"] == row["held"] + sum(row[name] for name in failures)
        rate = " ".join(f"{100 * row['held rate'][bound]:.1f}" for bound in ("rate", "low", "high"))
        held = "{} ({} to {})".format(*rate.split())
        counts = " | ".join(str(row[name]) for name in failures)
        kind = row["type"] if row["type"] == "all" else f"`{row['type']}`"
        assert f"| {row['grasps']} | {kind} | {row['n']} | {held} | {counts} |" in page


def test_the_page_of_the_protocol_has_the_rates_of_the_papers_models() -> None:
    measured = json.loads((DOCS / "results" / "protocols.json").read_text(encoding="utf-8"))
    page = (DOCS / "protocol.md").read_text(encoding="utf-8")
    assert len(measured["rates"]) == 12
    for row in measured["rates"]:
        rates = (row[name] for name in ("held", "faithful", "steady"))
        cells = [f"{100 * r['rate']:.1f} ({100 * r['low']:.1f} to {100 * r['high']:.1f})" for r in rates]
        assert f"| {row['model']} | `{row['protocol']}` | {row['n']} | {' | '.join(cells)} |" in page


def test_no_page_uses_words_of_our_own() -> None:
    private = re.compile(r"\b(verbs?|wish|wishes|is told|are told|ladder)\b|\brooms?\b", re.IGNORECASE)
    texts = {path: path.read_text(encoding="utf-8") for path in [*DOCS.glob("*.md"), *DOCS.parent.glob("*.md")]}
    wrong = [f"{path.name}: {word[0]}" for path, text in texts.items() for word in private.finditer(text)]
    # The map of the package may call its folders rooms, having said what they are.
    assert [word for word in wrong if not (word.startswith("architecture.md") and "room" in word.lower())] == []


def test_the_page_of_the_protocol_has_what_locked_couplings_changed() -> None:
    free, locked = json.loads((DOCS / "results" / "independent.json").read_text(encoding="utf-8"))["coupling"]
    page = " ".join((DOCS / "protocol.md").read_text(encoding="utf-8").split())
    moved = "moved, mm (median)"
    assert f"in {free['n']} grasps objects moved by {locked[moved]:.1f} instead of {free[moved]:.1f} mm" in page


def test_the_page_on_speed_has_the_measured_agreement_under_hold() -> None:
    rows = json.loads((DOCS / "results" / "verdict_agreement_hold.json").read_text(encoding="utf-8"))["comparisons"]
    heuristic, cascade = (row for row in rows if row["executed"] == "abridged as in a collection")
    page = " ".join((DOCS / "performance.md").read_text(encoding="utf-8").split())
    agree, wrong = (
        [100 * row[name]["rate"] for row in (heuristic, cascade)] for name in ("agreement", "false_successes")
    )
    n = heuristic["n"]
    assert f"{agree[0]:.2f} % of {n:,} abridged trials of the heuristic and {agree[1]:.2f} % of the cascade's" in page
    assert f"{wrong[0]:.2f} and {wrong[1]:.2f} % are held only when abridged" in page


def test_the_page_on_hands_is_right_about_the_mesh_hand_under_hold() -> None:
    rows = json.loads((DOCS / "results" / "hand_comparison_hold.json").read_text(encoding="utf-8"))["types"]
    points = [100 * (row["held_mesh"]["rate"] - row["held_primitives"]["rate"]) for row in rows]
    assert len(points) == 12
    assert max(map(abs, points)) < 3.0
