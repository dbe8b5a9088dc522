"""Evaluation: runs that depend on seeds alone, and records that survive their files."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from graspcascade.candidates import cannot_touch, draw_sides
from graspcascade.cells import CELLS
from graspcascade.dataset import load_dataset
from graspcascade.errors import FileFormatError, InputError
from graspcascade.evaluation import (
    ROUND_PER_CELL,
    Cell,
    Evaluation,
    Source,
    evaluate,
    heuristic_source,
    model_source,
    runs,
    store,
    wilson,
)
from graspcascade.files import LOCK_FILE, sole_writer
from graspcascade.grasps import Grasps
from graspcascade.hands import SHADOW_HAND, HandModel, shadow_hand
from graspcascade.objects import CATALOGUE, grasp_object
from graspcascade.poses import Pose
from graspcascade.postures import PosturePrior
from graspcascade.taxonomy import GRASP_TYPES
from graspcascade.trials import PAPER, TOUCH_COLUMNS, VERDICTS, Outcomes, Protocol, run

TWO_CELLS = (("box_medium", "tripod"), ("cylinder_small", "tip_pinch"))
ASKED: dict[str, Any] = {"per_cell": 1, "seed": 0, "cells": TWO_CELLS}
JOINTS = SHADOW_HAND.joint_names


def stub(types: np.ndarray, labels: np.ndarray, axes: np.ndarray, rng: np.random.Generator) -> Grasps:
    """Draw grasps that mean nothing; the fake physics below reads its verdicts off them."""
    n = len(types)
    quat = rng.normal(size=(n, 4))
    return Grasps(
        joint_names=JOINTS,
        grasp_type=types,
        object_label=labels,
        side_axis=axes,
        side_m=np.array([grasp_object(o).sides_m[a] for o, a in zip(labels, axes, strict=True)]),
        posture=rng.uniform(0, 1, (n, len(JOINTS))),
        pregrasp=np.zeros((n, len(JOINTS))),
        X_hand_object=Pose(rng.normal(size=(n, 3)), quat / np.linalg.norm(quat, axis=1, keepdims=True)),
        grasp_size_m=np.full(n, 0.03),
        object_size_m=np.full(n, np.nan),
        probability=np.full(n, np.nan),
    )


def fake_run(grasps: Grasps, protocol: Protocol, *, progress: Callable[[int], None], **_: Any) -> Outcomes:
    """Decide by the posture alone: no physics, the same answer to the same grasp."""
    outcomes = Outcomes.blank(len(grasps), len(JOINTS))
    share = grasps.posture[:, 0]
    outcomes.verdict[:] = np.where(share < 0.5, "held", np.array(VERDICTS)[1:][(share * 1000).astype(int) % 5])
    outcomes.touching_end[:, : len(TOUCH_COLUMNS)] = (share < 0.3)[:, None]
    progress(len(grasps))
    return outcomes


@pytest.fixture
def no_physics(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Put the fake in the runner's place and record how many trials each round executed."""
    executed: list[int] = []

    def counted(grasps: Grasps, protocol: Protocol = PAPER, **options: Any) -> Outcomes:
        executed.append(len(grasps))
        return fake_run(grasps, protocol, **options)

    monkeypatch.setattr(runs, "run", counted)
    return executed


def evaluation(
    model: str = "heuristic", seed: int = 0, per_cell: int = 20, held_share: float = 0.5, **changes: Any
) -> Evaluation:
    """Make up an evaluation of all 54 cells."""
    rng = np.random.default_rng(seed)
    cells = []
    for label, kind in CELLS:
        held = int(rng.binomial(per_cell, held_share))
        rest = rng.multinomial(per_cell - held, [0.2] * 5).tolist()
        cells.append(Cell(dict(zip(VERDICTS, [held, *rest], strict=True)), int(rng.integers(held + 1)), kind, label))
    found = Evaluation(PAPER, model, SHADOW_HAND.name, tuple(cells), seed, per_cell, {"mujoco": "3.17.0"}, {})
    return replace(found, **changes)


# --- runs


def test_every_cell_gets_the_trials_asked_for(no_physics: list[int]) -> None:
    found = evaluate("stub", stub, per_cell=3, seed=0)
    assert [(cell.object_label, cell.grasp_type) for cell in found.cells] == list(CELLS)
    assert {cell.n for cell in found.cells} == {3}
    assert found.n == 3 * len(CELLS) == sum(no_physics)
    assert found.held == wilson(sum(cell.held for cell in found.cells), found.n)
    assert found.faithful == wilson(sum(cell.faithful for cell in found.cells), found.n)


def test_counts_are_those_of_the_outcomes(no_physics: list[int]) -> None:
    drawn: list[Grasps] = []

    def recorded(*args: Any) -> Grasps:
        drawn.append(stub(*args))
        return drawn[-1]

    found = evaluate("stub", recorded, per_cell=ROUND_PER_CELL + 3, seed=1, cells=TWO_CELLS)
    grasps = Grasps.concatenate(drawn)
    outcomes = fake_run(grasps, PAPER, progress=lambda _: None)
    for cell in found.cells:
        rows = (grasps.object_label == cell.object_label) & (grasps.grasp_type == cell.grasp_type)
        assert dict(cell.verdicts) == {verdict: int((outcomes.verdict[rows] == verdict).sum()) for verdict in VERDICTS}
        assert cell.faithful == int(outcomes.faithful(grasps)[rows].sum())
    assert len(drawn) == 2


def test_the_seed_alone_decides(no_physics: list[int]) -> None:
    one, again, other = (evaluate("stub", stub, per_cell=30, seed=s, cells=TWO_CELLS) for s in (5, 5, 6))
    assert one == again
    assert one.cells != other.cells


def test_sides_are_drawn_evenly_from_the_graspable_ones(no_physics: list[int]) -> None:
    seen: list[str] = []

    def recorded(types: np.ndarray, labels: np.ndarray, axes: np.ndarray, rng: np.random.Generator) -> Grasps:
        seen.extend(axes.tolist())
        return stub(types, labels, axes, rng)

    evaluate("stub", recorded, per_cell=600, seed=0, cells=[("box_large", "tripod")])
    assert set(seen) == set(grasp_object("box_large").graspable_sides_m) == {"x", "y"}
    assert seen.count("x") == pytest.approx(300, abs=60)


def test_progress_goes_from_nothing_to_all(no_physics: list[int]) -> None:
    told: list[tuple[int, int]] = []
    evaluate(
        "stub", stub, per_cell=25, seed=0, cells=TWO_CELLS, progress=lambda done, total: told.append((done, total))
    )
    assert told[0] == (0, 50)
    assert told[-1] == (50, 50)
    assert [done for done, _ in told] == sorted(done for done, _ in told)


class CutOffError(Exception):
    """Stand for whatever ends a process."""


def cut_off_after(rounds: int) -> Source:
    left = iter(range(rounds))

    def draw(*args: Any) -> Grasps:
        if next(left, None) is None:
            raise CutOffError
        return stub(*args)

    return draw


@pytest.mark.parametrize("rounds", [0, 1, 2])
def test_a_resumed_evaluation_equals_an_uninterrupted_one(tmp_path: Path, no_physics: list[int], rounds: int) -> None:
    asked: dict[str, Any] = {"per_cell": 2 * ROUND_PER_CELL + 5, "seed": 3, "cells": TWO_CELLS, "out": tmp_path / "run"}
    with pytest.raises(CutOffError):
        evaluate("stub", cut_off_after(rounds), **asked)
    assert not (tmp_path / "run" / "evaluation.json").exists()
    resumed = evaluate("stub", stub, **asked)
    assert resumed == evaluate("stub", stub, **asked | {"out": None})
    assert sum(no_physics) == 2 * resumed.n  # no trial was executed twice for the resumed one
    assert Evaluation.load(tmp_path / "run" / "evaluation.json") == resumed


def test_a_finished_evaluation_is_not_run_again(tmp_path: Path, no_physics: list[int]) -> None:
    asked: dict[str, Any] = {"per_cell": 4, "seed": 3, "cells": TWO_CELLS, "out": tmp_path / "run"}
    first = evaluate("stub", stub, **asked)
    text = (tmp_path / "run" / "evaluation.json").read_bytes()
    no_physics.clear()
    assert evaluate("stub", stub, **asked) == first
    assert (tmp_path / "run" / "evaluation.json").read_bytes() == text
    assert no_physics == []


def test_stored_rows_are_a_dataset(tmp_path: Path, no_physics: list[int]) -> None:
    pytest.importorskip("pyarrow")
    found = evaluate("stub", stub, per_cell=25, seed=0, cells=TWO_CELLS, out=tmp_path / "run")
    rows = load_dataset(tmp_path / "run")
    assert len(rows.grasps) == found.n
    assert int(rows.outcomes.held.sum()) == found.total.held
    assert int(rows.outcomes.faithful(rows.grasps).sum()) == found.total.faithful


@pytest.mark.parametrize(("how", "lost"), [("missing", [0]), ("missing", [1]), ("changed", [0, 2])])
def test_lost_rows_are_executed_again_and_the_others_kept(
    tmp_path: Path, no_physics: list[int], how: str, lost: list[int]
) -> None:
    pytest.importorskip("pyarrow")
    asked: dict[str, Any] = {"per_cell": 2 * ROUND_PER_CELL + 5, "seed": 0, "cells": TWO_CELLS, "out": tmp_path}
    first = evaluate("stub", stub, **asked)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for number in lost:
        path = tmp_path / f"part-{number:05d}.parquet"
        path.unlink() if how == "missing" else path.write_bytes(path.read_bytes()[:-9])
    expected = [no_physics[number] for number in lost]
    no_physics.clear()
    with pytest.raises(CutOffError):
        evaluate("stub", cut_off_after(1 + len(lost[1:])), **asked)  # the first draw tells the source
    told: list[int] = []
    assert evaluate("stub", stub, **asked, progress=lambda done, _: told.append(done)) == first
    assert no_physics == expected
    assert (told[0], told[-1]) == (first.n - expected[-1], first.n)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert len(load_dataset(tmp_path).grasps) == first.n


def test_rows_lost_by_an_unfinished_evaluation_do_not_change_it(tmp_path: Path, no_physics: list[int]) -> None:
    pytest.importorskip("pyarrow")
    asked: dict[str, Any] = {"per_cell": 3 * ROUND_PER_CELL, "seed": 0, "cells": TWO_CELLS}
    with pytest.raises(CutOffError):
        evaluate("stub", cut_off_after(2), **asked, out=tmp_path)
    (tmp_path / "part-00000.parquet").unlink()
    assert evaluate("stub", stub, **asked, out=tmp_path) == evaluate("stub", stub, **asked)
    assert [shard["file"] for shard in load_dataset(tmp_path).metadata["shards"]] == [
        f"part-{number:05d}.parquet" for number in range(3)
    ]


def test_rows_that_were_never_written_are_not_lost(
    tmp_path: Path, no_physics: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyarrow")
    asked: dict[str, Any] = {"per_cell": 2 * ROUND_PER_CELL, "seed": 0, "cells": TWO_CELLS, "out": tmp_path}
    with monkeypatch.context() as patch:
        patch.setattr(store, "find_spec", lambda _: None)
        with pytest.raises(CutOffError):
            evaluate("stub", cut_off_after(1), **asked)
    first = evaluate("stub", stub, **asked)
    assert [path.name for path in tmp_path.glob("*.parquet")] == ["part-00001.parquet"]
    (tmp_path / "part-00001.parquet").unlink()
    no_physics.clear()
    with monkeypatch.context() as patch:
        patch.setattr(store, "find_spec", lambda _: None)
        assert evaluate("stub", stub, **asked) == first
    assert no_physics == []  # nothing could be written
    assert evaluate("stub", stub, **asked) == first
    assert no_physics == [ROUND_PER_CELL * len(TWO_CELLS)]
    assert (tmp_path / "part-00001.parquet").exists()


def test_without_pyarrow_an_evaluation_resumes_from_its_counts(
    tmp_path: Path, no_physics: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "find_spec", lambda _: None)
    asked: dict[str, Any] = {"per_cell": 25, "seed": 0, "cells": TWO_CELLS, "out": tmp_path / "run"}
    with pytest.raises(CutOffError):
        evaluate("stub", cut_off_after(1), **asked)
    assert evaluate("stub", stub, **asked) == evaluate("stub", stub, **asked | {"out": None})
    assert not list((tmp_path / "run").glob("*.parquet"))


@pytest.mark.parametrize(
    "change",
    [
        {"per_cell": 5},
        {"seed": 1},
        {"protocol": replace(PAPER, friction=1.0)},
        {"cells": TWO_CELLS[:1]},
        {"metadata": {"weights": "b"}},
        {"hand": replace(SHADOW_HAND, name="another")},
        {"hand": replace(SHADOW_HAND, pregrasp_rad={})},
    ],
)
def test_a_folder_with_other_arguments_is_refused(
    tmp_path: Path, no_physics: list[int], change: dict[str, Any]
) -> None:
    asked: dict[str, Any] = {"per_cell": 4, "seed": 0, "cells": TWO_CELLS, "out": tmp_path / "run"}
    evaluate("stub", stub, **asked, metadata={"weights": "a"})
    before = {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    with pytest.raises(InputError, match="same arguments"):
        evaluate("stub", stub, **{"metadata": {"weights": "a"}} | asked | change)
    assert {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before


def test_a_retrained_model_under_the_same_name_is_refused(tmp_path: Path, no_physics: list[int]) -> None:
    def retrained(*args: Any) -> Grasps:
        grasps = stub(*args)
        return replace(grasps, posture=grasps.posture + 0.01)

    evaluate("stub", stub, per_cell=4, seed=0, cells=TWO_CELLS, out=tmp_path / "run")
    with pytest.raises(InputError, match="another model"):
        evaluate("stub", retrained, per_cell=4, seed=0, cells=TWO_CELLS, out=tmp_path / "run")


def test_a_folder_with_other_files_is_refused(tmp_path: Path, no_physics: list[int]) -> None:
    (tmp_path / "precious.txt").write_text("mine")
    with pytest.raises(InputError, match="not empty"):
        evaluate("stub", stub, per_cell=1, seed=0, cells=TWO_CELLS, out=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["precious.txt"]
    (tmp_path / "metadata.json").write_text("{")
    with pytest.raises(FileFormatError):
        evaluate("stub", stub, per_cell=1, seed=0, cells=TWO_CELLS, out=tmp_path)


def test_a_folder_has_one_evaluation_at_a_time(tmp_path: Path, no_physics: list[int]) -> None:
    asked: dict[str, Any] = {"per_cell": 4, "seed": 0, "cells": TWO_CELLS, "out": tmp_path}

    def meddled(*args: Any) -> Grasps:
        with pytest.raises(InputError, match="another process is writing to"), sole_writer(tmp_path):
            raise AssertionError
        return stub(*args)

    with sole_writer(tmp_path), pytest.raises(InputError, match="another process is writing to"):
        evaluate("stub", meddled, **asked)
    assert no_physics == []
    (tmp_path / LOCK_FILE).touch()  # as a crash leaves it
    evaluate("stub", meddled, **asked)
    assert LOCK_FILE not in {path.name for path in tmp_path.iterdir()}
    with sole_writer(tmp_path):
        pass


def test_the_record_is_written_before_others_may_write(
    tmp_path: Path, no_physics: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    save, saved = Evaluation.save, []

    def meddled(found: Evaluation, path: Path) -> None:
        with pytest.raises(InputError, match="another process is writing to"), sole_writer(tmp_path):
            raise AssertionError
        save(found, path)
        saved.append(path.name)

    monkeypatch.setattr(Evaluation, "save", meddled)
    evaluate("stub", stub, **ASKED, out=tmp_path)
    assert saved == ["evaluation.json"]


def test_what_a_killed_evaluation_left_is_no_hindrance(tmp_path: Path, no_physics: list[int]) -> None:
    (tmp_path / ".metadata.json.4711.staged").write_text("{")
    found = evaluate("stub", stub, **ASKED, out=tmp_path)
    assert Evaluation.load(tmp_path / "evaluation.json") == found
    assert not list(tmp_path.glob(".*"))


def test_an_evaluation_whose_traceback_is_kept_does_not_keep_its_folder(tmp_path: Path, no_physics: list[int]) -> None:
    asked: dict[str, Any] = {"per_cell": 2 * ROUND_PER_CELL, "seed": 0, "cells": TWO_CELLS, "out": tmp_path}
    with pytest.raises(CutOffError) as kept:
        evaluate("stub", cut_off_after(1), **asked)
    assert evaluate("stub", stub, **asked) == evaluate("stub", stub, **asked | {"out": None})
    assert kept.tb is not None


def test_a_heuristic_of_another_hands_joints_is_refused(hand: HandModel, prior: PosturePrior) -> None:
    with pytest.raises(InputError, match="in order"):
        heuristic_source(hand, replace(prior, joint_names=prior.joint_names[::-1]))


def test_a_screened_heuristic_gives_what_can_touch_for_the_rows_asked_for(hand: HandModel) -> None:
    prior, rng = PosturePrior.pretrained(), np.random.default_rng(0)
    labels = rng.choice(list(CATALOGUE), 150)
    asked = rng.choice(list(GRASP_TYPES), 150), labels, draw_sides(labels, rng)
    plain = heuristic_source(hand, prior)(*asked, np.random.default_rng(1))
    assert cannot_touch(hand, plain).any()
    screened = heuristic_source(hand, prior, most_draws=200)(*asked, np.random.default_rng(1))
    assert not cannot_touch(hand, screened).any()
    assert [screened.grasp_type.tolist(), screened.object_label.tolist()] == [asked[0].tolist(), labels.tolist()]
    assert screened.side_axis.tolist() == plain.side_axis.tolist()
    kept = ~cannot_touch(hand, plain)
    assert (screened.posture[kept] == plain.posture[kept]).all()


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"per_cell": 0}, "at least 1"),
        ({"seed": -1}, "negative"),
        ({"cells": ()}, "at least one cell"),
        ({"cells": TWO_CELLS + TWO_CELLS}, "once"),
        ({"cells": [("box_mediun", "tripod")]}, "box_medium"),
        ({"cells": [("box_medium", "tripot")]}, "tripod"),
        ({"metadata": {"weights": object()}}, "plain JSON"),
    ],
)
def test_bad_arguments_are_refused_before_any_trial(no_physics: list[int], change: dict[str, Any], word: str) -> None:
    with pytest.raises(InputError, match=word):
        evaluate("stub", stub, **ASKED | change)
    assert no_physics == []


@pytest.mark.parametrize(
    "cheat",
    [
        lambda grasps: grasps[1:],
        lambda grasps: replace(grasps, grasp_type=np.full(len(grasps), "tripod")),
        lambda grasps: replace(grasps, side_axis=np.full(len(grasps), "x")),
        lambda grasps: replace(grasps, joint_names=grasps.joint_names[::-1]),
    ],
)
def test_a_source_that_answers_another_question_is_refused(
    no_physics: list[int], cheat: Callable[[Grasps], Grasps]
) -> None:
    with pytest.raises(InputError, match="source"):
        evaluate("cheat", lambda *args: cheat(stub(*args)), per_cell=8, seed=0, cells=TWO_CELLS)
    assert no_physics == []


def test_a_sampler_is_asked_for_rows(no_physics: list[int]) -> None:
    class Sampler:
        def sample_rows(self, *args: Any) -> Grasps:
            return stub(*args)

    one = evaluate("stub", model_source(Sampler()), per_cell=2, seed=0, cells=TWO_CELLS)
    assert one == evaluate("stub", stub, per_cell=2, seed=0, cells=TWO_CELLS)


def test_the_heuristic_is_executed_unscreened_in_real_physics() -> None:
    hand, executed = shadow_hand(), []
    heuristic = heuristic_source(hand, PosturePrior.pretrained())

    def recorded(*args: Any) -> Grasps:
        executed.append(heuristic(*args))
        return executed[-1]

    cells = [("sphere_medium", "tripod"), ("sphere_medium", "tip_pinch")]
    found = evaluate("heuristic", recorded, per_cell=4, seed=0, cells=cells, n_threads=1)
    outcomes = run(executed[0], PAPER, n_threads=2)
    assert found.n == len(executed[0]) == 8
    assert found.total.held == int(outcomes.held.sum())
    assert found.total.faithful == int(outcomes.faithful(executed[0]).sum())


def test_evaluating_needs_neither_torch_nor_pyarrow() -> None:
    code = "import sys, graspcascade.evaluation; assert not {'torch', 'pyarrow'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


# --- records


def test_an_evaluation_survives_its_file(tmp_path: Path) -> None:
    found = evaluation(model_metadata={"training": {"epochs": 3, "widths": [64, 64]}})
    found.save(tmp_path / "heuristic.json")
    assert Evaluation.load(tmp_path / "heuristic.json") == found
    assert [path.name for path in tmp_path.iterdir()] == ["heuristic.json"]


def test_json_has_the_keys_of_the_command_line() -> None:
    found = evaluation()
    data = found.to_json()
    assert data["protocol"] == "paper"
    assert data["protocol_parameters"]["friction"] == 0.8
    assert (data["model"], data["n"], data["seed"], data["per_cell"]) == ("heuristic", 54 * 20, 0, 20)
    assert data["held"] == {"rate": found.held.rate, "low": found.held.low, "high": found.held.high}
    assert data["faithful"].keys() == data["held"].keys()
    assert data["cells"][0].keys() >= {"grasp_type", "object", "n", "held", "faithful"}
    for split in ("by_type", "by_object"):
        summed = {v: sum(tally[v] for tally in data["verdicts"][split].values()) for v in VERDICTS}
        assert summed == data["verdicts"]["overall"]
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


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="nothing"):
        Evaluation.load(tmp_path / "nothing.json")
