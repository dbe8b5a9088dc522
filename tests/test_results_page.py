"""The results page: it says what the JSON says, and nothing else."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from graspcascade.errors import FileFormatError, InputError
from graspcascade.evaluation import Evaluation, newcombe
from graspcascade.report import write_report
from graspcascade.report.gallery import Gallery
from graspcascade.report.markdown import points
from graspcascade.report.results_page import render
from graspcascade.trials import PAPER
from test_evaluation import evaluation


@pytest.fixture
def results(tmp_path: Path) -> Path:
    folder = tmp_path / "results"
    evaluation().save(folder / "heuristic.json")
    evaluation("model3", 1, held_share=0.8, model_metadata={"trained_on": "60k"}).save(folder / "model3.json")
    evaluation("model10", 2, held_share=0.7).save(folder / "model10.json")
    slippery = replace(PAPER, name="paper-friction-0.6", friction=0.6)
    evaluation("model3", 3, protocol=slippery).save(folder / "sensitivity_friction.json")
    return folder


def page(results: Path) -> str:
    write_report(results, results.parent / "results.md")
    return (results.parent / "results.md").read_text()


def words(rate: Any) -> str:
    return f"{100 * rate.rate:.1f} % [{100 * rate.low:.1f}, {100 * rate.high:.1f}]"


def test_the_committed_page_is_of_the_committed_files() -> None:
    docs = Path(__file__).parents[1] / "docs"
    gallery = Gallery(docs / "results.md", docs / "figures", drawn=False)
    assert render(docs / "results", gallery) == (docs / "results.md").read_text(encoding="utf-8")


def test_the_page_shows_every_number(results: Path) -> None:
    text = page(results)
    for name, value in PAPER.to_json().items():
        assert name == "name" or f"| {name} | {value:g} |" in text
    for path in results.glob("*.json"):
        found = Evaluation.load(path)
        assert words(found.held) in text
        assert words(found.faithful) in text
        verdicts = text.split("\n## Verdicts\n")[1].split("\n## ")[0]
        shares = " | ".join(f"{100 * count / found.n:.1f}" for count in found.total.verdicts.values())
        assert f"| {found.model} | `{found.protocol.name}` | {found.n} | {shares} |" in verdicts
        if found.protocol != PAPER:
            continue
        section = text.split(f"\n## {found.model}\n")[1].split("\n## ")[0]
        for name, tally in (found.by_type | found.by_object).items():
            numbers = (str(tally.n), str(tally.held), words(tally.held_rate), str(tally.faithful))
            assert (
                " | ".join((f"| {name}", *numbers, words(tally.faithful_rate), words(tally.faithful_of_held)))
                in section
            )
        for cell in found.cells:
            assert f"{100 * cell.held_rate.rate:.1f} / {100 * cell.faithful_rate.rate:.1f}" in section
        assert f"protocol `{found.protocol.name}`" in section
        assert f"{found.n} trials" in section


def test_models_are_compared_with_the_heuristic(results: Path) -> None:
    one, base = (Evaluation.load(results / f"{name}.json").total for name in ("model3", "heuristic"))
    held = newcombe(one.held, one.n, base.held, base.n)
    assert f"{100 * held.difference:+.1f} [{100 * held.low:+.1f}, {100 * held.high:+.1f}]" in page(results)


def test_the_heuristic_comes_first_and_models_in_the_order_of_their_numbers(results: Path) -> None:
    evaluation("adam", 4).save(results / "adam.json")
    text = page(results)
    places = [text.index(f"\n## {name}\n") for name in ("heuristic", "adam", "model3", "model10")]
    assert places == sorted(places)


def test_evaluations_of_one_name_are_told_apart_by_their_files(results: Path) -> None:
    evaluation("model3", 5).save(results / "model3_seed1.json")
    text = page(results)
    assert "\n## model3\n" in text
    assert "\n## model3 (model3_seed1)\n" in text


def test_another_protocol_is_named_and_kept_apart(results: Path) -> None:
    text = page(results)
    apart = text.split("## Other conditions")[1].split("\n## ")[0]
    assert "friction 0.6 (`paper`: 0.8)" in apart
    assert "`paper-friction-0.6`" in apart
    assert "sensitivity_friction" not in text.split("## Success rates")[1].split("\n## ")[0]


def test_other_conditions_are_compared_with_the_same_grasps_where_these_were_executed(results: Path) -> None:
    slippery = Evaluation.load(results / "sensitivity_friction.json").total

    def compared() -> str:
        apart = page(results).split("## Other conditions")[1].split("\n## ")[0]
        (line,) = [line for line in apart.splitlines() if "`paper-friction-0.6`" in line]
        return line

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
    same, other = (page(results).split(f"### {name}\n")[1].split("\n##")[0] for name in ("aaaa", "bbbb"))
    assert "File `of_aaaa.json`. It also holds 3 shards." in same
    assert "0123" not in same
    assert "another prior" not in same
    assert "another prior than the rates above, which are of aaaa" in other


def test_rates_near_none_or_all_have_two_decimals(results: Path) -> None:
    data = {
        name: {"rate": value, "low": 0.0, "high": 1.0}
        for name, value in (("a", 0.99481), ("b", 0.98999), ("c", 0.0022))
    }
    (results / "agreement.json").write_text(json.dumps(data))
    text = page(results)
    assert "| a | 99.48 % [0.00, 100.00] |" in text
    assert "| b | 99.0 % [0.0, 100.0] |" in text
    assert "| c | 0.22 % [0.00, 100.00] |" in text


def test_the_page_follows_the_json(results: Path) -> None:
    before = page(results)
    changed = evaluation("model3", 9, held_share=0.6)
    changed.save(results / "model3.json")
    after = page(results)
    assert before != after
    assert words(changed.held) in after
    assert words(changed.held) not in before


def test_notes_are_taken_over_word_for_word(results: Path) -> None:
    assert "What falls short" not in page(results)
    (results / "notes.md").write_text("- Tip pinch: *why* it | fails.\n- And more.\n")
    assert "## What falls short\n\n- Tip pinch: *why* it | fails.\n- And more.\n" in page(results)


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
    section = page(results).split("### Two hands")[1].split("\n## ")[0]
    for line in (
        "The same candidates.",
        "| n | 1080 |",
        "| held.primitives | 45.5 % [42.0, 49.0] |",
        "| agreement | 0.9125 |",
        "| tripod | 170 |",
    ):
        assert line in section


@pytest.mark.parametrize("text", ["{", "[1, 2]"])
def test_an_unreadable_file_leaves_the_page_alone(results: Path, text: str) -> None:
    before = page(results)
    (results / "broken.json").write_text(text)
    with pytest.raises(FileFormatError, match=r"broken\.json"):
        write_report(results, results.parent / "results.md")
    assert (results.parent / "results.md").read_text() == before


def test_a_folder_without_evaluations_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no evaluation"):
        write_report(tmp_path, tmp_path / "results.md")
    assert not (tmp_path / "results.md").exists()
