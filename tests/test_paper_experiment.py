"""The paper's experiment as it is run: its settings as data, and models that are trained once and never mixed."""

import importlib.util
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from graspcascade.cascade import FACTORIZATIONS, GraspSampler
from graspcascade.cascade.fit import TRAINING_FILE
from graspcascade.cascade.material import CascadeTraining
from graspcascade.cascade.sampler import shipped_folder
from graspcascade.errors import InputError
from graspcascade.evaluation import HEURISTIC
from graspcascade.report.published import PAPER_MODELS

FOLDER = Path(__file__).parents[1] / "benchmarks"


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def modules() -> Iterator[tuple[Any, Any]]:
    names = ("paper_settings", "paper_experiment")
    yield load(names[0]), load(names[1])
    for name in names:
        del sys.modules[name]


def test_every_model_of_the_paper_is_run_and_trained_alike(modules: tuple[Any, Any]) -> None:
    runs = modules[0].paper_runs()
    assert len({run.name for run in runs}) == len(runs) == 17
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


def test_an_experiment_changes_one_of_the_papers_models_in_one_respect(modules: tuple[Any, Any]) -> None:
    usual = {run.name: run for run in modules[0].paper_runs()}
    runs = modules[0].experiments()
    assert len({run.name for run in runs}) == len(runs)
    for run in runs:
        base = "model1" if run.name.endswith("_model1") else "model3"
        assert run.model in {base, f"{base}_opposition_frame"}
        assert run.per_cell == 100
        found = changes(run, usual[f"{base}_seed0"])
        assert found == (2 if run.name.startswith(modules[0].AS_PRINTED) else 1), run.name


def test_what_is_changed_of_model1_is_changed_of_model3_too(modules: tuple[Any, Any]) -> None:
    runs = {run.name: run for run in modules[0].experiments()}
    pairs = [(run, runs[name.removesuffix("_model1")]) for name, run in runs.items() if name.endswith("_model1")]
    assert pairs
    for one, three in pairs:
        assert (one.size_mode, one.trained.trials_per_cell) == (three.size_mode, three.trained.trials_per_cell)
        assert one.trained.training == three.trained.training


def test_a_model_is_trained_once_and_refused_for_other_settings_or_data(
    modules: tuple[Any, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, script = modules
    data = tmp_path / "data"
    data.mkdir()
    (data / "metadata.json").write_text(json.dumps({"shards": [{"sha256": "a"}]}))
    fitted = []

    def fit(self: Any, wanted: Any, folder: Path) -> None:
        fitted.append(wanted.name)
        shipped = GraspSampler.load(shipped_folder())
        about = {"config": asdict(wanted.training), "dataset": {"shards": script.shards_digest(metadata())}}
        replace(shipped, factorization=wanted.factorization, metadata=about).save(folder)
        (folder / TRAINING_FILE).write_text("{}")

    def metadata() -> Any:
        return json.loads((data / "metadata.json").read_text())

    monkeypatch.setattr(script.Experiment, "_fit", fit)
    monkeypatch.setattr(script, "read_metadata", lambda _: metadata())
    arguments = script.Arguments(data=data, out=tmp_path / "runs", results=tmp_path / "results", train_only=True)
    run = next(run for run in settings.paper_runs() if run.name == "model3_seed0")
    script.Experiment(arguments).make(run)
    script.Experiment(arguments).make(run)
    assert fitted == ["model3_seed0"]
    assert (tmp_path / "results" / "training" / "model3_seed0.json").is_file()
    longer = replace(run.trained, training=CascadeTraining(fingertip_error_m=0.001))
    with pytest.raises(InputError, match="other settings"):
        script.Experiment(arguments).make(replace(run, trained=longer))
    (data / "metadata.json").write_text(json.dumps({"shards": [{"sha256": "b"}]}))
    with pytest.raises(InputError, match="another dataset"):
        script.Experiment(arguments).make(run)
