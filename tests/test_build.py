"""The whole chain in small: what is made, that it goes on where it was cut off, and that it is the same again."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from graspcascade.cli import main
from graspcascade.cli.console import Bar
from graspcascade.core.errors import InputError
from graspcascade.core.files import sole_writer
from graspcascade.hands import load_hand
from graspcascade.nets import TrainingSpec
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.ranked import Ranked
from graspcascade.proposals.scorer import Scorer
from graspcascade.studies.build import Build, BuildSpec
from graspcascade.studies.dataset import load_dataset
from graspcascade.studies.learn import CascadeTraining
from graspcascade.studies.record import Evaluation
from graspcascade.studies.scoring import ScorerTraining
from graspcascade.studies.seeds import FEIX_SEEDS

HAND = load_hand("shadow")
BRIEF = TrainingSpec(epochs=2, batch_size=64, validation_fraction=0.0)
TINY = BuildSpec(
    seeds=replace(FEIX_SEEDS, per_type=8, most_draws=4),
    prior=replace(BRIEF, epochs=2000, metric_weight=1.0 / 0.002**2),
    trials_per_cell=(60, 12),
    cascade=CascadeTraining(learn_from="held", training=BRIEF),
    least_chance=0.0,
    scorer=ScorerTraining(hidden=(16,), training=BRIEF),
    evaluation_per_cell=2,
)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("build")
    Build(HAND, folder, TINY, workers=1).run()
    return folder


def test_a_build_leaves_every_product_of_its_steps(built: Path) -> None:
    for name in ("seeds.csv", "prior.safetensors", "round-1", "model-1", "round-2", "model-2"):
        assert (built / name).exists(), name
    for number, runs in ((1, ("raw-hold", "ranked-hold")), (2, ("raw-hold", "ranked-hold", "ranked-varied"))):
        for run in runs:
            evaluation = Evaluation.load(built / f"evaluation-{number}-{run}" / "evaluation.json")
            assert evaluation.n == 2 * 18, "three kinds of object and six types"


def test_what_was_built_proposes_grasps_of_any_size_with_their_chances(built: Path) -> None:
    ranked = Ranked(GraspSampler.load(built / "model-2"), Scorer.load(built / "model-2"))
    grasps = ranked.sample("tripod", "box:23x37x61mm", n=5)
    assert np.isfinite(grasps.probability).all()
    assert {kind.taxonomy for kind in ranked.grasp_types} == {"feix"}


def test_a_build_that_was_cut_off_goes_on_to_the_same_model(built: Path, tmp_path: Path) -> None:
    before = GraspSampler.load(built / "model-2").fingerprint(), Scorer.load(built / "model-2").fingerprint()
    shutil.copytree(built, tmp_path / "cut")
    for name in ("model-2", "evaluation-2-raw-hold"):
        shutil.rmtree(tmp_path / "cut" / name)
    (tmp_path / "cut" / "round-2" / "part-00000.parquet").unlink()
    steps: set[str] = set()
    Build(HAND, tmp_path / "cut", TINY, workers=1, report=lambda step, done, total: steps.add(step)).run()
    after = (cls.load(tmp_path / "cut" / "model-2").fingerprint() for cls in (GraspSampler, Scorer))
    assert tuple(after) == before
    assert not steps & {"seeds", "prior", "cascade after round 1", "scorer after round 1"}


@pytest.mark.parametrize(
    ("change", "was"), [({"seed": 5}, "seed 0"), ({"trials_per_cell": (60, 13)}, r"trials_per_cell \[60, 12\]")]
)
def test_other_arguments_do_not_go_on_with_a_build(built: Path, change: dict[str, Any], was: str) -> None:
    with pytest.raises(InputError, match=f"another build, with {was};"):
        Build(HAND, built, replace(TINY, **change)).run()
    with pytest.raises(InputError, match="another build, with hand shadow_hand_right"):
        Build(replace(HAND, name="mine"), built, TINY).run()


def test_a_build_in_a_foreign_folder_or_one_that_is_written_to_is_refused(built: Path, tmp_path: Path) -> None:
    (tmp_path / "seeds.csv").write_text("mine")
    with pytest.raises(InputError, match="holds something else"):
        Build(HAND, tmp_path, TINY).run()
    with sole_writer(built), pytest.raises(InputError, match="another process is writing"):
        Build(HAND, built, TINY).run()


# -- the model card


def test_a_model_card_has_the_rates_of_every_round_and_of_every_type_and_shape(built: Path) -> None:
    card = (built / "model-2" / "README.md").read_text(encoding="utf-8")
    for number, run in ((1, "raw-hold"), (1, "ranked-hold"), (2, "raw-hold"), (2, "ranked-hold"), (2, "ranked-varied")):
        evaluation = Evaluation.load(built / f"evaluation-{number}-{run}" / "evaluation.json")
        rates = (
            f"{100 * rate.rate:.1f} [{100 * rate.low:.1f}, {100 * rate.high:.1f}]"
            for rate in (evaluation.held, evaluation.faithful)
        )
        grasps, protocol = run.split("-")
        assert f"| {number} | {grasps} | `{protocol}` | 36 | {' | '.join(rates)} |" in card
        parts = {**evaluation.by_type, **evaluation.by_object} if (number, grasps) == (2, "ranked") else {}
        for name, tally in parts.items():
            assert f"| {name} | {tally.n} | {100 * tally.held_rate.rate:.1f} [" in card
    trials = sum(len(load_dataset(built / f"round-{number}").grasps) for number in (1, 2))
    assert f"{trials} under protocol `varied`; rounds: 2" in card
    facts = ("shadow_hand_right", "(taxonomy `feix`)", "trials 0, evaluations 1", "mujoco 3", "torch 2", "hardware")
    assert all(fact in card for fact in facts)
    assert Scorer.load(built / "model-2").fingerprint() in card
    first = (built / "model-1" / "README.md").read_text(encoding="utf-8")
    assert "rounds: 1" in first
    assert "| 2 |" not in first


# -- the command line


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Let the command line build in small; return its arguments, without the folder."""
    monkeypatch.setattr("graspcascade.cli.learning.BuildSpec", lambda **given: replace(TINY, **given))
    return ["build", "--trials", 60, 12, "--evaluation", 2, "--workers", 1]


def test_the_command_prints_what_was_measured_by_round_and_where_the_model_is(
    built: Path, tiny: list[object], capsys: pytest.CaptureFixture[str]
) -> None:
    asked = [str(word) for word in (*tiny, "--out", built)]
    assert main(asked) == 0
    said = capsys.readouterr().out
    rows = [line.split()[:4] for line in said.splitlines() if line.split()[:1] in (["1"], ["2"])]
    tries = [["1", "raw", "hold"], ["1", "ranked", "hold"], ["2", "raw", "hold"], ["2", "ranked", "hold"]]
    assert rows == [[*each, "36"] for each in [*tries, ["2", "ranked", "varied"]]]
    assert said.count("(95 %: ") == 2 * len(rows)
    assert f"the model is {built / 'model-2'}" in said
    assert main([*asked, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["model"] == str(built / "model-2")
    told = [(each["round"], each["grasps"], each["evaluation"]) for each in report["measured"]]
    assert [[str(number), grasps, each["protocol"], str(each["n"])] for number, grasps, each in told] == rows
    assert main(["types", "sphere:40mm", "--model", report["model"]]) == 0


def test_an_interrupted_build_says_how_to_go_on(
    tiny: list[object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("graspcascade.studies.build.make_seeds", interrupted)
    assert main([str(word) for word in (*tiny, "--out", tmp_path / "out")]) == 130
    assert capsys.readouterr().err.startswith("graspcascade build: interrupted; what is finished is kept: run the same")


def test_every_step_of_a_build_has_a_bar_of_its_own(
    built: Path, tiny: list[object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(built, tmp_path / "cut")
    shutil.rmtree(tmp_path / "cut" / "evaluation-2-raw-hold")
    seen: list[str] = []

    @contextmanager
    def bar(title: str) -> Iterator[Bar]:
        seen.append(f"{title} begins")
        yield Bar(None, None, title)
        seen.append(f"{title} ends")

    monkeypatch.setattr("graspcascade.cli.console.bar", bar)
    assert main([str(word) for word in (*tiny, "--out", tmp_path / "cut")]) == 0
    steps = [line.removesuffix(" begins") for line in seen if line.endswith(" begins")]
    assert seen == [f"{step} {what}" for step in steps for what in ("begins", "ends")]
    assert {"trials of round 1", "trials of round 2", "raw grasps of round 2 under hold"} <= set(steps)


@pytest.mark.parametrize("change", [{"trials_per_cell": ()}, {"trials_per_cell": (5, 0)}, {"evaluation_per_cell": 0}])
def test_a_build_of_nothing_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(InputError):
        replace(TINY, **change)  # type: ignore[arg-type]
