"""Fitting a cascade: stages side by side, and the training curves that stay."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from graspcascade.cli.console import Bar
from graspcascade.cli.learning import Train, shows_epochs
from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import CATALOGUE
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.protocols import PAPER
from graspcascade.core.tasks import draw_tasks
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.hands import Hand
from graspcascade.nets import EpochRecord, TrainingSpec
from graspcascade.proposals.cascade.stages import FACTORIZATIONS
from graspcascade.proposals.heuristic import place
from graspcascade.proposals.prior import PosturePrior
from graspcascade.studies import executor, learn
from graspcascade.studies.dataset import Dataset
from graspcascade.studies.learn import CascadeTraining, FittedCascade, StageJob, fit_cascade

MODEL3 = FACTORIZATIONS["model3"]
TINY = CascadeTraining(training=TrainingSpec(epochs=2, batch_size=64, seed=5))


def all_held(grasps: Grasps) -> Outcomes:
    """Say of grasps that they held, with all digits touching."""
    blank = Outcomes.blank(len(grasps), len(grasps.joint_names))
    return dataclasses.replace(
        blank,
        verdict=np.full(len(grasps), "held"),
        touching_end=np.ones_like(blank.touching_end),
        object_size_m=grasps.side_m + 0.012,
    )


@pytest.fixture(scope="module")
def dataset(hand: Hand, prior: PosturePrior) -> Dataset:
    """Make a dataset of candidates that are said to have held."""
    rng = np.random.default_rng(0)
    kinds, objects = rng.choice(list(GRASP_TYPES), 200), rng.choice(list(CATALOGUE), 200)
    cells = [(CATALOGUE[name], GRASP_TYPES[kind]) for name, kind in zip(objects, kinds, strict=True)]
    grasps = place(hand, prior.sample(kinds, rng), draw_tasks(cells, 1, hand.reach_m, rng), rng)
    return Dataset(grasps, all_held(grasps), {"protocol": PAPER.to_json(), "seed": 0})


Told = list[tuple[str, EpochRecord]]


@pytest.fixture(scope="module")
def alone(hand: Hand, dataset: Dataset) -> tuple[FittedCascade, Told]:
    """Fit in this process and keep what is reported."""
    told: Told = []
    return fit_cascade(hand, dataset, MODEL3, TINY, lambda *report: told.append(report), workers=1), told


# -- side by side


def timeless(records: tuple[EpochRecord, ...]) -> list[EpochRecord]:
    return [dataclasses.replace(record, seconds=0.0) for record in records]


def test_the_number_of_workers_changes_no_bit_of_a_cascade(
    hand: Hand, dataset: Dataset, alone: tuple[FittedCascade, Told], tmp_path: Path
) -> None:
    told: Told = []
    fitted = fit_cascade(hand, dataset, MODEL3, TINY, lambda *report: told.append(report), workers=2)
    for path, cascade in ((tmp_path / "one", alone[0]), (tmp_path / "two", fitted)):
        cascade.save(path)
    for name in ("cascade.safetensors", "training.json"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    for stage in MODEL3.stages:
        assert [record for name, record in told if name == stage.name] == list(fitted.history[stage.name])
        assert timeless(fitted.history[stage.name]) == timeless(alone[0].history[stage.name])
    assert list(fitted.sampler.decoders) == [stage.name for stage in MODEL3.stages]


@pytest.mark.parametrize(
    ("name", "order"), [("model3", ["posture", "rotation", "position"]), ("model2", ["posture", "pose"])]
)
def test_the_longest_stage_is_begun_first(
    hand: Hand, dataset: Dataset, monkeypatch: pytest.MonkeyPatch, name: str, order: list[str]
) -> None:
    begun: list[str] = []

    def run_jobs(jobs: list[StageJob], workers: int, report: Callable[[int, EpochRecord], None]) -> Any:
        begun.extend(job.name for job in jobs)
        return run_in_processes(jobs, 1, report)

    run_in_processes = executor.run_jobs
    monkeypatch.setattr(learn, "run_jobs", run_jobs)
    fitted = fit_cascade(hand, dataset, FACTORIZATIONS[name], TINY)
    assert begun == order
    assert list(fitted.history) == [stage.name for stage in FACTORIZATIONS[name].stages]


def test_a_positions_weight_is_that_of_its_head_and_of_no_other(
    hand: Hand, dataset: Dataset, alone: tuple[FittedCascade, Told]
) -> None:
    light = dataclasses.replace(TINY, position_weight=0.5)
    fitted = fit_cascade(hand, dataset, MODEL3, light, workers=1).sampler
    heads = {name: [head.weight for head in decoder.spec.heads] for name, decoder in fitted.decoders.items()}
    assert heads == {"posture": [4.0], "position": [0.5], "rotation": [1.0]}
    for name, decoder in alone[0].sampler.decoders.items():
        other = fitted.decoders[name].arrays()
        same = [np.array_equal(array, other[key]) for key, array in decoder.arrays().items()]
        assert all(same) == (name != "position")


def test_a_negative_number_of_workers_is_refused(hand: Hand, dataset: Dataset) -> None:
    with pytest.raises(InputError, match="workers"):
        fit_cascade(hand, dataset, MODEL3, TINY, workers=-1)


def test_a_dataset_of_another_model_of_the_hand_is_refused(hand: Hand, dataset: Dataset) -> None:
    other = Dataset(dataset.grasps, dataset.outcomes, dataset.metadata | {"hand_fingerprint": "0123"})
    with pytest.raises(InputError, match="another model of the hand"):
        fit_cascade(hand, other, MODEL3, TINY)


@pytest.mark.parametrize(
    ("hand_name", "metadata", "message"),
    [("other_hand", {"protocol": PAPER.to_json()}, "of hand 'other_hand'"), (None, {}, "name the protocol")],
)
def test_what_does_not_suit_is_refused_before_the_training(
    hand: Hand, dataset: Dataset, hand_name: str | None, metadata: dict[str, Any], message: str
) -> None:
    grasps = dataclasses.replace(dataset.grasps, hand=hand_name or hand.name)
    with pytest.raises(InputError, match=message):
        fit_cascade(hand, Dataset(grasps, dataset.outcomes, metadata), MODEL3, TINY)


def test_errors_of_a_stage_arrive_as_they_are(hand: Hand, dataset: Dataset) -> None:
    wild = dataclasses.replace(TINY.training, learning_rate=1e30)
    with pytest.raises(FloatingPointError, match="lower the learning rate"):
        fit_cascade(hand, dataset, MODEL3, dataclasses.replace(TINY, training=wild), workers=1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"learn_from": "faithfull"}, "unknown choice of grasps to learn from 'faithfull'. Did you mean 'faithful'"),
        ({"object_pose": "setled"}, "unknown object pose to learn 'setled'. Did you mean 'settled'"),
        ({"most_repeats": 0}, "most_repeats must be at least 1, got 0"),
        ({"fingertip_error_m": 0.0}, "fingertip_error_m must be from 1e-09 to 1e[+]09, got 0.0"),
        ({"fingertip_error_m": -0.002}, "fingertip_error_m"),
        ({"fingertip_error_m": float("nan")}, "fingertip_error_m"),
        ({"fingertip_error_m": 1e-200}, "fingertip_error_m"),
        ({"fingertip_error_m": 1e200}, "fingertip_error_m"),
        ({"position_weight": 0.0}, "position_weight must be positive and finite, got 0.0"),
        ({"position_weight": float("inf")}, "position_weight"),
        ({"training": TrainingSpec(metric_weight=5.0)}, "follows from fingertip_error_m"),
    ],
)
def test_training_settings_that_cannot_be_used_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        CascadeTraining(**change)


# -- what stays


def test_the_training_curves_lie_beside_the_weights(alone: tuple[FittedCascade, Told], tmp_path: Path) -> None:
    fitted, _ = alone
    fitted.save(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"cascade.safetensors", "training.json"}
    curves = json.loads((tmp_path / "training.json").read_text())
    assert (curves["factorization"], curves["seed"], curves["learned_from"]) == ("model3", 5, 200)
    assert curves["config"] == json.loads(json.dumps(dataclasses.asdict(TINY)))
    assert {"graspcascade", "numpy", "torch", "python"} <= set(curves["versions"])
    assert list(curves["stages"]) == ["posture", "position", "rotation"]
    for name, records in fitted.history.items():
        for curve, values in curves["stages"][name].items():
            assert values == [getattr(record, curve) for record in records]
        assert curves["stages"][name]["epoch"] == [1, 2]


@pytest.fixture
def train(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], None]:
    """Run the command on the dataset."""
    monkeypatch.setattr("graspcascade.cli.learning.load_dataset", lambda _: dataset)
    one_epoch = dataclasses.replace(TINY, training=dataclasses.replace(TINY.training, epochs=1))
    return lambda out: Train(Path(), out, "model1", training=one_epoch, workers=1).run()


@pytest.mark.parametrize("there", [False, True])
def test_a_command_interrupted_while_it_writes_leaves_nothing_and_can_be_given_again(
    train: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: bool
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    out = tmp_path / "models" / "mine"
    if there:
        out.mkdir(parents=True)
    with monkeypatch.context() as patch:
        patch.setattr(learn, "write_json", interrupted)  # the weights come first
        with pytest.raises(KeyboardInterrupt):
            train(out)
    assert list(out.parent.iterdir()) == [out] * there
    assert not there or not any(out.iterdir())
    train(out)
    assert [path.name for path in out.parent.iterdir()] == ["mine"]
    assert {path.name for path in out.iterdir()} == {"cascade.safetensors", "training.json"}


def test_a_command_writes_where_a_link_points_to(train: Callable[[Path], None], tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "model").symlink_to(tmp_path / "disk")
    train(tmp_path / "model")
    assert (tmp_path / "model").is_symlink()
    assert {path.name for path in (tmp_path / "disk").iterdir()} == {"cascade.safetensors", "training.json"}


def test_a_folder_that_cannot_be_replaced_is_refused_before_the_training(
    train: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("graspcascade.cli.learning.fit_cascade", None)
    with pytest.raises(InputError, match="cannot be put in place"):
        train(Path())
    monkeypatch.setattr(Path, "is_mount", lambda path: path.name == "volume")
    (tmp_path / "volume").mkdir()
    with pytest.raises(InputError, match="volume cannot be put in place"):
        train(tmp_path / "volume")


# -- what is shown


class Shown(Bar):
    """Keep what a bar is told."""

    def __init__(self) -> None:
        super().__init__(None, None, "")
        self.states: list[tuple[int, int | None, str | None]] = []

    def show(self, done: int, total: int | None = None, note: str | None = None, title: str | None = None) -> None:
        self.states.append((done, total, note))


def test_one_bar_counts_the_epochs_of_all_stages_and_names_those_under_way() -> None:
    def record(epoch: int, loss: float, validation: float | None) -> EpochRecord:
        return EpochRecord(epoch, 2, 1e-3, loss, 0.0, 0.0, validation, 0.0)

    shown = Shown()
    show = shows_epochs(shown, 3)
    show("posture", record(1, 9.0, 8.5))
    show("rotation", record(1, -1.0, None))
    show("posture", record(2, 7.0, 6.5))
    show("position", record(1, 2.0, 2.25))
    assert shown.states == [
        (1, 6, "loss: posture 8.500"),
        (2, 6, "loss: posture 8.500, rotation -1.000"),
        (3, 6, "loss: posture 6.500, rotation -1.000"),
        (4, 6, "loss: rotation -1.000, position 2.250"),
    ]
