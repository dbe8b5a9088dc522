"""The paper's experiment: its rates beside ours, comparisons judged by intervals, training curves."""

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.paper.figures import evaluation_figures, training_figure
from benchmarks.paper.markdown import points, spread
from benchmarks.paper.published import ORDERINGS, PAPER_MODELS, STATEMENTS, SUCCESS_PERCENT, TABLES
from benchmarks.paper.report import section, write_page
from benchmarks.paper.runs import (
    Runs,
    TrainingCurves,
    metadata_differences,
    pool,
    read_paper_runs,
    read_training,
    retraining_margin,
    settings,
    shared_runs,
    training_seed,
)
from benchmarks.paper.tables import judge
from benchmarks.tests.support import MAX_BYTES, needs_drawing, trained, words
from graspcascade.core.errors import FileFormatError
from graspcascade.core.intervals import newcombe
from graspcascade.core.protocols import PAPER
from graspcascade.nets import EpochRecord
from graspcascade.proposals.cascade.sampler import EVALUATION_FILE, GraspSampler, shipped_folder
from graspcascade.proposals.cascade.stages import FACTORIZATIONS
from graspcascade.proposals.heuristic import HEURISTIC
from graspcascade.studies.learn import CascadeTraining
from graspcascade.studies.record import Evaluation
from tests.evaluations import evaluation

COUNTS = st.integers(1, 30_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """Make up evaluations of some models: model2 far below model1, model1's seeds far apart, the heuristic worst."""
    folder = tmp_path / "results"
    evaluation().save(folder / "heuristic.json")
    paper = folder / "paper"
    evaluation(HEURISTIC, 1, 40, 0.2).save(paper / "heuristic.json")
    for seed in (0, 1, 2):
        trained("model3", seed, 0.9, seed + 2).save(paper / f"model3_seed{seed}.json")
        trained("model1", seed, (0.72, 0.55, 0.55)[seed], seed + 5).save(paper / f"model1_seed{seed}.json")
    trained("model2", 0, 0.4, 8).save(paper / "model2.json")
    trained("variant4", 0, 0.9, 4).save(paper / "variant4.json")
    return folder


def page(results: Path) -> str:
    write_page(results, results.parent / "results.md")
    return (results.parent / "results.md").read_text()


def row(text: str, *begins: str) -> list[str]:
    """Find the one table row that begins with these cells."""
    rows = [[cell.strip() for cell in line.split(" | ")] for line in text.replace("\\|", "/").splitlines()]
    result = [cells for cells in rows if [cells[0].removeprefix("| "), *cells[1 : len(begins)]] == list(begins)]
    assert len(result) == 1, (begins, result)
    return [cells.removeprefix("| ").removesuffix(" |") for cells in result[0]]


def curves_json(model: str, seed: int = 0, epochs: int = 20, **stages: float) -> dict[str, Any]:
    fall = [[last + 100.0 / n**2 for n in range(1, epochs + 1)] for last in stages.values()]
    return {
        "factorization": model,
        "seed": seed,
        "stages": {
            name: {
                "epoch": list(range(1, epochs + 1)),
                "train_loss": curve,
                "train_reconstruction": curve,
                "train_kl": curve,
                "validation_loss": [value + 0.5 for value in curve],
            }
            for name, curve in zip(stages, fall, strict=True)
        },
    }


def save_curves(results: Path, name: str, data: Any) -> Path:
    path = results / "paper" / "training" / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data))
    return path


# --- the paper's own figures


def test_the_tables_name_every_model_of_the_paper_once_for_each_of_their_rows() -> None:
    of_tables = {name for name, one in FACTORIZATIONS.items() if one.source.startswith("Table")}
    assert of_tables == set(PAPER_MODELS) - {HEURISTIC}
    assert [len(table.rows) for table in TABLES] == [4, 2, 7]
    for table in TABLES:
        for one in table.rows:
            assert one.success_percent == SUCCESS_PERCENT[one.model]
            assert one.model == HEURISTIC or f"Table {table.number}" in FACTORIZATIONS[one.model].source.replace(
                "Tables I and II", "Table I and Table II"
            )


@pytest.mark.parametrize("ordering", ORDERINGS)
def test_the_paper_bears_out_its_orderings(ordering: Any) -> None:
    assert SUCCESS_PERCENT[ordering.better] > SUCCESS_PERCENT[ordering.worse]


# --- counting and judging


def test_pooled_counts_are_sums() -> None:
    parts = [evaluation("model1", seed, 10 + seed, 0.7) for seed in range(3)]
    result = pool(parts)
    assert result.n == sum(part.n for part in parts)
    assert result.total.faithful == sum(part.total.faithful for part in parts)
    for number, cell in enumerate(result.cells):
        assert cell.verdicts == {v: sum(part.cells[number].verdicts[v] for part in parts) for v in cell.verdicts}
    assert Evaluation.from_json(json.loads(json.dumps(result.to_json()))) == result


def test_pooling_one_changes_nothing_and_other_cells_are_refused() -> None:
    one = evaluation()
    assert pool([one]) == one
    for others in ([], [one, replace(one, cells=one.cells[1:])]):
        with pytest.raises(ValueError, match="same conditions"):
            pool(others)


@given(COUNTS, COUNTS, st.floats(0.001, 0.5))
def test_a_verdict_follows_the_interval(one: tuple[int, int], other: tuple[int, int], claim: float) -> None:
    difference = newcombe(*one, *other)
    assert judge(difference, claim, abs(difference.difference)).startswith("undecided")
    said, turned = judge(difference, claim), judge(newcombe(*other, *one), claim)
    if difference.low > 0:
        assert said == "reproduced"
        assert turned == f"not reproduced, difference {points(newcombe(*other, *one))}"
    elif difference.high >= 0:
        assert said.startswith("undecided")
        assert ("smaller than the paper's" in said) == (difference.high < claim)


# --- the section


def test_without_the_experiment_the_page_says_nothing_of_it(results: Path) -> None:
    (results / "paper").rename(results.parent / "elsewhere")
    assert "Against the paper" not in page(results)


def test_what_was_not_run_is_said_to_be_so(results: Path) -> None:
    (results / "paper").rename(results.parent / "elsewhere")
    (results / "paper").mkdir()
    text = page(results)
    for table in TABLES:
        for one in table.rows:
            cells = row(text.split(f"### Table {table.number}:")[1].split("\n### ")[0], one.label)
            assert cells[3:5] == [f"{one.success_percent:.2f}", "not yet run"]
    for statement in STATEMENTS:
        assert row(text, statement.words)[3] == f"{len(statement.orderings)} not yet run"


def test_a_row_has_the_papers_rate_ours_and_the_trials(results: Path) -> None:
    text = page(results)
    runs = read_paper_runs(results / "paper")
    assert runs is not None
    for table in TABLES:
        here = text.split(f"### Table {table.number}:")[1].split("\n### ")[0]
        for one in table.rows:
            cells = row(here, one.label, f"`{one.model}`")
            if one.model in runs.runs:
                result = runs.runs[one.model].pooled
                ours = [words(result.held), words(result.faithful), str(result.n)]
                assert cells[3:7] == [f"{one.success_percent:.2f}", *ours]
                if one.model != "model3":
                    same, full = shared_runs(runs.runs[one.model], runs.runs["model3"])
                    assert cells[7] == points(same.total.held_over(full.total))
                    assert cells[8] == points(same.total.faithful_over(full.total))
            else:
                assert cells[4] == "not yet run"


def test_rows_say_what_the_networks_are_given_as_the_paper_does(results: Path) -> None:
    text = page(results)
    assert row(text, "Model 1")[2] == "P(Gc, Gpos, Grot / Gt, Gs, Ot, Os)"
    assert row(text, "Variant 3")[2] == "position: Gc, Gt, Gs, Ot; rotation: Gpos, Gc, Gt, Ot, Os"
    assert row(text, "Variant 7")[2] == "position: Gc, Gt, Gs, Os; rotation: Gpos, Gc, Gt, Gs, Os"
    assert row(text, "Model with NN")[2] != row(text, "Model with vMF")[2]


def test_orderings_are_judged_by_intervals_and_seeds(results: Path) -> None:
    here = section(results, "orderings")
    runs = read_paper_runs(results / "paper")
    assert runs is not None

    def judged(better: str, worse: str) -> list[str]:
        table = next(o.table for o in ORDERINGS if (o.better, o.worse) == (better, worse))
        return row(here, table, f"`{better}` > `{worse}`")

    assert judged("model3", "model2")[2:4] == ["reproduced", "+11.49"]
    margin = retraining_margin(runs.runs["model3"], runs.runs["model2"], runs.runs)
    assert margin is not None
    assert judged("model3", "model2")[6] == f"±{100 * margin:.1f}"
    two, one = shared_runs(runs.runs["model2"], runs.runs["model1"])
    assert judged("model2", "model1")[4] == points(two.total.held_over(one.total))
    assert judged("variant4", "model3")[2].startswith("undecided")
    assert judged("model3", "plain_rotation")[2:] == ["not yet run", "+4.33", "—", "—", "—"]
    # The seeds of model1 lie far apart, so that a clear difference of trials may be retraining's.
    assert two.total.held_over(one.total).high < 0
    assert judged("model2", "model1")[2].startswith("undecided")
    for seed in (0, 1, 2):
        trained("model1", seed, 0.7, seed + 5).save(results / "paper" / f"model1_seed{seed}.json")
    here = section(results, "orderings")
    assert judged("model2", "model1")[2].startswith("not reproduced, difference -")


def test_statements_count_the_verdicts_of_their_orderings(results: Path) -> None:
    here = section(results, "orderings")
    for statement in STATEMENTS:
        cells = row(here, statement.words)
        verdicts = [row(here, o.table, f"`{o.better}` > `{o.worse}`")[2].split(",")[0] for o in statement.orderings]
        assert cells[1:3] == [statement.orderings[0].table, str(len(verdicts))]
        assert sorted(cells[3].split(", ")) == sorted(f"{verdicts.count(word)} {word}" for word in set(verdicts))


def seeds(model: str, first: int, *shares: float) -> Runs:
    return Runs(model, {seed: trained(model, seed, share, seed) for seed, share in enumerate(shares, first)})


def held_rates(*runs: Runs) -> list[list[float]]:
    return [[one.held.rate for one in result.by_seed.values()] for result in runs]


def test_models_are_compared_over_the_seeds_that_both_have() -> None:
    one, other = seeds("model1", 0, 0.5, 0.7, 0.9), seeds("model2", 1, 0.3, 0.4)
    assert shared_runs(one, other) == (pool([one.by_seed[1], one.by_seed[2]]), other.pooled)
    untrained = Runs(HEURISTIC, {None: evaluation()})
    assert shared_runs(one, untrained) == (one.pooled, untrained.pooled)


def test_what_all_models_have_under_a_seed_is_not_retrainings() -> None:
    every = {
        name: seeds(name, 0, *shares) for name, shares in (("model1", (0.5, 0.6, 0.9)), ("model2", (0.3, 0.4, 0.7)))
    }
    # Two models of three seeds each: what is left of their differences, with two degrees of freedom.
    rates = np.array(held_rates(*every.values()))
    spread = np.var(rates[0] - rates[1], ddof=1) / 2
    expected = 4.302653 * np.sqrt(spread * 2 / 3)
    assert retraining_margin(every["model1"], every["model2"], every) == pytest.approx(expected, rel=1e-5)
    assert expected < 0.1 < np.std(rates[0])
    alone = {"model1": seeds("model1", 0, 0.5, 0.6, 0.9), "model2": seeds("model2", 0, 0.5)}
    assert retraining_margin(alone["model1"], alone["model2"], alone) is None


def test_without_a_shared_seed_the_margin_is_of_the_spread_over_seeds() -> None:
    every = {"model1": seeds("model1", 0, 0.5, 0.7), "model2": seeds("model2", 2, 0.3, 0.3, 0.9)}
    rates = held_rates(*every.values())
    pooled = (np.var(rates[0], ddof=1) + 2 * np.var(rates[1], ddof=1)) / 3
    expected = 3.182446 * np.sqrt(pooled * (1 / 2 + 1 / 3))  # t of 0.975 with three degrees of freedom
    assert retraining_margin(every["model1"], every["model2"], every) == pytest.approx(expected, rel=1e-5)
    untrained = Runs(HEURISTIC, {None: evaluation()})
    once = expected * np.sqrt((1 / 2) / (1 / 2 + 1 / 3))
    assert retraining_margin(every["model1"], untrained, every) == pytest.approx(once, rel=1e-5)
    alone = {"model1": seeds("model1", 0, 0.5)}
    assert retraining_margin(alone["model1"], alone["model1"], alone) is None


def test_settings_younger_than_a_model_are_no_difference() -> None:
    shipped = Evaluation.load(shipped_folder() / EVALUATION_FILE)
    config = asdict(CascadeTraining())
    del config["training"]["metric_weight"]  # given with every stage's network
    assert {name for name, _ in settings(shipped)} >= {f"config.{name}" for name, _ in spread(config)}
    metadata = dict(shipped.model_metadata)
    recorded = metadata["config"]
    for name in ("position_weight", "most_repeats"):
        older = replace(shipped, model_metadata=metadata | {"config": dict(recorded)})
        older.model_metadata["config"].pop(name, None)
        assert metadata_differences(older, shipped) == metadata_differences(shipped, older) == ""
    other = replace(shipped, model_metadata=metadata | {"config": recorded | {"position_weight": 1.0}})
    assert metadata_differences(other, shipped) == "config.position_weight 1 (`model3`: 4)"


def test_pooled_evaluations_keep_what_all_agree_on() -> None:
    one, other = trained("model1", 0, 0.5), trained("model1", 1, 0.6, 3)
    result = pool([one, other])
    assert result.n == one.n + other.n
    assert result.held.rate == pytest.approx((one.held.rate + other.held.rate) / 2)
    assert result.model_metadata == {"config": {"training": {"epochs": 80}}, "learned_from": 40_000}
    with pytest.raises(ValueError, match="same conditions"):
        pool([one, replace(other, protocol=PAPER.with_physics("paper", friction=0.5))])


def test_every_training_seed_has_its_rate_and_the_spread_is_told(results: Path) -> None:
    here = section(results, "seeds")
    rates = []
    for seed in range(3):
        one = Evaluation.load(results / "paper" / f"model1_seed{seed}.json")
        assert row(here, "`model1`", str(seed))[2:] == [str(one.n), words(one.held), words(one.faithful)]
        rates.append(one.held.rate)
    assert row(here, "`model1`", "all")[2] == str(3 * 54 * 40)
    assert f"{100 * min(rates):.1f} to {100 * max(rates):.1f}" in row(here, "`model1`", "3")
    assert "`model2`" not in here


def test_breakdowns_have_every_model_by_object_and_type(results: Path) -> None:
    here = section(results, "breakdown")
    objects, types = (text for text in here.split("\n\n") if text.startswith("| model"))
    runs = read_paper_runs(results / "paper")
    assert runs is not None
    for name, run in runs.runs.items():
        for text, split in ((objects, run.pooled.by_object), (types, run.pooled.by_type)):
            assert row(text, f"`{name}`")[1:] == [
                f"{100 * tally.held_rate.rate:.1f} / {100 * tally.faithful_rate.rate:.1f}" for tally in split.values()
            ]


def test_models_trained_otherwise_are_named(results: Path) -> None:
    assert "trained on the same data with the same settings" in section(results, "settings")
    longer = trained("variant4", 0, 0.9, 4)
    longer = replace(
        longer, model_metadata={"config": {"training": {"epochs": 160, "seed": 0}}, "learned_from": 40_000}
    )
    longer.save(results / "paper" / "variant4.json")
    assert row(section(results, "settings"), "`variant4`", "0")[2] == "config.training.epochs 160 (`model3`: 80)"


def test_a_training_seed_alone_is_no_difference() -> None:
    one, other = trained("model1", 0, 0.5), trained("model1", 7, 0.6)
    assert (training_seed(one), training_seed(other), training_seed(evaluation())) == (0, 7, None)
    assert metadata_differences(one, other) == ""
    deep = {"networks": {"posture": {"latent_dim": 10}, "rotation": {"latent_dim": 4}}, "weights": "a"}
    flat = {"networks": {"grasp": {"latent_dim": 14}, "posture": {"latent_dim": 12}}, "weights": "b"}
    full, other = (replace(one, model_metadata=metadata) for metadata in (deep, flat))
    assert metadata_differences(other, full) == "networks.posture.latent_dim 12 (`model1`: 10)"


def test_the_experiment_stands_in_for_evaluations_without_a_file_of_their_own(results: Path) -> None:
    slippery = PAPER.with_physics("slippery", friction=0.3)
    (results / "heuristic.json").unlink()
    evaluation(HEURISTIC, 1, 40, 0.1, protocol=slippery).save(results / "a_slippery_heuristic.json")
    text, runs = page(results), read_paper_runs(results / "paper")
    assert runs is not None
    rates = text.split("rate [95 % interval] |")[1].split("\n\n")[0]
    assert [line.split(" | ")[0] for line in rates.strip().splitlines()[1:]] == [
        "| heuristic", "| model3, 3 training seeds", "| model3, 3 training seeds",
    ]  # fmt: skip
    base = runs.runs[HEURISTIC].pooled.total
    slipped = row(section(results, "conditions"), "heuristic", "`slippery`")
    assert points(Evaluation.load(results / "a_slippery_heuristic.json").total.held_over(base)) in slipped
    # A rate with another prior's postures is another model's.
    for path, prior in ((results / "a_slippery_heuristic.json", "a"), (results / "paper" / "heuristic.json", "b")):
        replace(Evaluation.load(path), model_metadata={"prior": prior}).save(path)
    assert row(section(results, "conditions"), "heuristic", "`slippery`")[-2:] == ["—", "—"]


def test_experiments_are_compared_with_their_model_under_the_same_conditions_only(results: Path) -> None:
    folder = results / "paper" / "experiments"
    better = trained("model3", 0, 0.97, 11)
    better.save(folder / "wider_networks.json")
    slippery = PAPER.with_physics("slippery", friction=0.5)
    trained("model3", 0, 0.5, 12, protocol=slippery).save(folder / "slippery.json")
    here = section(results, "experiments")
    runs = read_paper_runs(results / "paper")
    assert runs is not None
    over = points(better.total.held_over(runs.runs["model3"].by_seed[0].total))
    assert row(here, "wider networks")[3:8] == [
        "`paper`",
        str(better.n),
        words(better.held),
        words(better.faithful),
        over,
    ]
    assert row(here, "slippery")[3] == "`slippery`"
    assert row(here, "slippery")[7:] == ["—", "—"]
    assert "compared with |" not in here


def test_experiments_with_another_model_stand_beside_the_full_models(results: Path) -> None:
    folder = results / "paper" / "experiments"
    three, one = trained("model3", 0, 0.8, 11), trained("model1", 0, 0.5, 12)
    three.save(folder / "small.json")
    one.save(folder / "small_model1.json")
    trained("model1", 0, 0.6, 13).save(folder / "large_model1.json")
    here = section(results, "experiments")
    runs = read_paper_runs(results / "paper")
    assert runs is not None
    bases = {name: runs.runs[name].by_seed[0].total for name in ("model1", "model3")}
    single, paired = here.split("What the division")
    assert row(single, "small model1", "`model1`")[7] == points(one.total.held_over(bases["model1"]))
    assert row(single, "small", "`model3`")[7] == points(three.total.held_over(bases["model3"]))
    assert row(paired, "small", "`model1`")[4] == points(three.total.held_over(one.total))
    assert row(paired, "as above", "`model1`")[4] == points(bases["model3"].held_over(bases["model1"]))
    assert "large" not in paired


def test_notes_on_the_orderings_are_taken_over(results: Path) -> None:
    (results / "paper" / "notes.md").write_text("Because | of *that*.\n")
    assert "## What falls short of the paper, and why\n\nBecause | of *that*.\n" in page(results)


def with_another_protocol(folder: Path) -> None:
    trained("model2", 1, 0.9, protocol=PAPER.with_physics("paper", friction=0.5)).save(folder / "other.json")


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (with_another_protocol, "friction"),
        (lambda folder: trained("model3", 2, 0.9, 77).save(folder / "other.json"), "repeats training seed 2"),
        (lambda folder: evaluation(HEURISTIC, 77).save(folder / "other.json"), "repeats"),
        (lambda folder: trained("model3_opposition_frame", 0, 0.9).save(folder / "other.json"), "valid: heuristic"),
        (lambda folder: (folder / "other.json").write_text('{"rate": 0.9}'), "not an evaluation"),
    ],
)
def test_files_that_do_not_belong_in_one_table_are_refused(
    results: Path, spoil: Callable[[Path], object], word: str
) -> None:
    before = page(results)
    spoil(results / "paper")
    with pytest.raises(FileFormatError, match=word) as refusal:
        write_page(results, results.parent / "results.md")
    assert "other.json" in str(refusal.value)
    assert (results.parent / "results.md").read_text() == before


# --- training curves


def test_curves_are_read_as_training_writes_them(tmp_path: Path) -> None:
    fit = pytest.importorskip("graspcascade.studies.learn")
    sampler = GraspSampler.pretrained()
    records = tuple(EpochRecord(n, 3, 1e-3, 9.0 - n, 8.0 - n, 1.0, None if n < 3 else 5.0, 1.0) for n in (1, 2, 3))
    fit.FittedCascade(sampler, {stage.name: records for stage in sampler.factorization.stages}).save(tmp_path)
    result = TrainingCurves.load(tmp_path / fit.TRAINING_FILE)
    assert (result.model, result.seed) == ("model3", sampler.metadata["config"]["training"]["seed"])
    assert list(result.stages) == ["posture", "position", "rotation"]
    curves = result.stages["rotation"]
    assert curves.epoch == (1, 2, 3)
    assert curves.train_loss == (8.0, 7.0, 6.0)
    assert curves.validation_loss == (None, None, 5.0)


def test_the_last_epoch_of_every_stage_is_on_the_page(results: Path) -> None:
    save_curves(results, "plain_seed1", curves_json("plain_rotation", 1, rotation=0.25))
    data = curves_json("model3", epochs=10, rotation=-9.0)
    data["stages"]["rotation"]["validation_loss"] = [None] * 10
    save_curves(results, "model3", data)
    here = section(results, "training")
    assert row(here, "`model3`", "rotation")[2:] == ["0", "10", "-8", "-8", "-8", "—"]
    assert row(here, "`plain_rotation`", "rotation, plain output")[2:] == ["1", "20", "0.5", "0.5", "0.5", "1"]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: data.pop("seed"),
        lambda data: data.pop("stages"),
        lambda data: data["stages"].clear(),
        lambda data: data["stages"]["posture"].pop("train_kl"),
        lambda data: data["stages"]["posture"]["train_kl"].pop(),
        lambda data: data["stages"]["posture"].update(train_loss=[float("nan")] * 20),
        lambda data: data["stages"]["posture"].update(train_loss=["low"] * 20),
        lambda data: data.update(stages=[1]),
    ],
)
def test_foreign_curves_are_refused(results: Path, spoil: Callable[[dict[str, Any]], object]) -> None:
    data = curves_json("model3", posture=8.0)
    path = save_curves(results, "model3", data)
    assert read_training(path.parent)[0].model == "model3"
    spoil(data)
    save_curves(results, "model3", data)
    with pytest.raises(FileFormatError, match=r"model3\.json"):
        read_training(path.parent)


# --- pictures


@needs_drawing
def test_the_experiments_figures_are_drawn(results: Path, tmp_path: Path) -> None:
    save_curves(results, "model3", curves_json("model3", posture=8.0, position=1e-4, rotation=-9.0))
    written = evaluation_figures(results, tmp_path / "figures")
    names = ["heuristic", "paper_heuristic", "paper_model1", "paper_model2", "paper_model3"]
    assert [path.stem for path in written] == [*(f"success_{name}" for name in names), "training_curves"]
    assert all(0 < path.stat().st_size < MAX_BYTES for path in written)
    assert "](figures/success_paper_model3.png)" in page(results)


@needs_drawing
def test_equal_curves_share_a_line_and_scales_that_differ_have_panels_of_their_own(results: Path) -> None:
    for name, rotation in (("model3", -9.0), ("variant4", -8.0), ("plain_rotation", 0.1)):
        save_curves(results, name, curves_json(name, posture=8.0, rotation=rotation))
    save_curves(results, "model1", curves_json("model1", grasp=8.0))
    figure = training_figure(read_training(results / "paper" / "training"))
    lines = {axes.get_title(): sum(len(line.get_xdata()) > 0 for line in axes.lines) for axes in figure.axes}
    # A solid and a dotted line for each curve.
    assert lines == {"grasp": 2, "posture": 2, "rotation": 4, "rotation, plain output": 2}
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "model1", "model3", "plain_rotation", "variant4",
    ]  # fmt: skip
    posture = next(axes for axes in figure.axes if axes.get_title() == "posture")
    assert "plain_rotation, variant4" in posture.texts[0].get_text()
