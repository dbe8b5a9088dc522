"""The results page, its sections and its command: they say what the JSON says, and nothing else."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.paper.figures import evaluation_figures
from benchmarks.paper.markdown import points
from benchmarks.paper.report import MAX_LINES, render, run, section, write_page
from benchmarks.paper.runs import protocol_numbers, read_results
from benchmarks.paper.sections import sections
from benchmarks.tests.support import MAX_BYTES, needs_drawing, trained, words
from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.protocols import PAPER
from graspcascade.studies.record import Evaluation
from tests.evaluations import evaluation

DOCS = Path(__file__).parents[2] / "docs"
TABLES = Path(__file__).with_name("tables_i_to_iii.md")


@pytest.fixture
def results(tmp_path: Path) -> Path:
    folder = tmp_path / "results"
    evaluation().save(folder / "heuristic.json")
    evaluation("model3", 1, held_share=0.8, model_metadata={"trained_on": "60k"}).save(folder / "model3.json")
    evaluation("model10", 2, held_share=0.7).save(folder / "model10.json")
    slippery = PAPER.with_physics("paper-friction-0.6", friction=0.6)
    evaluation("model3", 3, protocol=slippery).save(folder / "sensitivity_friction.json")
    return folder


def page(results: Path) -> str:
    write_page(results, results.parent / "results.md")
    return (results.parent / "results.md").read_text()


def row(text: str, *begins: str) -> str:
    (line,) = [line for line in text.splitlines() if line.startswith(f"| {' | '.join(begins)} |")]
    return line


# The committed page


def test_the_committed_page_is_of_the_committed_files_and_can_be_read_in_one_go() -> None:
    text = (DOCS / "results.md").read_text(encoding="utf-8")
    assert render(DOCS / "results", DOCS / "results.md") == text, "run `python -m benchmarks.paper.report`"
    assert len(text.splitlines()) <= MAX_LINES


def test_the_published_rates_of_the_papers_tables_never_change() -> None:
    assert TABLES.read_text(encoding="utf-8").strip() in (DOCS / "results.md").read_text(encoding="utf-8")


def test_counts_in_the_notes_are_in_the_committed_files() -> None:
    notes = (DOCS / "results/notes.md").read_text(encoding="utf-8")
    files = "".join((DOCS / f"results/{name}.json").read_text() for name in ("contact_creep", "independent"))
    counts = re.findall(r"(\d+) of (\d+) trials|of (\d+) grasps (\d+) are held after 5 s of gravity and (\d+)", notes)
    assert len(counts) == 2
    for number in filter(None, (number for count in counts for number in count)):
        assert re.search(rf": {number}\b", files), number


def test_every_section_of_the_committed_results_is_named_on_the_page_and_can_be_printed() -> None:
    text = (DOCS / "results.md").read_text(encoding="utf-8")
    for name, (about, write) in sections(read_results(DOCS / "results")).items():
        assert f"| `{name}` | {about} |" in text
        assert write().startswith("## ")


# Made-up results


def test_the_first_screen_has_the_rates_that_matter(results: Path) -> None:
    text = page(results)
    for name in ("heuristic", "model3", "model10"):
        one = Evaluation.load(results / f"{name}.json")
        assert f"| {one.n} | {one.total.held} | **{words(one.held)}** |" in row(text, name, "held")
        if name != "heuristic":
            faithful = row(text, name, "held, type-faithful")
            assert f"| {one.n} | {one.total.faithful} | **{words(one.faithful)}** |" in faithful


def test_sections_show_every_number(results: Path) -> None:
    protocol, cells, verdicts = (section(results, name) for name in ("protocol", "cells", "verdicts"))
    for name, value in protocol_numbers(PAPER).items():
        assert f"| {name} | {value:g} |" in protocol
    for path in results.glob("*.json"):
        one = Evaluation.load(path)
        shares = " | ".join(f"{100 * count / one.n:.1f}" for count in one.total.verdicts.values())
        assert row(verdicts, one.model, f"`{one.protocol.name}`", str(one.n)).endswith(f"| {shares} |")
        if one.protocol != PAPER:
            continue
        here = f"\n{cells}".split(f"\n## {one.model}\n")[1].split("\n## ")[0]
        assert f"protocol `{one.protocol.name}`" in here
        for name, tally in (one.by_type | one.by_object).items():
            numbers = (str(tally.n), str(tally.held), words(tally.held_rate), str(tally.faithful))
            assert (
                " | ".join((f"| {name}", *numbers, words(tally.faithful_rate), words(tally.faithful_of_held))) in here
            )
        for cell in one.cells:
            assert f"{100 * cell.held_rate.rate:.1f} / {100 * cell.faithful_rate.rate:.1f}" in here


def test_the_heuristic_comes_first_and_models_in_the_order_of_their_numbers(results: Path) -> None:
    evaluation("adam", 4).save(results / "adam.json")
    text = page(results)
    places = [text.index(f"\n| {name} | held |") for name in ("heuristic", "adam", "model3", "model10")]
    assert places == sorted(places)


def test_evaluations_of_one_name_are_told_apart_by_their_files(results: Path) -> None:
    evaluation("model3", 5).save(results / "model3_seed1.json")
    text = page(results)
    assert "\n| model3 | held |" in text
    assert "\n| model3 (model3_seed1) | held |" in text


def test_another_protocol_is_named_and_kept_apart(results: Path) -> None:
    apart = section(results, "conditions")
    assert "friction 0.6 (`paper`: 0.8)" in apart
    assert "`paper-friction-0.6`" in apart
    assert "friction" not in page(results).split("## Everything else")[0]


def test_other_conditions_are_compared_with_the_same_grasps_where_these_were_executed(results: Path) -> None:
    slippery = Evaluation.load(results / "sensitivity_friction.json").total

    def compared() -> str:
        return row(section(results, "conditions"), "model3", "`paper-friction-0.6`")

    assert points(slippery.held_over(Evaluation.load(results / "model3.json").total)) in compared()
    same = evaluation("model3", 3, held_share=0.95, protocol=replace(PAPER, name="paper, same grasps"))
    same.save(results / "sensitivity_same_grasps.json")
    assert points(slippery.held_over(same.total)) in compared()
    for others in (replace(same, seed=4), evaluation("model3", 3, 30, 0.95, protocol=same.protocol)):
        others.save(results / "sensitivity_same_grasps.json")
        assert points(slippery.held_over(Evaluation.load(results / "model3.json").total)) in compared()


def test_a_measurement_with_another_prior_says_so_and_long_lists_stay_in_the_file(results: Path) -> None:
    evaluation(model_metadata={"prior": "aaaa"}).save(results / "heuristic.json")
    for prior in ("aaaa", "bbbb"):
        data = {"title": prior, "prior": prior, "shards": [{"sha256": "0123"}] * 3, "file_only": ["shards"]}
        (results / f"of_{prior}.json").write_text(json.dumps(data))
    same, other = section(results, "of_aaaa"), section(results, "of_bbbb")
    assert "File `of_aaaa.json`. It also holds 3 shards." in same
    assert "0123" not in same
    assert "another prior" not in same
    assert "another prior than the rates of the results page, which are of aaaa" in other


def test_rates_near_none_or_all_have_two_decimals(results: Path) -> None:
    values = (("a", 0.99481), ("b", 0.98999), ("c", 0.0022))
    data = {name: {"rate": value, "low": 0.0, "high": 1.0} for name, value in values}
    (results / "agreement.json").write_text(json.dumps(data))
    text = section(results, "agreement")
    assert "| a | 99.48 % [0.00, 100.00] |" in text
    assert "| b | 99.0 % [0.0, 100.0] |" in text
    assert "| c | 0.22 % [0.00, 100.00] |" in text


def test_other_measurements_become_tables(results: Path) -> None:
    data = {
        "title": "Two hands",
        "description": "The same candidates.",
        "protocol": "paper",
        "n": 1080,
        "held": {"primitives": {"rate": 0.455, "low": 0.42, "high": 0.49}},
        "agreement": 0.9125,
        "per_type": [{"grasp_type": "tripod", "agree": 170}, {"grasp_type": "tip_pinch", "agree": 160}],
    }
    (results / "hand_comparison.json").write_text(json.dumps(data))
    text = section(results, "hand_comparison")
    assert text.startswith("## Two hands\n")
    for line in (
        "The same candidates.",
        "| n | 1080 |",
        "| held.primitives | 45.5 % [42.0, 49.0] |",
        "| agreement | 0.9125 |",
        "| tripod | 170 |",
    ):
        assert line in text


def test_the_page_follows_the_json(results: Path) -> None:
    before = page(results)
    changed = evaluation("model3", 9, held_share=0.6)
    changed.save(results / "model3.json")
    after = page(results)
    assert words(changed.held) in after
    assert words(changed.held) not in before


def test_notes_are_taken_over_word_for_word(results: Path) -> None:
    assert "Where grasps fail" not in page(results)
    (results / "notes.md").write_text("- Tip pinch: *why* it | fails.\n- And more.\n")
    assert "## Where grasps fail\n\n- Tip pinch: *why* it | fails.\n- And more.\n" in page(results)


@pytest.mark.parametrize("text", ["{", "[1, 2]"])
def test_an_unreadable_file_leaves_the_page_alone(results: Path, text: str) -> None:
    before = page(results)
    (results / "broken.json").write_text(text)
    with pytest.raises(FileFormatError, match=r"broken\.json"):
        write_page(results, results.parent / "results.md")
    assert (results.parent / "results.md").read_text() == before


def test_a_folder_without_evaluations_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no evaluation"):
        write_page(tmp_path, tmp_path / "results.md")
    assert not (tmp_path / "results.md").exists()


# The command


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    capsys.readouterr()
    assert run([str(a) for a in arguments]) == 2
    said = capsys.readouterr()
    assert not said.out
    assert len(said.err.splitlines()) == 1
    return said.err


def test_the_command_writes_the_page_or_prints_a_section(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written = tmp_path / "results.md"
    assert run(["--results", str(results), "--section", "conditions"]) == 0
    assert capsys.readouterr().out == section(results, "conditions") + "\n"
    assert not written.exists()
    assert run(["--results", str(results), "--out", str(written)]) == 0
    assert capsys.readouterr().out == f"wrote {written}\n"
    assert written.read_text() == page(results)


def test_the_command_says_what_it_cannot_use(results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    assert "no evaluation" in refused(capsys, "--results", tmp_path / "empty", "--out", tmp_path / "a.md")
    assert "no folder" in refused(capsys, "--results", tmp_path / "none", "--out", tmp_path / "a.md")
    assert ".md file" in refused(capsys, "--results", results, "--out", tmp_path / "a.txt")
    assert "Did you mean 'conditions'?" in refused(capsys, "--results", results, "--section", "condition")


def test_figures_without_matplotlib_are_refused_before_the_page(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("graspcascade.viewer.pictures.find_spec", lambda _: None)
    said = refused(capsys, "--results", results, "--out", tmp_path / "a.md", "--figures", tmp_path / "figures")
    assert "'.[view]'" in said
    assert not (tmp_path / "a.md").exists()


@needs_drawing
def test_every_evaluation_gets_a_heat_map(results: Path, tmp_path: Path) -> None:
    written = evaluation_figures(results, tmp_path / "figures")
    assert [path.name for path in written] == [f"success_{n}.png" for n in ("heuristic", "model3", "model10")]
    assert all(0 < path.stat().st_size < MAX_BYTES for path in written)
    assert "](figures/success_model3.png)" in page(results)


@needs_drawing
def test_the_command_draws_every_figure(results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trained("model2", 0, 0.5).save(results / "paper" / "model2.json")
    written, figures = tmp_path / "results.md", tmp_path / "figures"
    assert run(["--results", str(results), "--out", str(written), "--figures", str(figures)]) == 0
    said = capsys.readouterr().out.splitlines()
    names = ("success_model10", "success_paper_model2", "grasp_types", "objects", "pose_frames")
    assert {f"wrote {figures / name}.png" for name in names} <= set(said)
    assert all((figures / f"{name}.png").stat().st_size < MAX_BYTES for name in names)
    assert "](figures/success_model3.png)" in written.read_text()
