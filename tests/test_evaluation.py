"""Evaluation: runs that depend on seeds alone, and records that survive their files."""

import json
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluations import evaluation
from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.families import FAMILIES
from graspcascade.core.files import LOCK_FILE, sole_writer
from graspcascade.core.grasps import Grasps
from graspcascade.core.intervals import wilson
from graspcascade.core.objects import Box, GraspObject, as_object
from graspcascade.core.outcomes import VERDICTS, Outcomes
from graspcascade.core.poses import Pose
from graspcascade.core.protocols import PAPER, Protocol
from graspcascade.core.tasks import Task, Tasks
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.engines import run_trials
from graspcascade.engines.mujoco.creep import FAST_FORWARD
from graspcascade.engines.mujoco.runner import MujocoEngine
from graspcascade.hands import Hand, load_hand
from graspcascade.proposals import Proposal
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.heuristic import SPREAD, Heuristic, Screened, cannot_touch
from graspcascade.proposals.prior import PosturePrior
from graspcascade.studies.collect import CollectionRound, CollectionSpec
from graspcascade.studies.dataset import load_dataset
from graspcascade.studies.evaluate import ROUND_PER_CELL, EvaluationRound, evaluate
from graspcascade.studies.record import Evaluation
from graspcascade.studies.rounds import CELLS, Pair, TrialJob, as_cells

HAND = load_hand("shadow")


def cell(obj: str, kind: str) -> Pair:
    return as_object(obj), GRASP_TYPES[kind]


TWO_CELLS = (cell("box_medium", "tripod"), cell("cylinder_small", "tip_pinch"))
OTHER_BOX = GraspObject("box_medium", Box(0.02, 0.02, 0.02))
ASKED: dict[str, Any] = {"per_cell": 1, "seed": 0, "cells": TWO_CELLS}
JOINTS = HAND.joint_names


class Stub(Proposal):
    """Draw grasps that mean nothing; the fake physics below reads its verdicts off them."""

    name = "stub"

    def __init__(self, change: Callable[[Grasps], Grasps] | None = None, most_calls: int = 10**6) -> None:
        self.hand, self.change, self.left = HAND, change, most_calls
        self.drawn: list[Grasps] = []

    def propose(self, tasks: Tasks, rng: np.random.Generator) -> Grasps:
        if self.left == 0:
            raise CutOffError
        self.left -= 1
        n = len(tasks)
        quat = rng.normal(size=(n, 4))
        grasps = Grasps(
            hand=HAND.name,
            joint_names=JOINTS,
            tasks=tasks,
            posture=rng.uniform(0, 1, (n, len(JOINTS))),
            pregrasp=np.zeros((n, len(JOINTS))),
            X_hand_object=Pose(rng.uniform(-0.1, 0.1, (n, 3)), quat / np.linalg.norm(quat, axis=1, keepdims=True)),
            grasp_size_m=np.full(n, 0.03),
            object_size_m=np.full(n, np.nan),
            probability=np.full(n, np.nan),
        )
        self.drawn.append(grasps if self.change is None else self.change(grasps))
        return self.drawn[-1]


class CutOffError(Exception):
    """Stand for whatever ends a process."""


def cut_off_after(rounds: int) -> Stub:
    return Stub(most_calls=rounds)


def fake_run(grasps: Grasps) -> Outcomes:
    """Decide by the posture alone: no physics, the same answer to the same grasp."""
    outcomes = Outcomes.blank(len(grasps), len(JOINTS))
    share = grasps.posture[:, 0]
    outcomes.verdict[:] = np.where(share < 0.5, "held", np.array(VERDICTS)[1:][(share * 1000).astype(int) % 7])
    outcomes.touching_end[:] = (share < 0.3)[:, None]
    outcomes.turn_rad[:] = share
    return outcomes


@pytest.fixture
def no_physics(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Put the fake in the runner's place and record how many trials each round executed."""
    executed: list[int] = []

    def run(_: MujocoEngine, hand: Hand, grasps: Grasps, protocol: Protocol, *own: Any, **options: Any) -> Outcomes:
        executed.append(len(grasps))
        if options["progress"] is not None:
            options["progress"](len(grasps))
        return fake_run(grasps)

    monkeypatch.setattr(MujocoEngine, "run", run)
    return executed


# --- runs


def test_every_cell_gets_the_trials_asked_for(no_physics: list[int]) -> None:
    result = evaluate(Stub(), per_cell=3, seed=0)
    assert [(cell.object_label, cell.grasp_type) for cell in result.cells] == [
        (obj.name, kind.name) for obj, kind in CELLS
    ]
    assert {cell.n for cell in result.cells} == {3}
    assert result.n == 3 * len(CELLS) == sum(no_physics)
    assert result.held == wilson(sum(cell.held for cell in result.cells), result.n)
    assert result.faithful == wilson(sum(cell.faithful for cell in result.cells), result.n)


def test_counts_are_those_of_the_outcomes(no_physics: list[int]) -> None:
    stub = Stub()
    result = evaluate(stub, per_cell=ROUND_PER_CELL + 3, seed=1, cells=TWO_CELLS)
    assert len(stub.drawn) == 2
    grasps = Grasps.concatenate(stub.drawn)
    outcomes = fake_run(grasps)
    for cell in result.cells:
        rows = (grasps.object_name == cell.object_label) & (grasps.grasp_type == cell.grasp_type)
        assert dict(cell.verdicts) == {verdict: int((outcomes.verdict[rows] == verdict).sum()) for verdict in VERDICTS}
        assert cell.faithful == int(outcomes.faithful(grasps)[rows].sum())
        assert cell.steady == int(outcomes.steady[rows].sum())


def test_the_seed_alone_decides(no_physics: list[int]) -> None:
    one, again, other = (evaluate(Stub(), per_cell=30, seed=s, cells=TWO_CELLS) for s in (5, 5, 6))
    assert one == again
    assert one.cells != other.cells


def test_sides_are_drawn_evenly_from_the_graspable_ones(no_physics: list[int]) -> None:
    stub = Stub()
    evaluate(stub, per_cell=600, seed=0, cells=[cell("box_large", "tripod")])
    axes = Grasps.concatenate(stub.drawn).side_axis
    assert set(axes) == set(as_object("box_large").sites(HAND.reach_m)) == {"x", "y"}
    assert (axes == "x").sum() == pytest.approx(300, abs=60)


def test_progress_goes_from_nothing_to_all(no_physics: list[int]) -> None:
    told: list[tuple[int, int]] = []
    evaluate(Stub(), per_cell=25, seed=0, cells=TWO_CELLS, progress=lambda done, total: told.append((done, total)))
    assert told[0] == (0, 50)
    assert told[-1] == (50, 50)
    assert [done for done, _ in told] == sorted(done for done, _ in told)


@pytest.mark.parametrize("rounds", [0, 1, 2])
def test_a_resumed_evaluation_equals_an_uninterrupted_one(tmp_path: Path, no_physics: list[int], rounds: int) -> None:
    asked: dict[str, Any] = {"per_cell": 2 * ROUND_PER_CELL + 5, "seed": 3, "cells": TWO_CELLS, "out": tmp_path / "run"}
    with pytest.raises(CutOffError):
        evaluate(cut_off_after(rounds), **asked)
    assert not (tmp_path / "run" / "evaluation.json").exists()
    resumed = evaluate(Stub(), **asked)
    assert resumed == evaluate(Stub(), **asked | {"out": None})
    assert sum(no_physics) == 2 * resumed.n  # no trial was executed twice for the resumed one
    assert Evaluation.load(tmp_path / "run" / "evaluation.json") == resumed


def test_a_finished_evaluation_is_not_run_again(tmp_path: Path, no_physics: list[int]) -> None:
    asked: dict[str, Any] = {"per_cell": 4, "seed": 3, "cells": TWO_CELLS, "out": tmp_path / "run"}
    first = evaluate(Stub(), **asked)
    text = (tmp_path / "run" / "evaluation.json").read_bytes()
    no_physics.clear()
    assert evaluate(Stub(), **asked) == first
    assert (tmp_path / "run" / "evaluation.json").read_bytes() == text
    assert no_physics == []


def test_stored_rows_are_a_dataset(tmp_path: Path, no_physics: list[int]) -> None:
    pytest.importorskip("pyarrow")
    result = evaluate(Stub(), per_cell=25, seed=0, cells=TWO_CELLS, out=tmp_path / "run")
    rows = load_dataset(tmp_path / "run")
    assert len(rows.grasps) == result.n
    assert int(rows.outcomes.held.sum()) == result.total.held
    assert int(rows.outcomes.faithful(rows.grasps).sum()) == result.total.faithful


@pytest.mark.parametrize(("how", "lost"), [("missing", [0]), ("missing", [1]), ("changed", [0, 2])])
def test_lost_rows_are_executed_again_and_the_others_kept(
    tmp_path: Path, no_physics: list[int], how: str, lost: list[int]
) -> None:
    pytest.importorskip("pyarrow")
    asked: dict[str, Any] = {"per_cell": 2 * ROUND_PER_CELL + 5, "seed": 0, "cells": TWO_CELLS, "out": tmp_path}
    first = evaluate(Stub(), **asked)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for number in lost:
        path = tmp_path / f"part-{number:05d}.parquet"
        path.unlink() if how == "missing" else path.write_bytes(path.read_bytes()[:-9])
    expected = [no_physics[number] for number in lost]
    no_physics.clear()
    with pytest.raises(CutOffError):
        evaluate(cut_off_after(1 + len(lost[1:])), **asked)  # the first draw tells the source
    told: list[int] = []
    assert evaluate(Stub(), **asked, progress=lambda done, _: told.append(done)) == first
    assert no_physics == expected
    assert (told[0], told[-1]) == (first.n - expected[-1], first.n)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert len(load_dataset(tmp_path).grasps) == first.n


def test_rows_lost_by_an_unfinished_evaluation_do_not_change_it(tmp_path: Path, no_physics: list[int]) -> None:
    pytest.importorskip("pyarrow")
    asked: dict[str, Any] = {"per_cell": 3 * ROUND_PER_CELL, "seed": 0, "cells": TWO_CELLS}
    with pytest.raises(CutOffError):
        evaluate(cut_off_after(2), **asked, out=tmp_path)
    (tmp_path / "part-00000.parquet").unlink()
    assert evaluate(Stub(), **asked, out=tmp_path) == evaluate(Stub(), **asked)
    assert [shard["file"] for shard in load_dataset(tmp_path).metadata["shards"]] == [
        f"part-{number:05d}.parquet" for number in range(3)
    ]


def test_rows_that_were_never_written_are_not_lost(
    tmp_path: Path, no_physics: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyarrow")
    asked: dict[str, Any] = {"per_cell": 2 * ROUND_PER_CELL, "seed": 0, "cells": TWO_CELLS, "out": tmp_path}
    with monkeypatch.context() as patch:
        patch.setattr("graspcascade.studies.evaluate.find_spec", lambda _: None)
        with pytest.raises(CutOffError):
            evaluate(cut_off_after(1), **asked)
    first = evaluate(Stub(), **asked)
    assert [path.name for path in tmp_path.glob("*.parquet")] == ["part-00001.parquet"]
    (tmp_path / "part-00001.parquet").unlink()
    no_physics.clear()
    with monkeypatch.context() as patch:
        patch.setattr("graspcascade.studies.evaluate.find_spec", lambda _: None)
        assert evaluate(Stub(), **asked) == first
    assert no_physics == []  # nothing could be written
    assert evaluate(Stub(), **asked) == first
    assert no_physics == [ROUND_PER_CELL * len(TWO_CELLS)]
    assert (tmp_path / "part-00001.parquet").exists()


def test_without_pyarrow_an_evaluation_resumes_from_its_counts(
    tmp_path: Path, no_physics: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("graspcascade.studies.evaluate.find_spec", lambda _: None)
    asked: dict[str, Any] = {"per_cell": 25, "seed": 0, "cells": TWO_CELLS, "out": tmp_path / "run"}
    with pytest.raises(CutOffError):
        evaluate(cut_off_after(1), **asked)
    assert evaluate(Stub(), **asked) == evaluate(Stub(), **asked | {"out": None})
    assert not list((tmp_path / "run").glob("*.parquet"))


@pytest.mark.parametrize(
    "change",
    [
        {"per_cell": 5},
        {"seed": 1},
        {"protocol": PAPER.with_physics("paper", friction=1.0)},
        {"cells": TWO_CELLS[:1]},
        {"metadata": {"weights": "b"}},
        {"hand": replace(HAND, name="another")},
        {"hand": replace(HAND, pregrasp_rad={})},
    ],
)
def test_a_folder_with_other_arguments_is_refused(
    tmp_path: Path, no_physics: list[int], change: dict[str, Any]
) -> None:
    asked: dict[str, Any] = {"per_cell": 4, "seed": 0, "cells": TWO_CELLS, "out": tmp_path / "run"}
    evaluate(Stub(), **asked, metadata={"weights": "a"})
    before = {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    with pytest.raises(InputError, match="same arguments"):
        evaluate(Stub(), **{"metadata": {"weights": "a"}} | asked | change)
    assert {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before


def test_a_retrained_model_under_the_same_name_is_refused(tmp_path: Path, no_physics: list[int]) -> None:
    retrained = Stub(lambda grasps: replace(grasps, posture=grasps.posture + 0.01))
    evaluate(Stub(), per_cell=4, seed=0, cells=TWO_CELLS, out=tmp_path / "run")
    with pytest.raises(InputError, match="another model"):
        evaluate(retrained, per_cell=4, seed=0, cells=TWO_CELLS, out=tmp_path / "run")


def test_a_folder_with_other_files_is_refused(tmp_path: Path, no_physics: list[int]) -> None:
    (tmp_path / "precious.txt").write_text("mine")
    with pytest.raises(InputError, match="not empty"):
        evaluate(Stub(), per_cell=1, seed=0, cells=TWO_CELLS, out=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["precious.txt"]
    (tmp_path / "metadata.json").write_text("{")
    with pytest.raises(FileFormatError):
        evaluate(Stub(), per_cell=1, seed=0, cells=TWO_CELLS, out=tmp_path)


def test_names_do_for_values(no_physics: list[int]) -> None:
    named = evaluate(Stub(), per_cell=1, seed=0, cells=[("box_medium", "tripod")], protocol="paper", hand="shadow")
    assert named == evaluate(Stub(), per_cell=1, seed=0, cells=TWO_CELLS[:1])
    with pytest.raises(InputError, match="Did you mean 'tripod'"):
        evaluate(Stub(), per_cell=1, seed=0, cells=[("box_medium", "tripodd")])


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["rounds"].append(d["rounds"][0]),
        lambda d: d["rounds"][0]["counts"].pop(),
        lambda d: d["rounds"][0]["counts"][0].append(0),
        lambda d: d["rounds"][0].update(counts=[[0.5] * 8] * 2),
        lambda d: d["rounds"][0].update(counts=[[2, -1, 0, 0, 0, 0, 0, 0]] * 2),
        lambda d: d["rounds"][0].update(counts=[[2, 0, 0, 0, 0, 0, 0, 0]] * 2),
        lambda d: d["rounds"][0].update(counts=[[0, 1, 0, 0, 0, 0, 1, 0]] * 2),
        lambda d: d.pop("first_round_mean"),
        lambda d: d.update(first_round_mean=[1.0]),
        lambda d: d.update(first_round_mean=["a"]),
        lambda d: d.pop("rounds"),
        lambda d: d.update(shards=[1]),
    ],
)
def test_doctored_rounds_are_refused(tmp_path: Path, no_physics: list[int], change: Callable[[Any], Any]) -> None:
    evaluate(Stub(), **ASKED, out=tmp_path)
    data = json.loads((tmp_path / "metadata.json").read_text())
    change(data)
    (tmp_path / "metadata.json").write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match=r"metadata\.json"):
        evaluate(Stub(), **ASKED, out=tmp_path)


def test_a_folder_in_the_locks_place_is_refused(tmp_path: Path, no_physics: list[int]) -> None:
    (tmp_path / LOCK_FILE).mkdir()
    with pytest.raises(InputError, match="is a folder"):
        evaluate(Stub(), **ASKED, out=tmp_path)


def test_a_folder_has_one_evaluation_at_a_time(tmp_path: Path, no_physics: list[int]) -> None:
    asked: dict[str, Any] = {"per_cell": 4, "seed": 0, "cells": TWO_CELLS, "out": tmp_path}

    def meddle(grasps: Grasps) -> Grasps:
        with pytest.raises(InputError, match="another process is writing to"), sole_writer(tmp_path):
            raise AssertionError
        return grasps

    meddled = Stub(meddle)
    with sole_writer(tmp_path), pytest.raises(InputError, match="another process is writing to"):
        evaluate(meddled, **asked)
    assert no_physics == []
    (tmp_path / LOCK_FILE).touch()  # as a crash leaves it
    evaluate(meddled, **asked)
    assert LOCK_FILE not in {path.name for path in tmp_path.iterdir()}
    with sole_writer(tmp_path):
        pass


def test_the_record_is_written_before_others_may_write(
    tmp_path: Path, no_physics: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    save, saved = Evaluation.save, []

    def meddled(result: Evaluation, path: Path) -> None:
        with pytest.raises(InputError, match="another process is writing to"), sole_writer(tmp_path):
            raise AssertionError
        save(result, path)
        saved.append(path.name)

    monkeypatch.setattr(Evaluation, "save", meddled)
    evaluate(Stub(), **ASKED, out=tmp_path)
    assert saved == ["evaluation.json"]


def test_what_a_killed_evaluation_left_is_no_hindrance(tmp_path: Path, no_physics: list[int]) -> None:
    (tmp_path / ".metadata.json.4711.staged").write_text("{")
    result = evaluate(Stub(), **ASKED, out=tmp_path)
    assert Evaluation.load(tmp_path / "evaluation.json") == result
    assert not list(tmp_path.glob(".*"))


def test_an_evaluation_whose_traceback_is_kept_does_not_keep_its_folder(tmp_path: Path, no_physics: list[int]) -> None:
    asked: dict[str, Any] = {"per_cell": 2 * ROUND_PER_CELL, "seed": 0, "cells": TWO_CELLS, "out": tmp_path}
    with pytest.raises(CutOffError) as kept:
        evaluate(cut_off_after(1), **asked)
    assert evaluate(Stub(), **asked) == evaluate(Stub(), **asked | {"out": None})
    assert kept.tb is not None


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"per_cell": 0}, "at least 1"),
        ({"seed": -1}, "seed must not be negative, got -1"),
        ({"cells": ()}, "at least one cell"),
        ({"cells": TWO_CELLS + TWO_CELLS}, "once"),
        ({"cells": [TWO_CELLS[0], (OTHER_BOX, GRASP_TYPES["tripod"])]}, "each object with its own name"),
        ({"cells": [cell("sphere:80mm", "tripod")]}, "no side of sphere:80mm is within"),
        ({"metadata": {"weights": object()}}, "plain JSON"),
    ],
)
def test_bad_arguments_are_refused_before_any_trial(no_physics: list[int], change: dict[str, Any], word: str) -> None:
    with pytest.raises(InputError, match=word):
        evaluate(Stub(), **ASKED | change)
    assert no_physics == []


@pytest.mark.parametrize(
    "cheat",
    [
        lambda grasps: grasps[1:],
        lambda grasps: grasps[::-1],
        lambda grasps: replace(grasps, tasks=Tasks.repeat(Task.of("tripod", "box_medium", "x"), len(grasps))),
        lambda grasps: replace(grasps, joint_names=grasps.joint_names[::-1]),
    ],
)
def test_a_proposal_that_answers_another_question_is_refused(
    no_physics: list[int], cheat: Callable[[Grasps], Grasps]
) -> None:
    with pytest.raises(InputError, match="the proposal"):
        evaluate(Stub(cheat), per_cell=8, seed=0, cells=TWO_CELLS)
    assert no_physics == []


def test_numbers_may_be_quoted_under_another_name_with_other_facts(no_physics: list[int]) -> None:
    own = evaluate(Stub(), **ASKED)
    assert (own.model, own.model_metadata) == ("stub", {})
    other = evaluate(Stub(), **ASKED, name="mine", metadata={"weights": "abc"})
    assert (other.model, other.model_metadata) == ("mine", {"weights": "abc"})
    assert other.cells == own.cells


def test_an_engine_that_abridges_is_refused(no_physics: list[int]) -> None:
    with pytest.raises(InputError, match="computes every step"):
        evaluate(Stub(), **ASKED, engine=MujocoEngine(creep=FAST_FORWARD))


def test_the_heuristic_is_executed_unscreened_in_real_physics(prior: PosturePrior) -> None:
    heuristic = Heuristic(HAND, prior)
    cells = (cell("sphere_medium", "tripod"), cell("sphere_medium", "tip_pinch"))
    counted = evaluate(heuristic, per_cell=4, seed=0, cells=cells, engine=MujocoEngine(1))
    grasps = EvaluationRound(heuristic, cells, 4, 0, 0)()
    outcomes = run_trials(grasps, PAPER, hand=HAND, n_threads=2)
    assert counted.n == len(grasps) == 8
    assert counted.total.held == int(outcomes.held.sum())
    assert counted.total.faithful == int(outcomes.faithful(grasps).sum())


def test_evaluating_needs_neither_torch_nor_pyarrow() -> None:
    code = "import sys, graspcascade.studies.evaluate; assert not {'torch', 'pyarrow'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


# --- processes, and cells of one's own


class WithoutPhysics(MujocoEngine):
    """Decide by the posture alone, in whichever process."""

    def run(self, hand: Hand, grasps: Grasps, *_: Any, progress: Callable[[int], None] | None, **__: Any) -> Outcomes:
        if progress is not None:
            progress(len(grasps))
        return fake_run(grasps)


OWN_CELLS = (cell("box:32x41x60mm", "tripod"), cell("cylinder:18x80mm", "tip_pinch"), cell("box_small", "tripod"))


def test_the_number_of_processes_changes_no_byte(tmp_path: Path) -> None:
    asked: dict[str, Any] = {"per_cell": ROUND_PER_CELL + 3, "seed": 2, "cells": TWO_CELLS, "engine": WithoutPhysics()}
    for n in (1, 2):
        evaluate(GraspSampler.pretrained(), **asked, workers=n, out=tmp_path / str(n))
    one, two = ({path.name: path.read_bytes() for path in (tmp_path / str(n)).iterdir()} for n in (1, 2))
    assert one == two
    assert one.keys() == {"metadata.json", "evaluation.json", "part-00000.parquet", "part-00001.parquet"}


def test_the_numbers_of_processes_and_threads_change_no_trial(tmp_path: Path, prior: PosturePrior) -> None:
    cells = (cell("sphere:38mm", "tripod"), cell("box_small", "tip_pinch"))
    asked: dict[str, Any] = {"per_cell": 3, "seed": 4, "cells": cells}
    heuristic = Screened(Heuristic(HAND, prior), 50)
    for name, threads, workers in (("a", 1, 1), ("b", 2, 1), ("c", 0, 2)):
        evaluate(heuristic, **asked, engine=MujocoEngine(threads), workers=workers, out=tmp_path / name)
    one, two, three = ({p.name: p.read_bytes() for p in (tmp_path / name).iterdir()} for name in "abc")
    assert one == two == three


def test_a_screened_heuristic_is_evaluated_on_objects_of_ones_own(
    tmp_path: Path, prior: PosturePrior, no_physics: list[int]
) -> None:
    screened = Screened(Heuristic(HAND, prior), 50)
    result = evaluate(screened, per_cell=4, seed=0, cells=OWN_CELLS, out=tmp_path)
    assert (result.model, result.model_metadata["most_draws"]) == ("screened", 50)
    assert [cell.object_label for cell in result.cells] == [obj.name for obj, _ in OWN_CELLS]
    rows = load_dataset(tmp_path)
    assert rows.metadata["objects"] == {obj.name: obj.to_json() for obj, _ in OWN_CELLS}
    assert not cannot_touch(HAND, rows.grasps).any()


def test_every_trial_of_a_family_has_an_object_of_its_own_and_is_counted_by_family(
    tmp_path: Path, prior: PosturePrior, no_physics: list[int]
) -> None:
    names = [("any", "tripod"), ("box_small", "tripod")]
    result = evaluate(Heuristic(HAND, prior), per_cell=ROUND_PER_CELL + 3, seed=0, cells=names, out=tmp_path)
    labels = ["any:box", "any:cylinder", "any:sphere", "box_small"]
    assert [cell.object_label for cell in result.cells] == labels
    assert Evaluation.load(tmp_path / "evaluation.json") == result
    rows = load_dataset(tmp_path)
    assert rows.metadata["families"] == {name: FAMILIES[name].to_json() for name in labels[:3]}
    # Of spheres there are 451; of boxes and cylinders no size is drawn twice.
    assert len(rows.grasps.tasks.objects) > 3 * 20
    shapes = np.array([name.split(":")[0] for name in rows.grasps.object_name.tolist()])
    for cell, shape in zip(result.cells, ("box", "cylinder", "sphere", "box_small"), strict=True):
        assert cell.held == rows.outcomes.held[shapes == shape].sum()
    with pytest.raises(InputError, match="knows 9 objects by name and not box:"):
        evaluate(GraspSampler.pretrained(), per_cell=1, seed=0, cells=names)


def test_refused_cells_do_not_bind_the_folder(tmp_path: Path, no_physics: list[int]) -> None:
    asked: dict[str, Any] = {"per_cell": 2, "seed": 0, "out": tmp_path}
    with pytest.raises(InputError, match="knows 9 objects by name and not box:32x41x60mm"):
        evaluate(GraspSampler.pretrained(), **asked, cells=OWN_CELLS)
    assert not list(tmp_path.iterdir())
    evaluate(GraspSampler.pretrained(), **asked, cells=TWO_CELLS)
    kept = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(InputError, match="rounds with another"):
        evaluate(GraspSampler.pretrained(), **asked, cells=OWN_CELLS)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == kept


def test_a_round_that_was_sent_elsewhere_draws_the_same(prior: PosturePrior) -> None:
    heuristic = Heuristic(HAND, prior)
    evaluation_round = EvaluationRound(Screened(heuristic, 20), OWN_CELLS, 5, 0, 1)
    collection_round = CollectionRound(heuristic, (0, 30), 1, CollectionSpec(round_per_cell=4))
    families, spread = as_cells([("any", "tripod")]), replace(heuristic, placement=SPREAD)
    of_families = (
        EvaluationRound(heuristic, families, 5, 0, 1),
        CollectionRound(spread, (0, 2), 1, CollectionSpec(round_per_cell=4), families),
    )
    for draw in (evaluation_round, collection_round, *of_families):
        job = TrialJob(draw, HAND, PAPER, WithoutPhysics(), 1, 2)
        sent = pickle.loads(pickle.dumps(job))
        here, there = draw(), sent.draw()
        assert here.tasks.same_as(there.tasks)
        for name, column in here.columns().items():
            np.testing.assert_array_equal(column, there.columns()[name], err_msg=name)
        outcomes = fake_run(here)[1::2]
        np.testing.assert_array_equal(sent(lambda _: None).verdict, outcomes.verdict)


def test_a_negative_number_of_workers_is_refused(no_physics: list[int]) -> None:
    with pytest.raises(InputError, match="workers must not be negative, got -1"):
        evaluate(Stub(), **ASKED, workers=-1)
    assert no_physics == []


# --- records


RECORDS = [
    path
    for path in sorted((Path(__file__).parents[1] / "docs/results/paper").glob("*.json"))
    if json.loads(path.read_text()).get("kind") == "graspcascade evaluation"
]


@pytest.mark.parametrize("path", RECORDS, ids=lambda path: path.stem)
def test_published_records_are_read(path: Path) -> None:
    data = json.loads(path.read_text())
    record = Evaluation.load(path)
    assert record.protocol.physics.friction == data["protocol_parameters"]["friction"]
    said = json.loads(json.dumps(record.to_json()))
    assert said.pop("engine") == "mujoco"  # which they do not say
    assert said.keys() == data.keys()
    for name in said.keys() - {"protocol_parameters"}:  # which was one flat record
        assert json_alike(said[name], data[name]), name


def json_alike(one: Any, other: Any) -> bool:
    """Compare parsed JSON, real numbers but for rounding."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(json_alike(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(json_alike, one, other))
    return bool(one == (pytest.approx(other, abs=1e-9) if isinstance(one, float) else other))


def test_there_are_published_records() -> None:
    assert len(RECORDS) > 10


def test_an_evaluation_survives_its_file(tmp_path: Path) -> None:
    result = evaluation(model_metadata={"training": {"epochs": 3, "widths": [64, 64]}})
    result.save(tmp_path / "heuristic.json")
    assert Evaluation.load(tmp_path / "heuristic.json") == result
    assert [path.name for path in tmp_path.iterdir()] == ["heuristic.json"]


def test_json_has_the_keys_of_the_command_line() -> None:
    result = evaluation()
    data = result.to_json()
    assert data["protocol"] == "paper"
    parameters = data["protocol_parameters"]
    assert parameters["physics"]["friction"] == 0.8
    assert [phase["phase"] for phase in parameters["phases"]] == ["close", "shake", "carry"]
    assert (data["model"], data["n"], data["seed"], data["per_cell"]) == ("heuristic", 54 * 20, 0, 20)
    assert data["held"] == {"rate": result.held.rate, "low": result.held.low, "high": result.held.high}
    assert data["faithful"].keys() == data["held"].keys()
    assert data["cells"][0].keys() >= {"grasp_type", "object", "n", "held", "faithful"}
    for split in ("by_type", "by_object"):
        summed = {v: sum(tally.get(v, 0) for tally in data["verdicts"][split].values()) for v in VERDICTS}
        assert summed == dict.fromkeys(VERDICTS, 0) | data["verdicts"]["overall"]
    assert list(data["verdicts"]["by_type"]) == list(GRASP_TYPES)


def edited(change: Callable[[dict[str, Any]], Any]) -> str:
    data = evaluation().to_json()
    change(data)
    return json.dumps(data)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        '{"rate": 0.9}',
        edited(lambda d: d.pop("cells")),
        edited(lambda d: d.update(schema_version=99)),
        edited(lambda d: d.update(cells=[])),
        edited(lambda d: d["cells"].pop()),
        edited(lambda d: d["cells"].append(d["cells"][0])),
        edited(lambda d: d["held"].update(rate=0.99)),
        edited(lambda d: d["cells"][0].update(held=d["cells"][0]["held"] + 1)),
        edited(lambda d: d["cells"][0].update(faithful=10**6)),
        edited(lambda d: d["cells"][0].update(steady=10**6)),
        edited(lambda d: d["cells"][0]["verdicts"].update(missed="many")),
        edited(lambda d: d["protocol_parameters"].update(luck=1.0)),
        edited(lambda d: d.update(protocol="lenient")),
        edited(lambda d: d.update(versions=3)),
    ],
)
def test_foreign_and_doctored_files_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "heuristic.json"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=r"heuristic\.json"):
        Evaluation.load(path)


def test_an_evaluation_of_before_turns_were_recorded_says_nothing_of_them(tmp_path: Path) -> None:
    without = evaluation(seed=3)
    assert without.total.steady is None
    assert without.total.steady_rate is None
    assert "steady" not in without.to_json()
    without.save(tmp_path / "old.json")
    assert Evaluation.load(tmp_path / "old.json") == without


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="nothing"):
        Evaluation.load(tmp_path / "nothing.json")
