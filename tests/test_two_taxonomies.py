"""Types of one name and other rules: what is proposed, tried, kept and learned stays of its own taxonomy."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import CATALOGUE
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.protocols import PAPER, Carry, Close, Protocol
from graspcascade.core.tasks import Tasks
from graspcascade.core.taxonomy import AREAS, FEIX_TYPES, PAPER_TYPES
from graspcascade.formats import FORMATS_BY_NAME, ExportOptions, load_document, save_grasps
from graspcascade.hands import Hand
from graspcascade.nets import TrainingSpec
from graspcascade.proposals.cascade.encoding import Vocabulary
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.cascade.stages import FACTORIZATIONS
from graspcascade.proposals.heuristic import Heuristic, Screened
from graspcascade.proposals.prior import PosturePrior
from graspcascade.studies.collect import CollectionSpec, collect
from graspcascade.studies.dataset import Dataset, load_dataset
from graspcascade.studies.evaluate import evaluate
from graspcascade.studies.learn import PRIOR_TRAINING, CascadeTraining, contact_metric, fit_cascade, fit_prior
from graspcascade.studies.postures import LabelledPostures
from graspcascade.studies.record import Evaluation
from graspcascade.viewer.session import SampleRequest, sample_batch

BRIEF = Protocol("brief", (Close(), Carry(0.2)))
TRIPOD, BOX = FEIX_TYPES["tripod"], CATALOGUE["box_medium"]
SPEC = CollectionSpec(trials_per_cell=4, round_per_cell=4)


@pytest.fixture(scope="module")
def feix(hand: Hand, prior: PosturePrior) -> Heuristic:
    """Take the shipped prior's postures for those of Feix's types, which they nearly are."""
    return Heuristic(hand, dataclasses.replace(prior, taxonomy="feix"))


@pytest.fixture(scope="module")
def paper(hand: Hand, prior: PosturePrior) -> Heuristic:
    return Heuristic(hand, prior)


@pytest.fixture(scope="module")
def sampler(hand: Hand, feix: Heuristic) -> GraspSampler:
    """Train a cascade, though not for long, on grasps of Feix's types that are said to have held."""
    rng = np.random.default_rng(0)
    parts = [feix.propose_any_side(obj, kind, 4, rng) for obj in CATALOGUE.values() for kind in FEIX_TYPES.values()]
    grasps = Grasps.concatenate(parts)
    blank = Outcomes.blank(len(grasps), len(hand.joint_names))
    held = dataclasses.replace(
        blank,
        verdict=np.full(len(grasps), "held"),
        touching_end=np.ones_like(blank.touching_end),
        areas_end=np.full_like(blank.areas_end, 2 ** len(AREAS) - 1),
        object_size_m=grasps.side_m + 0.012,
    )
    dataset = Dataset(grasps, held, {"protocol": PAPER.to_json(), "seed": 0, "taxonomy": "feix"})
    brief = CascadeTraining(training=TrainingSpec(epochs=1, batch_size=64))
    return fit_cascade(hand, dataset, FACTORIZATIONS["model3"], brief, workers=1).sampler


# -- proposals


def test_a_name_means_the_type_of_the_proposals_own_taxonomy(
    feix: Heuristic, paper: Heuristic, sampler: GraspSampler
) -> None:
    for proposal in (feix, Screened(feix), sampler):
        assert proposal.grasp_types == tuple(FEIX_TYPES.values())
        for name, kind in FEIX_TYPES.items():
            assert proposal.sample(name.replace("_", " "), BOX, "x", n=1).tasks.table[0].grasp_type == kind
    assert paper.sample("tripod", BOX, "x", n=1).tasks.table[0].grasp_type == PAPER_TYPES["tripod"]
    assert GraspSampler.pretrained().sample("tripod", BOX, n=1).tasks.taxonomy == "paper"


def test_grasps_are_placed_by_the_contact_places_of_the_types_own_taxonomy(feix: Heuristic, paper: Heuristic) -> None:
    for proposal, place in ((feix, "index_pad"), (paper, "index_phalanx")):
        grasps = proposal.sample("palmar_pinch", "sphere_small", n=5)
        places = proposal.hand.place_points(proposal.hand.executed(grasps.posture), ["thumb_pad", place])
        middle = (places["thumb_pad"].point_m + places[place].point_m) / 2
        np.testing.assert_allclose(grasps.X_hand_object.position_m, middle, atol=1e-12)


def test_a_type_of_the_other_taxonomy_is_refused(feix: Heuristic, paper: Heuristic, sampler: GraspSampler) -> None:
    others = PAPER_TYPES["tripod"]
    for proposal in (feix, Screened(feix), sampler):
        with pytest.raises(InputError, match=r"knows the tripod of taxonomy 'feix', not that of 'paper'; .* by name"):
            proposal.sample(others, BOX, "x")
        with pytest.raises(InputError, match="taxonomy 'feix', not that of 'paper'"):
            proposal.sample(others, BOX)
    for proposal in (paper, GraspSampler.pretrained()):
        with pytest.raises(InputError, match="taxonomy 'paper', not that of 'feix'"):
            proposal.sample(TRIPOD, BOX, "x")


def test_a_page_is_asked_for_a_type_by_its_name(feix: Heuristic, hand: Hand) -> None:
    batch = sample_batch(feix, hand, SampleRequest.of("tip_pinch", "sphere_small", n=2))
    assert batch.grasps.tasks.table[0].grasp_type == FEIX_TYPES["tip_pinch"]


# -- what proposals are learned from, and what is stored of them


def test_a_prior_keeps_the_taxonomy_of_its_seeds(hand: Hand, prior: PosturePrior, tmp_path: Path) -> None:
    names = np.array(list(FEIX_TYPES))
    seeds = LabelledPostures(hand.joint_names, hand.clip(prior.sample(names, np.random.default_rng(0))), names)
    once = dataclasses.replace(PRIOR_TRAINING, epochs=1, min_steps=0)
    for taxonomy in ("feix", "paper"):
        fitted = fit_prior(hand, dataclasses.replace(seeds, taxonomy=taxonomy), once)
        fitted.save(tmp_path / taxonomy)
        assert PosturePrior.load(tmp_path / taxonomy).taxonomy == fitted.taxonomy == taxonomy
        assert "taxonomy" not in PosturePrior.load(tmp_path / taxonomy).metadata
    fitted = dataclasses.replace(fitted, taxonomy="fiex")
    fitted.save(tmp_path / "unknown")
    with pytest.raises(FileFormatError, match=r"unknown taxonomy 'fiex'\. Did you mean 'feix'"):
        PosturePrior.load(tmp_path / "unknown")


def test_errors_of_a_posture_are_weighed_at_the_places_of_its_taxonomy(hand: Hand, prior: PosturePrior) -> None:
    names = np.array(["tripod", "palmar_pinch"])
    postures = hand.clip(prior.sample(names, np.random.default_rng(0)))
    own, papers = contact_metric(hand, postures, names, FEIX_TYPES), contact_metric(hand, postures, names)
    np.testing.assert_array_equal(own[0], papers[0])
    assert np.abs(own[1] - papers[1]).max() > 0.01
    pads = contact_metric(hand, postures, np.array(["tripod", "tripod"]))[:, :3]
    np.testing.assert_array_equal(own[:, :3], pads)


def test_a_cascade_keeps_its_taxonomy(sampler: GraspSampler, tmp_path: Path) -> None:
    sampler.save(tmp_path)
    loaded = GraspSampler.load(tmp_path)
    assert loaded.vocabulary == sampler.vocabulary
    assert loaded.vocabulary.taxonomy == "feix"
    assert loaded.grasp_types == tuple(FEIX_TYPES.values())
    assert "taxonomy" not in GraspSampler.pretrained().vocabulary.to_json()
    with pytest.raises(InputError, match="unknown taxonomy 'fiex'"):
        Vocabulary.from_json(sampler.vocabulary.to_json() | {"taxonomy": "fiex"})


# -- studies


def test_a_dataset_says_whose_types_it_has(feix: Heuristic, paper: Heuristic, tmp_path: Path) -> None:
    collect(feix, SPEC, tmp_path / "feix", protocol=BRIEF, cells=[(BOX, TRIPOD)])
    dataset = load_dataset(tmp_path / "feix")
    assert dataset.metadata["taxonomy"] == "feix"
    assert dataset.grasps.tasks.table[0].grasp_type == TRIPOD
    cells = [(BOX, PAPER_TYPES["tripod"])]
    collect(paper, SPEC, tmp_path / "paper", protocol=BRIEF, cells=cells)
    assert "taxonomy" not in load_dataset(tmp_path / "paper").metadata
    assert load_dataset(tmp_path / "paper").grasps.tasks.taxonomy == "paper"
    # The same prior but for its taxonomy: only that tells the two collections apart.
    with pytest.raises(InputError, match="holds rounds with another taxonomy"):
        collect(paper, SPEC, tmp_path / "feix", protocol=BRIEF, cells=cells)
    with pytest.raises(InputError, match="holds rounds with another taxonomy"):
        collect(feix, SPEC, tmp_path / "paper", protocol=BRIEF, cells=[(BOX, TRIPOD)])


def test_a_dataset_of_an_unknown_taxonomy_is_refused(feix: Heuristic, tmp_path: Path) -> None:
    collect(feix, SPEC, tmp_path, protocol=BRIEF, cells=[(BOX, TRIPOD)])
    about = tmp_path / "metadata.json"
    about.write_text(json.dumps(json.loads(about.read_text()) | {"taxonomy": ["feix"]}))
    with pytest.raises(FileFormatError, match=r"unknown taxonomy \['feix'\]\."):
        load_dataset(tmp_path)


def test_an_evaluation_counts_by_the_rules_of_the_models_types(feix: Heuristic, tmp_path: Path) -> None:
    made = evaluate(feix, per_cell=6, seed=1, protocol=BRIEF, cells=[("box_medium", "tripod")], out=tmp_path)
    assert made.taxonomy == "feix"
    assert made.to_json()["taxonomy"] == "feix"
    assert Evaluation.load(tmp_path / "evaluation.json") == made
    rows = load_dataset(tmp_path)
    assert rows.outcomes.faithful(rows.grasps).sum() == made.total.faithful
    papers = dataclasses.replace(made, taxonomy="paper").to_json()
    assert "taxonomy" not in papers
    assert Evaluation.from_json(papers).taxonomy == "paper"
    with pytest.raises(FileFormatError, match="unknown taxonomy 'fiex'"):
        Evaluation.from_json(made.to_json() | {"taxonomy": "fiex"})


def test_types_of_two_taxonomies_do_not_go_into_one_study_or_file(paper: Heuristic, tmp_path: Path) -> None:
    both = [(BOX, PAPER_TYPES["tripod"]), (BOX, FEIX_TYPES["tip_pinch"])]
    with pytest.raises(InputError, match="keep them apart"):
        evaluate(paper, per_cell=1, seed=0, cells=both)
    grasps = paper.sample("tripod", BOX, "x", n=2)
    table = tuple(dataclasses.replace(grasps.tasks.table[0], grasp_type=kind) for _, kind in both)
    mixed = dataclasses.replace(grasps, tasks=Tasks(table, np.arange(2)))
    with pytest.raises(InputError, match="keep them apart"):
        save_grasps(tmp_path / "mixed.json", mixed, metadata={})


# -- files of grasps


@pytest.mark.parametrize("name", FORMATS_BY_NAME)
def test_every_format_gives_back_the_types_that_were_written(
    name: str, feix: Heuristic, paper: Heuristic, tmp_path: Path
) -> None:
    options = ExportOptions(contact="target")
    for proposal, types in ((feix, FEIX_TYPES), (paper, PAPER_TYPES)):
        grasps = proposal.sample("palmar_pinch", BOX, "x", n=2)
        chosen = FORMATS_BY_NAME[name]
        path = tmp_path / (proposal.prior.taxonomy + chosen.suffixes[0] * (chosen.layout != "folder"))
        save_grasps(path, grasps, metadata={}, format=name, options=options)
        read = load_document(path, name, trust_pickle=True).grasps
        assert {task.grasp_type for task in read.tasks} == {types["palmar_pinch"]}


def test_a_file_names_the_taxonomy_only_where_it_is_not_the_papers(
    feix: Heuristic, paper: Heuristic, tmp_path: Path
) -> None:
    for proposal, says in ((feix, "feix"), (paper, None)):
        save_grasps(tmp_path / "some.json", proposal.sample("tripod", BOX, "x", n=1), metadata={})
        assert json.loads((tmp_path / "some.json").read_text()).get("taxonomy") == says
