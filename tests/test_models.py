"""Models with a scorer: what the command line loads, asks of them, says of their grasps, and builds."""

from __future__ import annotations

import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import Call, assert_refused
from graspcascade.core.errors import FileFormatError
from graspcascade.core.families import FAMILIES
from graspcascade.core.objects import as_object
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.protocols import VARIED
from graspcascade.core.tasks import draw_tasks
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.formats import load_document
from graspcascade.hands import Hand, load_hand
from graspcascade.nets import TrainingSpec, load_decoders, save_decoders
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.cascade.stages import FACTORIZATIONS
from graspcascade.proposals.heuristic import Heuristic
from graspcascade.proposals.ranked import Ranked, feasibility
from graspcascade.proposals.scorer import Scorer, Sight
from graspcascade.studies.build import Build
from graspcascade.studies.dataset import Dataset
from graspcascade.studies.evaluate import evaluate
from graspcascade.studies.learn import CascadeTraining, fit_cascade
from graspcascade.studies.scoring import ScorerTraining, fit_scorer
from test_pages import blocks

HAND = load_hand("shadow")
BOX = "box:32x41x60mm"
LIGHT_KG = 0.06


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train a model in a moment on trials that were never made: what holds is laid down here.

    Tripods and tip pinches hold, palmar pinches where friction is high, parallel extensions of what is light, writing
    tripods in three of four cases, and lateral tripods never.
    """
    rng, cells = np.random.default_rng(0), [(f, kind) for f in FAMILIES.values() for kind in GRASP_TYPES.values()]
    grasps = Heuristic.pretrained().propose(draw_tasks(cells, 12, HAND.reach_m, rng), rng)
    outcomes = Outcomes.blank(len(grasps), len(HAND.joint_names), tuple(HAND.digits))
    outcomes.verdict[:] = "held"
    outcomes.touching_end[:] = True
    outcomes.object_size_m[:] = grasps.grasp_size_m
    about = {"protocol": VARIED.to_json(), "shards": []}
    brief = CascadeTraining(training=TrainingSpec(epochs=1, batch_size=64, validation_fraction=0.0))
    cascade = fit_cascade(HAND, Dataset(grasps, outcomes, about), FACTORIZATIONS["any_size"], brief, workers=1).sampler
    tried = cascade.propose(draw_tasks(cells, 150, HAND.reach_m, rng), rng)
    n, conditions = len(tried), VARIED.conditions(18 * 150)
    assert conditions is not None
    mass_kg = tried.tasks.column(lambda task: task.object.mass_kg) * conditions.density_factor
    holds = {"palmar_pinch": conditions.friction > 0.75, "parallel_extension": mass_kg < LIGHT_KG}
    holds |= {"writing_tripod": rng.uniform(size=n) < 0.75, "lateral_tripod": np.zeros(n, dtype=bool)}
    held = np.select([tried.grasp_type == kind for kind in holds], list(holds.values()), default=True)
    outcomes = Outcomes.blank(n, len(HAND.joint_names), tuple(HAND.digits))
    outcomes.verdict[:] = np.where(held, "held", "dropped")
    outcomes.touching_end[:] = held[:, None]
    training = TrainingSpec(epochs=40, batch_size=256, learning_rate=5e-3, validation_fraction=0.0)
    config = ScorerTraining(Sight(closings=(1.0,), gradients=False), (48,), training)
    scorer = fit_scorer(HAND, [Dataset(tried, outcomes, about, conditions)], config)
    folder = tmp_path_factory.mktemp("models") / "tiny"
    cascade.save(folder)
    scorer.scorer.save(folder)
    return folder


@pytest.fixture(scope="module")
def bare(model: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Save the same cascade without the scorer."""
    folder = tmp_path_factory.mktemp("models") / "bare"
    GraspSampler.load(model).save(folder)
    return folder


# -- what a folder is loaded as


def test_a_folder_with_a_scorer_samples_ranked_grasps_with_their_chances(call: Call, model: Path, bare: Path) -> None:
    asked = ["sample", "writing_tripod", BOX, "--n", 20, "--json", "--model"]
    ranked, raw, plain = call(*asked, model).json, call(*asked, model, "--raw").json, call(*asked, bare).json
    assert all(0 <= row["probability"] <= 1 for row in ranked["grasps"])
    assert raw["grasps"] == plain["grasps"]
    assert all(row["probability"] is None for row in raw["grasps"])
    assert [each["metadata"]["model"] for each in (ranked, raw, plain)] == ["any_size, ranked", "any_size", "any_size"]
    assert ranked["metadata"]["ranking"]["friction"] == 0.8


def test_the_weights_file_of_a_folder_is_the_cascade_alone(call: Call, model: Path) -> None:
    said = call("sample", "tripod", BOX, "--n", 1, "--json", "--model", model / "cascade.safetensors")
    assert said.json["metadata"]["model"] == "any_size"


def test_a_spoilt_scorer_is_refused_and_does_not_stop_raw_grasps(call: Call, model: Path, tmp_path: Path) -> None:
    spoilt = shutil.copytree(model, tmp_path / "spoilt")
    (spoilt / "scorer.safetensors").write_bytes(b"something else")
    assert_refused(call("sample", "tripod", BOX, "--model", spoilt), "scorer.safetensors")
    assert call("sample", "tripod", BOX, "--model", spoilt, "--raw", "--n", 1).status == 0


def test_a_shipped_model_with_a_scorer_is_ranked_and_named_where_one_is_needed(
    call: Call, model: Path, bare: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = {"default": model, "new": model, "old": bare}
    monkeypatch.setattr("graspcascade.proposals.cascade.sampler.shipped_folders", lambda: shipped)
    assert call("sample", "tripod", BOX, "--n", 1, "--json").json["metadata"]["model"] == "any_size, ranked"
    assert_refused(call("types", BOX, "--model", "old"), "needs a model with a scorer", "default, new has one")


def test_evaluations_of_raw_and_ranked_grasps_are_told_apart(call: Call, model: Path, tmp_path: Path) -> None:
    asked = ["evaluate", "--model", model, "--object", BOX, "--per-cell", 1, "--protocol", "hold"]
    said = call(*asked, "--out", tmp_path / "run")
    assert said.out.startswith(f"any_size, ranked ({model}) under protocol hold")
    assert call(*asked, "--raw").out.startswith(f"any_size ({model}) under protocol hold")
    assert_refused(call(*asked, "--raw", "--out", tmp_path / "run"), "another model")


def test_rates_of_ranked_grasps_are_not_quoted_for_raw_ones(call: Call, model: Path, tmp_path: Path) -> None:
    own = shutil.copytree(model, tmp_path / "own")
    cells = [(as_object(BOX), GRASP_TYPES["tripod"])]
    evaluation = evaluate(Ranked.load(own), per_cell=1, seed=0, cells=cells)
    evaluation.save(own / "evaluation.json")
    for raw in ([], ["--raw"]):
        said = call("sample", "tripod", BOX, "--n", 1, "--json", "--model", own, *raw)
        assert said.json["metadata"]["measured"] == {}


# -- friction and mass


def test_friction_and_mass_change_the_chances_and_are_recorded(call: Call, model: Path, tmp_path: Path) -> None:
    def chance(kind: str, *asked: object) -> float:
        rows = call("sample", kind, BOX, "--n", 30, "--json", "--model", model, *asked).json["grasps"]
        return float(np.mean([row["probability"] for row in rows]))

    assert chance("palmar_pinch", "--friction", 0.9) > 0.8 > 0.3 > chance("palmar_pinch", "--friction", 0.55)
    assert chance("parallel_extension", "--mass-g", 30) > 0.8 > 0.3 > chance("parallel_extension", "--mass-g", 150)
    out = tmp_path / "g.json"
    assert call("sample", "tripod", BOX, "--friction", 0.5, "--mass-g", 120, "--model", model, "--out", out).status == 0
    document = load_document(out)
    assert document.metadata["asked"] | {"friction": 0.5, "mass_g": 120} == document.metadata["asked"]
    assert document.metadata["ranking"]["friction"] == 0.5
    (obj,) = document.grasps.tasks.objects.values()
    assert obj.mass_kg == pytest.approx(0.12)


def test_python_ranks_for_a_friction_too(model: Path) -> None:
    assert Ranked.load(model, friction=0.5).describe()["ranking"]["friction"] == 0.5


def test_a_mass_needs_no_scorer(call: Call, bare: Path, tmp_path: Path) -> None:
    out = tmp_path / "g.json"
    assert call("sample", "tripod", "box_medium", "--mass-g", 100, "--n", 1, "--out", out).status == 0
    assert load_document(out).grasps.tasks.objects["box_medium"].mass_kg == pytest.approx(0.1)
    assert call("sample", "tripod", BOX, "--mass-g", 100, "--n", 1, "--model", bare).status == 0


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (["--friction", "-0.1"], ["friction must be 0 to 1000, got -0.1"]),
        (["--friction", "nan"], ["friction must be 0 to 1000, got nan"]),
        (["--friction", "2000"], ["got 2000"]),
        (["--friction", "0.5", "--raw"], ["--friction", "--raw", "not both"]),
        (["--mass-g", "0"], [BOX, "0.0787 to 2361.6 g", "got 0 g"]),
        (["--mass-g", "-5"], ["got -5 g"]),
        (["--mass-g", "nan"], ["got nan g"]),
        (["--mass-g", "5000"], ["got 5000 g"]),
    ],
)
def test_friction_and_mass_out_of_range_are_refused(
    call: Call, model: Path, tmp_path: Path, asked: list[str], words: list[str]
) -> None:
    out = tmp_path / "g.json"
    assert_refused(call("sample", "tripod", BOX, *asked, "--model", model, "--out", out), *words)
    assert not out.exists()


@pytest.mark.parametrize("name", ["bare", "heuristic", "screened", "default"])
def test_chances_need_a_scorer_and_the_message_says_which_models_have_one(call: Call, bare: Path, name: str) -> None:
    chosen = bare if name == "bare" else name
    words = "needs a model with a scorer", str(chosen), "graspcascade build"
    assert_refused(call("sample", "tripod", "box_medium", "--friction", 0.5, "--model", chosen), "--friction", *words)
    assert_refused(call("types", "box_medium", "--model", chosen), *words)


def test_conditions_that_the_scorer_never_saw_are_said_to_be_guesses(call: Call, model: Path) -> None:
    asked = ["sample", "tripod", BOX, "--n", 2, "--model", model]
    assert call(*asked, "--friction", 0.6, "--mass-g", 60).err == ""
    assert (
        "graspcascade sample: the scorer saw friction 0.5 to 1; chances at 0.2 are"
        in call(*asked, "--friction", 0.2).err
    )
    assert "chances at 2000 are guesses" in call(*asked, "--mass-g", 2000).err


def test_a_scorer_that_garbles_what_it_saw_is_refused(model: Path, tmp_path: Path) -> None:
    for garbled in (3, {"friction": [0.5]}, {"friction": "low"}):
        stored = load_decoders(model / "scorer.safetensors")
        training = stored.metadata["training"] | {"seen": garbled}
        save_decoders(tmp_path / "scorer.safetensors", stored.decoders, {**stored.metadata, "training": training})
        with pytest.raises(FileFormatError):
            Scorer.load(tmp_path)


# -- what the user is told


def test_the_summary_shows_chances_where_they_are_known(call: Call, model: Path) -> None:
    said = call("sample", "tripod", BOX, "--n", 3, "--side-axis", "x", "--model", model)
    assert "chance" in said.out
    rows = [line.split() for line in said.out.splitlines() if line.strip()[:1].isdigit()]
    assert len(rows) == 3
    assert all(85 <= int(row[1]) <= 100 and row[2:4] == ["x", "3.2"] for row in rows)
    assert "chance" not in call("sample", "tripod", BOX, "--n", 3, "--model", model, "--raw").out


def test_what_hardly_works_is_said_with_what_works_better(call: Call, model: Path) -> None:
    said = call("sample", "lateral_tripod", BOX, "--side-axis", "y", "--n", 7, "--model", model)
    assert said.status == 0
    (line,) = said.err.splitlines()
    assert line.startswith(
        f"graspcascade sample: 7 of 7 lateral_tripod grasps of {BOX} by side y: chance below 50 %; likelier: "
    )
    assert "tripod by " in line.partition("likelier")[2]
    assert "lateral_tripod" not in line.partition("likelier")[2]


def test_nothing_is_said_when_all_is_well(call: Call, model: Path) -> None:
    assert call("sample", "tripod", BOX, "--n", 20, "--model", model).err == ""


def test_sides_that_hardly_work_are_said_each_and_what_the_proposal_says_comes_along(model: Path) -> None:
    ranked = Ranked.load(model)
    grasps = ranked.sample("tripod", BOX, n=30)
    by_z = grasps.side_axis == "z"
    doubted = replace(grasps, probability=np.where(by_z, 0.2, 0.95))
    (note,) = ranked.notes(doubted)
    assert note.startswith(f"{by_z.sum()} of {by_z.sum()} tripod grasps of {BOX} by side z: chance below 50 %")
    assert "likelier: tripod by " in note
    assert not ranked.notes(replace(grasps, probability=np.full(30, np.nan)))

    class Talking(Heuristic):
        def notes(self, _: object) -> tuple[str, ...]:
            return ("said by the heuristic",)

    talking = Talking(HAND, Heuristic.pretrained().prior)
    assert replace(ranked, proposal=talking).notes(grasps) == ("said by the heuristic",)


def test_where_nothing_works_that_is_said(model: Path) -> None:
    scorer = Scorer.load(model)
    layer = scorer.decoder.layers[-1]
    never = replace(scorer.decoder, layers=(*scorer.decoder.layers[:-1], replace(layer, bias=layer.bias - 50)))
    ranked = replace(Ranked.load(model), scorer=replace(scorer, decoder=never))
    (note,) = ranked.notes(ranked.sample("tripod", "sphere:40mm", n=3))
    assert note.endswith("no type or side of it reaches that")
    assert {row.word for row in feasibility(ranked, as_object(BOX))} == {"none"}


# -- types


def test_types_says_of_every_type_and_side_how_well_it_works(call: Call, model: Path) -> None:
    report = call("types", BOX, "--friction", 0.9, "--mass-g", 40, "--json", "--model", model).json
    rows = report["types"]
    assert [(row["grasp_type"], row["side_axis"]) for row in rows] == [
        (kind, side) for kind in GRASP_TYPES for side in "xyz"
    ]
    assert (report["friction"], report["mass_kg"]) == (0.9, pytest.approx(0.04))
    works = {kind: {row["works"] for row in rows if row["grasp_type"] == kind} for kind in GRASP_TYPES}
    assert works["tripod"] == works["palmar_pinch"] == {"good"}
    assert works["lateral_tripod"] == {"none"}
    assert all(row["chance"] >= 0 and 0 <= row["good_draws"] <= 1 for row in rows)
    slippery = call("types", BOX, "--friction", 0.55, "--json", "--model", model).json["types"]
    assert {row["works"] for row in slippery if row["grasp_type"] == "palmar_pinch"} <= {"poor", "none"}


def test_types_prints_a_line_for_each_and_only_sides_within_reach(call: Call, model: Path) -> None:
    said = call("types", "box:32x41x90mm", "--model", model)
    assert said.status == 0
    lines = [line.split() for line in said.out.splitlines() if line.split()[:1] and line.split()[0] in GRASP_TYPES]
    assert [line[:3] for line in lines[:2]] == [["tripod", "x", "3.2"], ["tripod", "y", "4.1"]]
    assert len(lines) == 12
    assert "friction 0.8" in said.out
    assert_refused(call("types", "sphere:80mm", "--model", model), "no side of sphere:80mm is within the hand's reach")
    assert_refused(call("types", "box_mediun", "--model", model), "Did you mean 'box_medium'")


def test_ranking_only_ever_raises_the_chance_and_counts_first_draws(model: Path) -> None:
    ranked = Ranked.load(model)
    rows = feasibility(ranked, as_object(BOX), n=16)
    single = feasibility(replace(ranked, most_draws=1), as_object(BOX), n=16)
    for more, one in zip(rows, single, strict=True):
        assert more.chance >= one.chance
        assert more.good_draws == one.good_draws


# -- the page


def test_what_the_quick_start_shows_of_such_models_works(
    call: Call, model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(model, tmp_path / "my_model" / "model-3")
    texts = [text for kind, _, text in blocks("quickstart") if kind == "bash" and "my_model" in text]
    lines = [line for text in texts for line in text.splitlines() if line.startswith("graspcascade ")]
    run = [shlex.split(line, comments=True)[1:] for line in lines]
    for arguments in run:
        if arguments[0] in ("types", "sample", "trial"):
            assert call(*arguments).status == 0, arguments
    assert {"build", "types", "sample"} <= {arguments[0] for arguments in run}


# -- build


def test_build_refuses_before_anything_is_written(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hand: Hand
) -> None:
    out = tmp_path / "out"
    assert_refused(call("build", "--out", out, "--trials"), "at least one round")
    assert_refused(call("build", "--out", out, "--trials", 0), "trials_per_cell must be at least 1")
    assert_refused(call("build", "--out", out, "--evaluation", 0), "evaluation_per_cell must be at least 1")
    assert_refused(call("build", "--out", out, "--seed", -1), "seed must not be negative")
    assert_refused(call("build", "--out", out, "--hand", "barrett"), "unknown hand")
    renamed = replace(hand, name="other", joint_names=tuple(f"my_{name}" for name in hand.joint_names))
    monkeypatch.setattr("graspcascade.cli.learning.load_hand", lambda _: renamed)
    assert_refused(call("build", "--out", out), "human statistics", "my_FFJ1", "graspcascade prior --postures")
    no_thumb = replace(hand, name="thumbless", places={"index_pad": hand.places["index_pad"]})
    monkeypatch.setattr("graspcascade.cli.learning.load_hand", lambda _: no_thumb)
    assert_refused(call("build", "--out", out), "thumbless", "no grasp type")
    assert not out.exists()
    (tmp_path / "thesis.txt").write_text("mine")
    monkeypatch.undo()
    assert_refused(call("build", "--out", tmp_path), "holds something else")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_build_says_which_types_a_hand_cannot_make(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cut_hands: Any
) -> None:
    monkeypatch.setattr(Build, "trained", lambda build: None)
    monkeypatch.setattr(Build, "measured", lambda build: ())
    file = cut_hands[2].mjcf.with_name("hand.yaml")
    said = call("build", "--hand", file, "--out", tmp_path / "out")
    assert said.status == 0
    assert "left out tripod, parallel_extension, writing_tripod, lateral_tripod: hand_of_2 lacks" in said.err
    assert "palmar_pinch" not in said.err
