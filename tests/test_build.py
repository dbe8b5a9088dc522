"""The whole chain in small: what is made, that it goes on where it was cut off, and that it is the same again."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from graspcascade.core.errors import InputError
from graspcascade.engines import as_engine
from graspcascade.hands import load_hand
from graspcascade.nets import TrainingSpec
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.ranked import Ranked
from graspcascade.proposals.scorer import Scorer
from graspcascade.studies.build import Build, BuildSpec
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


def test_other_arguments_do_not_go_on_with_a_build(built: Path) -> None:
    with pytest.raises(InputError, match="another"):
        Build(HAND, built, replace(TINY, seed=5), engine=as_engine()).run()


@pytest.mark.parametrize("change", [{"trials_per_cell": ()}, {"trials_per_cell": (5, 0)}, {"evaluation_per_cell": 0}])
def test_a_build_of_nothing_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(InputError):
        replace(TINY, **change)  # type: ignore[arg-type]
