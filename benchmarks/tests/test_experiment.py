"""The paper's experiment as it is run: its settings as data, and models that are trained once and never mixed."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.paper import data_card, experiment, settings
from benchmarks.paper.published import PAPER_MODELS
from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.outcomes import Outcomes
from graspcascade.engines.mujoco.runner import MujocoEngine
from graspcascade.hands import Hand
from graspcascade.nets import TrainingSpec
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.cascade.stages import FACTORIZATIONS
from graspcascade.proposals.heuristic import HEURISTIC, Heuristic
from graspcascade.proposals.prior import PosturePrior
from graspcascade.studies.collect import CollectionSpec, collect
from graspcascade.studies.dataset import load_dataset, read_metadata
from graspcascade.studies.learn import CascadeTraining


def test_every_model_of_the_paper_is_run_and_trained_alike() -> None:
    runs = settings.paper_runs()
    assert len({run.name for run in runs}) == len(runs) == 19
    assert {run.model for run in runs} == set(PAPER_MODELS)
    trained = [run.trained for run in runs if run.trained is not None]
    for one in trained:
        assert one.factorization is FACTORIZATIONS[one.factorization.name]
        alike = replace(one.training, training=replace(one.training.training, seed=0))
        assert alike == CascadeTraining()
    for run in runs:
        assert run.per_cell == 500
        assert (run.trained is None) == (run.model == HEURISTIC)
        assert run.seed == (0 if run.trained is None else run.trained.training.training.seed)


def changes(run: Any, usual: Any) -> int:
    return sum(
        (
            run.size_mode != usual.size_mode,
            run.trained.factorization != usual.trained.factorization,
            run.trained.training != usual.trained.training,
            run.trained.trials_per_cell is not None,
        )
    )


def test_an_experiment_changes_one_of_the_papers_models_in_one_respect() -> None:
    usual = {run.name: run for run in settings.paper_runs()}
    runs = settings.experiments()
    assert len({run.name for run in runs}) == len(runs)
    (screened,) = [run for run in runs if run.trained is None]
    assert screened.model == HEURISTIC
    assert screened.screened
    assert not usual[HEURISTIC].screened
    for run in (run for run in runs if run.trained is not None):
        base = next((model for model in ("model1", "model2") if run.name.endswith(f"_{model}")), "model3")
        assert run.model in {base, f"{base}_opposition_frame"}
        assert run.per_cell == 100
        result = changes(run, usual[f"{base}_seed0"])
        assert result == (2 if run.name.startswith(settings.PLAIN) else 1), run.name


def test_what_is_changed_of_another_model_is_changed_of_model3_too() -> None:
    runs = {run.name: run for run in settings.experiments()}
    others = [run for run in runs.values() if run.model in {"model1", "model2"}]
    assert {run.model for run in others} == {"model1", "model2"}
    for one in others:
        three = runs[one.name.removesuffix(f"_{one.model}")]
        assert one.trained is not None
        assert three.trained is not None
        assert (one.size_mode, one.trained.trials_per_cell) == (three.size_mode, three.trained.trials_per_cell)
        assert one.trained.training == three.trained.training


def all_held(grasps: Grasps) -> Outcomes:
    blank = Outcomes.blank(len(grasps), len(grasps.joint_names))
    return replace(
        blank,
        verdict=np.full(len(grasps), "held"),
        touching_end=np.ones_like(blank.touching_end),
        object_size_m=grasps.side_m + 0.012,
    )


SPEC = CollectionSpec(trials_per_cell=3, round_per_cell=3, seed=2)
TINY = CascadeTraining(training=TrainingSpec(epochs=1, batch_size=64))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory, hand: Hand, prior: PosturePrior) -> Path:
    """Collect candidates that are said to have held."""
    folder = tmp_path_factory.mktemp("experiment") / "data"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MujocoEngine, "run", lambda _, hand, grasps, *__, **___: all_held(grasps))
        collect(Heuristic(hand, prior), SPEC, folder)
    return folder


def test_a_model_is_trained_once_and_refused_for_other_settings_or_data(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = experiment.Arguments(data=data, out=tmp_path / "runs", results=tmp_path / "results", train_only=True)
    wanted = settings.Trained("small", FACTORIZATIONS["model3"], TINY)

    def make(trained: Any, **changes: Any) -> None:
        experiment.Experiment(replace(arguments, **changes)).make(settings.Run(trained.name, trained))

    make(wanted)
    weights = (tmp_path / "runs/models/small/cascade.safetensors").read_bytes()
    curves = json.loads((tmp_path / "results/training/small.json").read_text())
    assert curves["learned_from"] == 54 * SPEC.trials_per_cell
    monkeypatch.setattr(experiment, "fit_cascade", None)  # training again would fail
    make(wanted)
    assert (tmp_path / "runs/models/small/cascade.safetensors").read_bytes() == weights
    with pytest.raises(InputError, match="other settings"):
        make(replace(wanted, training=replace(TINY, fingertip_error_m=0.001)))
    with pytest.raises(InputError, match="other settings"):
        make(replace(wanted, factorization=FACTORIZATIONS["variant4"]))
    with pytest.raises(InputError, match="another dataset"):
        make(replace(wanted, trials_per_cell=2))
    shutil.copytree(data, tmp_path / "other")
    about = json.loads((tmp_path / "other/metadata.json").read_text())
    about["shards"][0]["sha256"] = "b"
    (tmp_path / "other/metadata.json").write_text(json.dumps(about))
    with pytest.raises(InputError, match="another dataset"):
        make(wanted, data=tmp_path / "other")


def test_a_model_may_learn_from_the_first_trials_of_each_cell(data: Path, tmp_path: Path) -> None:
    whole, about = load_dataset(data), read_metadata(data)
    few = experiment.first_trials(whole, 2)
    assert len(few.grasps) == experiment.trials_used(about, 2) == 54 * 2
    assert experiment.trials_used(about, None) == experiment.trials_used(about, 9) == len(whole.grasps) == 54 * 3
    cells = list(zip(whole.grasps.object_name.tolist(), whole.grasps.grasp_type.tolist(), strict=True))
    first = [row for row, cell in enumerate(cells) if cells[:row].count(cell) < 2]
    np.testing.assert_array_equal(few.grasps.posture, whole.grasps.posture[first])
    arguments = experiment.Arguments(data=data, out=tmp_path / "runs", results=tmp_path / "results", train_only=True)
    run = settings.Run("few", settings.Trained("few", FACTORIZATIONS["model1"], TINY, trials_per_cell=2))
    experiment.Experiment(arguments).make(run)
    assert GraspSampler.load(tmp_path / "runs/models/few").metadata["learned_from"] == 54 * 2


# The dataset's card


@pytest.fixture(scope="module")
def card(data: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    out = tmp_path_factory.mktemp("card") / "card.json"
    data_card.main(data_card.Arguments(data, out, scaling=out.with_name("scaling.json"), trials=(100, 10_000)))
    (run,) = json.loads(out.with_name("scaling.json").read_text())["runs"]
    assert (run["trials"], run["held"]) == (162, 162)
    return dict(json.loads(out.read_text()))


def test_a_card_says_what_a_dataset_holds(card: dict[str, Any], data: Path) -> None:
    about = read_metadata(data)
    assert card["command"] == "graspcascade collect --out data --trials-per-cell 3 --round-per-cell 3 --seed 2"
    assert (card["trials"], card["held"], card["given_up"]) == (162, 162, [])
    assert len(card["cells"]) == 54
    assert card["cells"][0]["held rate"]["rate"] == 1.0
    assert card["shards"] == [{key: about["shards"][0][key] for key in ("file", "rows", "sha256")}]
    assert "abridged" in card["description"]
    assert card["versions"] == about["versions"]


def test_a_cards_command_tells_what_was_asked_in_turn_of_which_prior(data: Path) -> None:
    about = read_metadata(data)
    first = about | {"prior": "mine", "creep_projection": None}
    words = "graspcascade collect --out data --prior prior.safetensors --trials-per-cell 3 --round-per-cell 3"
    assert data_card.commands(first) == f"{words} --seed 2 --full"
    later = about | {"asked_before": [{"rounds": 1, "collection": about["collection"] | {"trials_per_cell": 2}}]}
    assert data_card.commands(later).startswith("graspcascade collect --out data --trials-per-cell 2 ")
    assert data_card.commands(later).endswith(f", then {data_card.commands(about)}")
    short = about | {"collection": about["collection"] | {"successes_per_cell": 4}}
    assert len(data_card.given_up(short)) == 54
    assert not data_card.given_up(about)
