"""The bench: real runs of everything at the smallest size, and the arithmetic on numbers given by hand."""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.common import Spread, collection_grasps, evaluation_grasps, shipped_heuristic
from benchmarks.speed import bench, trial_speed
from benchmarks.speed.bench import PARTS, BenchSpec, run_bench
from benchmarks.speed.page import AIMS, aims_table, fill_page, filled, measured
from benchmarks.speed.sampling import matrix_products
from benchmarks.speed.training import FACTORIZATION, Timed, makespan, planned_epochs, training, training_rows
from benchmarks.speed.trials import Count, RawEngine, Repetition, Workload, collection, interleave
from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.files import write_json
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import as_object
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.protocols import PAPER, Protocol
from graspcascade.core.taxonomy import as_type
from graspcascade.engines import run_trials
from graspcascade.engines.mujoco.idle import idle_sets
from graspcascade.hands import Hand
from graspcascade.nets import TrainingSpec
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.cascade.stages import factorization
from graspcascade.proposals.heuristic import Heuristic, cannot_touch
from graspcascade.studies.dataset import Dataset
from graspcascade.studies.learn import CascadeTraining
from graspcascade.worlds.world import shared_world

CELLS = ((as_object("sphere_small"), as_type("tripod")), (as_object("box_medium"), as_type("tip_pinch")))
NAMES = [(obj.name, kind.name) for obj, kind in CELLS]
SMALL = BenchSpec(
    collection_per_cell=1,
    evaluation_per_cell=1,
    raw_per_cell=1,
    repetitions=1,
    threads=1,
    sample_calls=2,
    cold_starts=1,
    training_rows=200,
    training_epochs=2,
)
TIMES = st.floats(0.01, 1e4)


@pytest.fixture(scope="module")
def heuristic() -> Heuristic:
    return shipped_heuristic()


# The raw engine


def test_a_full_length_trial_is_1925_steps() -> None:
    assert PAPER.schedule.total_steps == 1925


def test_raw_trials_are_those_of_the_runner_in_the_unreduced_world(heuristic: Heuristic, short: Protocol) -> None:
    engine = RawEngine(heuristic.hand, evaluation_grasps(heuristic, 2, 1, CELLS), short)
    seen: dict[int, np.ndarray] = {}

    def observe(rows: np.ndarray, steps: np.ndarray, _: np.ndarray, poses: np.ndarray) -> None:
        ended = steps == short.schedule.total_steps
        seen.update({int(row): pose.copy() for row, pose in zip(rows[ended], poses[ended], strict=True)})

    outcomes = run_trials(engine.grasps, short, n_threads=1, n_slots=1, reduced=False, observe=observe)
    assert outcomes.held.any()
    assert seen
    for row, pose in seen.items():
        np.testing.assert_allclose(engine.execute(row), pose, atol=1e-9)


def test_the_raw_engine_steps_every_trial_of_all_joints_to_its_end(heuristic: Heuristic, short: Protocol) -> None:
    engine = RawEngine(heuristic.hand, evaluation_grasps(heuristic, 3, 0, CELLS), short)
    assert engine.steps == 6 * short.schedule.total_steps
    assert {task.cell for task in engine.grasps.tasks} == set(NAMES)
    assert engine.measure(2) > 0.0


# Gains


def test_a_gain_compares_with_the_raw_engine_on_either_side() -> None:
    one = Repetition(Count(trials=300, held=150), seconds=10.0, raw_before=19_250.0, raw_after=57_750.0)
    assert one.trials_per_s == 30.0
    assert one.held_per_s == 15.0
    assert one.gain == pytest.approx(30.0 / 20.0)


@given(st.integers(1, 1000), TIMES, TIMES, TIMES, st.floats(0.1, 10.0))
def test_a_gain_does_not_depend_on_how_fast_the_machine_is(
    trials: int, seconds: float, before: float, after: float, speed: float
) -> None:
    one = Repetition(Count(trials, 0), seconds, before, after)
    other = Repetition(Count(trials, 0), seconds / speed, before * speed, after * speed)
    assert one.gain == pytest.approx(other.gain)


def test_workloads_take_turns_each_between_two_measurements_of_the_raw_engine() -> None:
    begun: list[str] = []
    slow, fast = count(100.0, 100.0), count(1000.0, 1000.0)
    clock: Iterator[int] = count()

    def workload(trials: int) -> Workload:
        return lambda _: Count(trials, 1)

    def begin(name: str) -> Callable[[str], None]:
        begun.append(name)
        return lambda _: None

    workloads = {"a": (lambda: next(slow), workload(5)), "b": (lambda: next(fast), workload(7))}
    result = interleave(workloads, 2, begin, lambda: float(next(clock)))
    assert begun == ["raw engine", "a", "raw engine", "raw engine", "b", "raw engine"] * 2
    assert [(one.raw_before, one.raw_after) for one in result.repetitions["a"]] == [(100.0, 200.0), (300.0, 400.0)]
    assert [(one.raw_before, one.raw_after) for one in result.repetitions["b"]] == [(1e3, 2e3), (3e3, 4e3)]
    assert result.to_json("a")["trials_per_s"] == {"median": 5.0, "min": 5.0, "max": 5.0}
    assert result.to_json("a")["raw_steps_per_s"] == {"median": 250.0, "min": 100.0, "max": 400.0}
    assert [one["gain"] for one in result.to_json("a")["values"]] == pytest.approx([5 * 1925 / 150, 5 * 1925 / 350])


def test_the_raw_engine_executes_grasps_of_the_kind_it_is_compared_with(heuristic: Heuristic) -> None:
    drawn = collection_grasps(heuristic, 2, 0)
    assert len(drawn) == 108
    assert not cannot_touch(heuristic.hand, drawn).any()
    asked = evaluation_grasps(GraspSampler.pretrained(), 3, 0, CELLS)
    assert [task.cell for task in asked.tasks] == [cell for cell in NAMES for _ in range(3)]


@given(st.lists(TIMES, min_size=1))
def test_a_spread_holds_its_values(values: list[float]) -> None:
    result = Spread.of(values)
    assert result.min <= result.median <= result.max
    assert {result.min, result.max} <= set(values)


# Training


@given(st.lists(TIMES, min_size=1, max_size=6), st.integers(1, 4))
def test_jobs_take_no_less_than_the_longest_and_their_share(jobs: list[float], workers: int) -> None:
    result = makespan(jobs, workers)
    assert result >= max(*jobs, sum(jobs) / workers) * (1 - 1e-12)
    assert result <= sum(jobs) * (1 + 1e-12)


def test_training_is_extended_by_the_epochs_on_the_longest_way() -> None:
    timed = Timed(seconds=100.0, epochs=3, epoch_s={"posture": 5.0, "position": 1.0, "rotation": 3.0})
    assert timed.extrapolated(3, workers=2) == 100.0
    assert timed.extrapolated(20, workers=2) == 100.0 + 17 * 5.0
    assert timed.extrapolated(20, workers=1) == 100.0 + 17 * 9.0


def test_planned_epochs_are_those_of_the_training_loop() -> None:
    assert planned_epochs(CascadeTraining().training, 270_000) == (20, 500)
    assert planned_epochs(TrainingSpec(epochs=7, batch_size=4096), 100) == (7, 1)


@pytest.mark.parametrize("data", [None, Path("data")])
def test_rows_to_train_on_are_all_successes(
    data: Path | None, drawn: Grasps, outcomes: Outcomes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmarks.speed.training.load_dataset", lambda _: Dataset(drawn, outcomes, {}))
    dataset, source = training_rows(data, 250, seed=0)
    assert len(dataset.grasps) == len(dataset.outcomes) == 250
    assert dataset.outcomes.faithful(dataset.grasps).all()
    assert ("dataset" in source) == (data is not None)


def test_a_dataset_without_successes_is_refused(
    drawn: Grasps, outcomes: Outcomes, monkeypatch: pytest.MonkeyPatch
) -> None:
    failed = replace(outcomes, verdict=np.full(len(drawn), "missed"))
    monkeypatch.setattr("benchmarks.speed.training.load_dataset", lambda _: Dataset(drawn, failed, {}))
    with pytest.raises(InputError, match="no type-faithful grasps"):
        training_rows(Path("data"), 10, seed=0)


# Whole runs at the smallest size


def test_a_collection_is_counted_and_leaves_nothing(
    heuristic: Heuristic, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    told: list[str] = []
    result = collection(heuristic, per_cell=1, seed=0, n_threads=0)(told.append)
    assert result.trials == 54
    assert 0 < result.held < 54
    assert told[-1] == "54 of 54 trials"
    assert not list(tmp_path.iterdir())


def test_trial_parts_are_measured_against_the_raw_engine() -> None:
    heard: list[tuple[int, int, str]] = []
    result = run_bench(
        SMALL,
        ["raw", "evaluation", "evaluation_heuristic"],
        cells=CELLS,
        report=lambda done, total, what: heard.append((done, total, what)),
    )
    assert set(result) == {"environment", "settings", "repetitions", "raw", "evaluation", "evaluation_heuristic"}
    assert len(result["raw"]["values"]) == 1
    for part in ("evaluation", "evaluation_heuristic"):
        assert result[part]["trials"] == result[part]["raw_trials"] == len(CELLS)
        assert result[part]["steps_per_trial"] == 1925
        assert set(result[part]["gain"]) == {"median", "min", "max"}
        (one,) = result[part]["values"]
        raw = (one["raw_before_steps_per_s"] + one["raw_after_steps_per_s"]) / 2
        assert result[part]["gain"]["median"] == pytest.approx(len(CELLS) / one["seconds"] * 1925 / raw)
    assert {total for _, total, _ in heard} == {7}
    assert [done for done, _, _ in heard] == sorted(done for done, _, _ in heard)
    assert heard[-1][0] == 7


def test_sampling_and_cold_start_are_written_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "bench.json"
    settings = ["--sample-calls", "2", "--cold-starts", "1", "--threads", "1"]
    assert bench.run(["--only", "sampling", "cold_start", *settings, "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result == json.loads(out.read_text())
    assert {"cpu", "logical_cores", "versions", "threads"} <= set(result["environment"])
    assert {"ms", "yardstick_ms", "ratio"} <= set(result["sampling"])
    assert {"s", "yardstick_s", "ratio"} <= set(result["cold_start"])
    for value in (result["sampling"]["ratio"], result["cold_start"]["ratio"]):
        assert value > 0.0


def test_training_is_measured_in_part_and_extended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.speed.training._YARDSTICK_STEPS", 3)
    part = run_bench(SMALL, ["training"])["training"]
    assert part["extrapolated"]
    assert (part["epochs_measured"], part["epochs"]) == (2, 80)
    assert set(part["epoch_s"]) == {"posture", "position", "rotation"}
    assert part["s"] == pytest.approx(part["measured_s"] + 78 * sum(part["epoch_s"].values()))
    assert part["ratio"] == pytest.approx(part["s"] / part["yardstick_s"])


@pytest.mark.parametrize("threads", [1, 2, 3, 64])
def test_the_yardstick_of_training_is_shared_among_those_who_train(
    threads: int, hand: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One worker a stage is all that training can keep busy, so that many times the threads divide nothing more."""
    stages = [stage.name for stage in factorization(FACTORIZATION).stages]
    asked: list[int] = []

    def products(*of: object) -> float:
        asked.append(int(str(of[-1])))
        return 1.0

    def fit(*of: object) -> Timed:
        asked.append(int(str(of[-2])))
        return Timed(1.0, 2, dict.fromkeys(stages, 1.0))

    monkeypatch.setattr("benchmarks.speed.training.products_seconds", products)
    monkeypatch.setattr("benchmarks.speed.training._fit", fit)
    dataset, _ = training_rows(None, 100, seed=0)
    result = training(hand, dataset, epochs_measured=2, workers=threads)
    assert asked == [min(threads, len(stages))] * 3
    assert result["workers"] == min(threads, len(stages))


def test_timing_the_parts_of_a_step_leaves_the_runners_worlds_alone(
    monkeypatch: pytest.MonkeyPatch, hand: Hand, drawn: Grasps, outcomes: Outcomes
) -> None:
    some = drawn[outcomes.held][:2]
    monkeypatch.setattr(trial_speed, "collection_grasps", lambda *_: some)
    monkeypatch.setattr(trial_speed, "_least", lambda *_: 1.0)
    assert {row["step_us"] for row in trial_speed.step_parts(trial_speed.Arguments())} == {1.0}
    for obj in some.tasks.objects.values():
        for without in ((), *idle_sets(hand)):
            option = shared_world(hand, obj, PAPER.physics, True, without).model.opt
            assert not option.gravity.any()
            assert not option.disableflags & int(mujoco.mjtDisableBit.mjDSBL_SENSOR)


def test_the_yardstick_of_sampling_does_every_layer(monkeypatch: pytest.MonkeyPatch) -> None:
    shapes: list[tuple[int, ...]] = []
    decoders = GraspSampler.pretrained().decoders
    products = matrix_products(decoders, 5)
    monkeypatch.setattr("numpy.matmul", lambda a, b, out: shapes.append((*a.shape, *b.shape)))
    products()
    widths = [layer.matrix.shape for d in decoders.values() for layer in d.layers]
    assert shapes == [(5, width[0], *width) for width in widths]


# Bad input


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert bench.run(list(arguments)) == 2
    said = capsys.readouterr()
    assert not said.out
    assert len(said.err.splitlines()) == 1
    return said.err


def test_what_cannot_be_measured_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    said = refused(capsys, "--only", "colection")
    assert "Did you mean 'collection'?" in said
    assert all(part in said for part in PARTS)
    assert "repetitions must be at least 1, got 0" in refused(capsys, "--repetitions", "0")
    assert "training-epochs must be at least 2" in refused(capsys, "--training-epochs", "1")
    assert ".json file, got 'bench.txt'" in refused(capsys, "--out", str(tmp_path / "bench.txt"))
    assert "not a graspcascade dataset" in refused(capsys, "--only", "training", "--data", str(tmp_path))


def test_missing_packages_are_asked_for_before_anything_is_measured(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("graspcascade.cli.console.find_spec", lambda _: None)
    assert "'.[train]'" in refused(capsys)


# The page

PAGE = "# Speed\n\nBefore.\n\n<!-- generated: bench -->\nold\n<!-- end -->\n\nAfter.\n"


@pytest.fixture
def numbers() -> dict[str, object]:
    spread = {"median": 2.0, "min": 1.0, "max": 3.0}
    rates: dict[str, Any] = dict.fromkeys(("trials_per_s", "held_per_s", "gain", "raw_steps_per_s"), spread)
    rates |= {"trials": 54, "round_per_cell": 1, "raw_trials": 54, "steps_per_trial": 1925}
    about = {"cpu": "a processor", "logical_cores": 2, "threads": 2, "system": "an OS", "versions": {"mujoco": "3"}}
    return {
        "environment": about,
        "repetitions": 3,
        "raw": {"steps_per_s": spread, "stepping": "a loop"},
        "collection": rates | {"peak_rss_mb": 321.0},
    }


def test_a_page_is_filled_from_files_and_keeps_its_text(tmp_path: Path, numbers: dict[str, object]) -> None:
    page = tmp_path / "performance.md"
    page.write_text(PAGE)
    (tmp_path / "bench.json").write_text(json.dumps(numbers))
    fill_page(page, tmp_path)
    text = page.read_text()
    assert "old" not in text
    assert text.startswith("# Speed\n\nBefore.\n")
    assert text.endswith("\nAfter.\n")
    assert "2.00 [1.00, 3.00]" in text
    assert "321 MB" in text
    fill_page(page, tmp_path)
    assert page.read_text() == text


def test_a_page_says_what_is_missing(tmp_path: Path) -> None:
    assert "There is no" in filled(PAGE, tmp_path)
    with pytest.raises(InputError, match="Did you mean 'bench'"):
        filled(PAGE.replace("bench", "benhc"), tmp_path)
    (tmp_path / "bench.json").write_text("{}")
    with pytest.raises(FileFormatError, match=r"bench\.json lacks or garbles 'environment'"):
        filled(PAGE, tmp_path)


def test_aims_are_judged_by_the_figures_that_they_name(tmp_path: Path) -> None:
    def words() -> dict[str, list[str]]:
        rows = [[cell.strip() for cell in line.strip("| ").split("|")] for line in aims_table(tmp_path).splitlines()]
        return {cells[0]: cells[1:] for cells in rows}

    assert all(cells[1:] == ["not measured", "—", "—"] for cells in list(words().values())[2:])
    (tmp_path / "performance").mkdir()
    bench = {
        "collection": {
            "gain": {"median": 2.94, "min": 2.9, "max": 3.1},
            "trials_per_s": {"median": 75.5, "min": 74, "max": 76},
        },
        "cold_start": {"s": {"median": 0.38, "min": 0.3, "max": 0.4}},
        "training": {"s": 128.7, "extrapolated": True},
    }
    write_json(tmp_path / "performance/bench.json", bench)
    scaling = {"runs": [{"peak_rss_mb": 100.0}, {"peak_rss_mb": 2001.0}]}
    write_json(tmp_path / "performance/collection_scaling.json", scaling)
    compared = [
        {"grasps": "model3", "executed": way, "agreement": {"rate": share, "low": share - 0.001, "high": 1}}
        for way, share in (("steps of 1 ms", 0.9), ("abridged as in a collection", 0.99495))
    ]
    write_json(tmp_path / "verdict_agreement.json", {"comparisons": compared})
    result = words()
    assert result["collection, gain"] == ["at least 3", "2.94", "2.9, 3.1", "**no**"]
    assert result["collection, trials a second"][2:] == ["74, 76", "yes, but for the worse end"]
    assert result["training of a cascade"][1:] == ["128.7 s, extrapolated", "—", "yes"]
    assert result["`graspcascade sample`, cold"] == ["at most 0.7 s", "0.38 s", "0.3, 0.4", "yes"]
    assert result["peak memory of the largest collection"] == ["at most 2000 MB", "2001 MB", "—", "**no**"]
    assert result["abridged verdicts that agree, Model 3"] == ["at least 99.5 %", "99.495 %", "99.395, 100", "**no**"]
    assert result["abridged verdicts that agree, heuristic"][1] == "not measured"


def test_every_aim_is_measured_in_the_committed_files() -> None:
    results = Path(__file__).parents[2] / "docs/results"
    assert len({aim.what for aim in AIMS}) == len(AIMS)
    assert all(measured(results, aim) is not None for aim in AIMS)


def test_the_performance_page_is_up_to_date() -> None:
    docs = Path(__file__).parents[2] / "docs"
    text = (docs / "performance.md").read_text(encoding="utf-8")
    assert text.count("<!-- generated: ") == 5
    assert filled(text, docs / "results/performance") == text
