"""The command line: what each verb prints and writes, and one line with exit status 2 for what it cannot use."""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import Call, assert_refused
from graspcascade.cli import VERBS, main
from graspcascade.cli.console import Bar
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import CATALOGUE
from graspcascade.core.outcomes import VERDICTS, Outcomes
from graspcascade.core.poses import Pose
from graspcascade.core.protocols import PAPER
from graspcascade.core.tasks import draw_tasks
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.formats import GraspDocument, load_document, load_grasps, save_grasps
from graspcascade.hands import Hand, load_hand
from graspcascade.nets import TrainingSpec
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.heuristic import place
from graspcascade.proposals.prior import PosturePrior
from graspcascade.studies.collect import CollectionState
from graspcascade.studies.dataset import SCHEMA_VERSION, shard_path, to_columns, write_metadata, write_shard
from graspcascade.studies.executor import run_jobs
from graspcascade.studies.learn import fit_prior
from graspcascade.studies.postures import LabelledPostures, export_postures, import_postures
from graspcascade.studies.rounds import CELLS
from hand_files import write_hand
from test_studies_executor import be_killed


def python(*arguments: str, encoding: str = "utf-8", folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        cwd=folder,
        env=os.environ | {"PYTHONIOENCODING": encoding},
    )


@pytest.fixture(scope="module")
def data(hand: Hand, prior: PosturePrior, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a dataset folder of candidates that are said to have held."""
    folder = tmp_path_factory.mktemp("data")
    rng = np.random.default_rng(0)
    tasks = draw_tasks(CELLS, 6, hand.reach_m, rng)
    grasps = place(hand, prior.sample(tasks.grasp_type, rng), tasks, rng)
    outcomes = Outcomes.blank(len(grasps), len(hand.joint_names), hand.digits)
    outcomes.verdict[:] = "held"
    outcomes.touching_closed[:] = outcomes.touching_end[:] = True
    outcomes.object_size_m[:] = grasps.grasp_size_m + 0.01
    outcomes.settled_posture[:] = grasps.posture
    outcomes.X_hand_object_settled.position_m[:] = grasps.X_hand_object.position_m
    outcomes.X_hand_object_settled.quat_wxyz[:] = grasps.X_hand_object.quat_wxyz
    digest = write_shard(shard_path(folder, 0), to_columns(grasps, outcomes))
    metadata = {
        "schema_version": SCHEMA_VERSION,
        "hand": hand.name,
        "joint_names": list(hand.joint_names),
        "pregrasp_rad": hand.pregrasp.tolist(),
        "protocol": PAPER.to_json(),
        "shards": [{"file": shard_path(folder, 0).name, "sha256": digest, "rows": len(grasps)}],
    }
    write_metadata(folder, metadata)
    return folder


@pytest.fixture(scope="module")
def model(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train a cascade for a moment, by the command line."""
    folder = tmp_path_factory.mktemp("models") / "tiny"
    assert main(["train", "--data", str(data), "--out", str(folder), "--epochs", "1", "--batch-size", "64"]) == 0
    return folder


@pytest.fixture
def saved(drawn: Grasps, tmp_path: Path) -> Path:
    """Save three candidates for a trial, the last far out of reach."""
    grasps = drawn[[0, 10, 20]]
    grasps.X_hand_object.position_m[2] += 0.3
    save_grasps(tmp_path / "grasps.json", grasps, metadata={"model": "by hand"})
    return tmp_path / "grasps.json"


def hand_file(hand: Hand) -> Path:
    """Name the file that a hand of the tests was read from."""
    assert hand.mjcf is not None
    return hand.mjcf.with_name("hand.yaml")


# -- the command as a whole


def test_help_lists_every_verb_and_each_verb_has_its_own(call: Call) -> None:
    overview = call("--help")
    assert overview.status == 0
    for verb in VERBS:
        assert f"  {verb} " in overview.out
        said = call(verb, "--help")
        assert (said.status, said.err) == (0, "")
        assert f"usage: graspcascade {verb}" in said.out


def test_the_version_is_told(call: Call) -> None:
    assert call("--version").out.startswith("graspcascade ")


def test_a_missing_or_unknown_verb_is_refused_with_the_valid_ones(call: Call) -> None:
    assert_refused(call(), "give a command", "sample")
    assert_refused(call("smaple"), "Did you mean 'sample'")


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["sample", "tripod"], "OBJECT"),
        (["sample", "tripod", "box_medium", "--n", "many"], "--n"),
        (["sample", "tripod", "box_medium", "--colour", "red"], "--colour"),
        (
            ["sample", "tripod", "box_medium", "--object-pose", "0", "1", "2"],
            "pose: 7 values are needed, got 3",
        ),
        (["sample", "tripod", "box_medium", "--n", "1e3"], "--n: a whole number is needed, got '1e3'"),
        (["sample", "tripod", "box_medium", "--side-cm", "wide"], "--side-cm: unfit values ['wide']"),
        (["trial", "grasps.json", "--threads"], "--threads"),
        (["collect", "--out", "x", "--trials-per-cell", "-1"], "collect: trials_per_cell must not be negative, got -1"),
        (["collect", "--out", "x", "--seed", "-1"], "seed must not be negative, got -1"),
        (["prior", "--epochs", "0"], "epochs must be at least 1"),
        (["train", "--data", "x"], "--out"),
        (["hands", "draw"], "draw"),
        (["export", "g.json", "--out", "h.json", "--settle", "--no-settle"], "--settle or --no-settle, not both"),
        (["export", "g.json", "--out", "h.json", "--no_settle", "--settle"], "--settle or --no-settle, not both"),
    ],
)
def test_arguments_that_cannot_be_read_are_one_line(
    call: Call, arguments: list[str], word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_refused(call(*arguments), word, f"graspcascade {arguments[0]} --help")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_the_one_line_is_the_same_on_any_terminal(encoding: str) -> None:
    done = python("-m", "graspcascade", "sample", "tripod", encoding=encoding)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
    assert done.stderr.startswith("graspcascade sample: Missing from graspcascade sample: OBJECT")


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        (["sample", "tripod", "box_m\udc80dium"], 2),
        (["sample", "tripod", "bo\N{LATIN SMALL LETTER X WITH DOT ABOVE}"], 2),
        (["sample", "tripod", "box_medium", "--n", "1", "--out", "\udcff\N{SNOWMAN}.json"], 0),
        (["objects"], 0),
        (["hands", "show"], 0),
        (["sample", "--help"], 0),
    ],
)
def test_what_a_terminal_cannot_show_is_shown_by_its_code(arguments: list[str], status: int, tmp_path: Path) -> None:
    done = python("-m", "graspcascade", *arguments, encoding="ascii", folder=tmp_path)
    assert (done.returncode, "Traceback" in done.stderr) == (status, False)
    assert done.stdout.isascii()
    assert done.stderr.isascii()


def test_a_closed_output_is_no_complaint() -> None:
    command = f"{sys.executable} -m graspcascade objects >&-"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_shell_sees_status_and_one_line_without_a_traceback() -> None:
    done = python("-m", "graspcascade", "hands", "show", "shadwo")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("graspcascade hands: unknown hand 'shadwo'")
    assert len(done.stderr.splitlines()) == 1
    done = python("-m", "graspcascade", "objects", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)


def test_an_interruption_is_130_and_says_how_to_go_on(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("graspcascade.cli.learning.collect", interrupted)
    said = call("collect", "--out", tmp_path / "data")
    assert said.status == 130
    assert said.err == (
        "graspcascade collect: interrupted; what is finished is kept: run the same command again to go on\n"
    )


def test_trouble_with_the_disk_is_status_1_and_one_line(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr("graspcascade.cli.learning.collect", full)
    said = call("collect", "--out", tmp_path / "data")
    assert (said.status, said.err) == (1, "graspcascade collect: no space left on device\n")


@pytest.mark.parametrize("cause", [[], ["Unable to allocate 8.00 GiB"]])
def test_a_want_of_memory_is_status_1_and_one_line(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cause: list[str]
) -> None:
    def greedy(*_: object, **__: object) -> None:
        raise MemoryError(*cause)

    monkeypatch.setattr("graspcascade.cli.learning.collect", greedy)
    said = call("collect", "--out", tmp_path / "data")
    assert (said.status, said.out) == (1, "")
    assert said.err == ": ".join(["graspcascade collect: not enough memory for this collect", *cause]) + "\n"


def test_a_killed_worker_is_status_1_and_one_line(call: Call, data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("graspcascade.studies.learn.run_jobs", lambda jobs, *_: run_jobs([be_killed, be_killed], 2))
    said = call("train", "--data", data, "--out", data / "model", "--epochs", 1)
    assert (said.status, said.out) == (1, "")
    assert "graspcascade train: a worker process ended with SIGKILL(-9)" in said.err
    assert len(said.err.splitlines()) == 1
    assert not (data / "model").exists()


def test_a_reader_that_leaves_early_causes_no_complaint() -> None:
    command = [sys.executable, "-m", "graspcascade", "objects", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""


# -- sample


def test_sample_prints_a_line_for_each_grasp(call: Call, model: Path) -> None:
    said = call("sample", "tripod", "box_medium", "--side-cm", 3, "--n", 4, "--model", model)
    assert (said.status, said.err) == (0, "")
    assert [line.split()[:3] for line in said.out.splitlines() if line.strip()[:1].isdigit()] == [
        [str(i), "x", "3"] for i in range(4)
    ]


def test_without_a_model_the_shipped_one_answers(call: Call) -> None:
    rows = call("sample", "tripod", "box_medium", "--side-cm", 3, "--n", 2, "--json").json["grasps"]
    assert [row["side_m"] for row in rows] == [0.03, 0.03]


def test_sample_tells_what_was_measured_of_such_grasps(call: Call, model: Path) -> None:
    cell = call("sample", "tip_pinch", "cylinder_medium", "--n", 1, "--json").json["metadata"]["measured"]
    found = cell["tip_pinch/cylinder_medium"]
    assert 0 < found["held"] < found["n"]
    said = call("sample", "tip_pinch", "cylinder_medium", "--n", 1).out
    share = f"{100 * found['held'] / found['n']:.1f} %"
    assert f"Of {found['n']} such grasps, tried under protocol paper, held: {share}" in said
    # A model without its evaluation has nothing to tell.
    assert "such grasps" not in call("sample", "tip_pinch", "cylinder_medium", "--n", 1, "--model", model).out


def test_sample_json_is_what_a_json_file_holds(call: Call, model: Path, tmp_path: Path) -> None:
    asked = ["sample", "tip_pinch", "cylinder_small", "--n", 3, "--seed", 5, "--model", model]
    printed = call(*asked, "--json").json
    said = call(*asked, "--out", tmp_path / "g.json")
    assert said.out == f"wrote 3 grasps to {tmp_path / 'g.json'}\n"
    assert json.loads((tmp_path / "g.json").read_text()) == printed
    metadata = printed["metadata"]
    assert (metadata["model"], metadata["asked"]["seed"]) == ("model3", 5)
    assert set(metadata["versions"]) == {"graspcascade", "numpy"}
    assert metadata["hand"] == "shadow_hand_right"


def test_the_suffix_of_out_picks_the_format(call: Call, model: Path, tmp_path: Path) -> None:
    for name in ("g.json", "g.parquet"):
        assert (
            call("sample", "tripod", "sphere_small", "--n", 2, "--model", model, "--out", tmp_path / name).status == 0
        )
    one, other = load_grasps(tmp_path / "g.json"), load_grasps(tmp_path / "g.parquet")
    np.testing.assert_array_equal(one.posture, other.posture)


def test_the_same_seed_gives_the_same_grasps(call: Call, model: Path) -> None:
    asked = ["sample", "tripod", "box_medium", "--model", model, "--n", 2, "--json", "--seed"]
    first = call(*asked, 1).out
    assert call(*asked, 1).out == first
    assert call(*asked, 2).out != first


def test_a_side_is_the_same_by_length_and_by_axis(call: Call, model: Path) -> None:
    asked = ["sample", "tripod", "box_medium", "--model", model, "--n", 2, "--json"]
    by_length = call(*asked, "--side-cm", 4.5).json["grasps"]
    assert by_length == call(*asked, "--side-axis", "y").json["grasps"]
    assert {row["side_axis"] for row in by_length} == {"y"}


def test_without_a_side_graspable_ones_are_drawn(call: Call, model: Path) -> None:
    rows = call("sample", "tripod", "box_large", "--model", model, "--n", 40, "--json").json["grasps"]
    assert {row["side_axis"] for row in rows} == {"x", "y"}


def test_an_object_pose_gives_hand_poses_that_keep_the_relative_pose(call: Call, model: Path, tmp_path: Path) -> None:
    numbers = [0.4, -1e-3, 0.1, 0.5, 0.5, -0.5, 0.5]
    asked = ["sample", "tripod", "box_medium", "--model", model, "--n", 2, "--object-pose", *numbers]
    assert "hand (palm) frame in the world" in call(*asked).out
    rows = call(*asked, "--json", "--out", tmp_path / "g.json").json["grasps"]
    hand = Pose.of(*([row["X_world_hand"][key] for row in rows] for key in ("position_m", "quat_wxyz")))
    found = hand @ load_grasps(tmp_path / "g.json").X_hand_object
    np.testing.assert_allclose(found.position_m, [numbers[:3]] * 2, atol=1e-12)
    assert load_document(tmp_path / "g.json").X_world_object is not None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["tripodd", "box_medium"], ["unknown grasp type 'tripodd'", "Did you mean 'tripod'"]),
        (["tripod", "box_mediun"], ["unknown object 'box_mediun'", "Did you mean 'box_medium'"]),
        (["tripod", "box_medium", "--side-cm", "3.7"], ["no side of 3.7 cm", "x = 3 cm, y = 4.5 cm, z = 6 cm"]),
        (["tripod", "box_medium", "--side-cm", "30"], ["no side of 30 cm", "were millimetres meant?"]),
        (["tripod", "box_medium", "--object-pose", "400", "0", "100", "1", "0", "0", "0"], ["were millimetres meant?"]),
        (["tripod", "box_large", "--side-cm", "7"], ["beyond the hand's reach", "x = 4 cm, y = 5.5 cm"]),
        (["tripod", "box_large", "--side-axis", "z"], ["beyond the hand's reach"]),
        (["tripod", "box_medium", "--side-cm", "nan"], ["positive length"]),
        (["tripod", "box_medium", "--side-cm", "-3"], ["positive length"]),
        (["tripod", "box_medium", "--side-axis", "w"], ["unknown side axis 'w'"]),
        (["tripod", "box_medium", "--side-cm", "3", "--side-axis", "x"], ["not both"]),
        (["tripod", "box_medium", "--n", "0"], ["n must be at least 1, got 0"]),
        (["tripod", "box_medium", "--n", "-4"], ["n must be at least 1, got -4"]),
        (["tripod", "box_medium", "--seed", "-1"], ["seed must not be negative"]),
        (["tripod", "box_medium", "--object-pose", "0", "0", "0", "1", "1", "0", "0"], ["norm 1"]),
        (["tripod", "box_medium", "--object-pose", "0", "0", "0", "0", "0", "0", "0"], ["norm 1"]),
        (["tripod", "box_medium", "--object-pose", "nan", "0", "0", "1", "0", "0", "0"], ["finite"]),
        (["tripod", "box_medium", "--object-pose", "0", "0", "-inf", "1", "0", "0", "0"], ["finite"]),
    ],
)
def test_sample_refuses_what_it_cannot_do_and_writes_nothing(
    call: Call, model: Path, tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    kept, fresh = tmp_path / "kept.json", tmp_path / "fresh.json"
    kept.write_text("mine")
    for out in (kept, fresh):
        assert_refused(call("sample", *arguments, "--model", model, "--out", out), *words)
    assert kept.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [kept]


def test_sample_refuses_an_out_it_cannot_write(call: Call, model: Path, tmp_path: Path) -> None:
    asked = ["sample", "tripod", "box_medium", "--model", model, "--out"]
    assert_refused(call(*asked, tmp_path / "g.npy"), ".npy", ".json", ".parquet")
    assert_refused(call(*asked, tmp_path / "absent" / "g.json"), "no folder")
    assert list(tmp_path.iterdir()) == []


def test_a_truncated_or_foreign_model_is_refused(call: Call, model: Path, tmp_path: Path, prior: PosturePrior) -> None:
    asked = ["sample", "tripod", "box_medium", "--out", tmp_path / "g.json", "--model"]
    weights = next(model.iterdir())
    spoilt = tmp_path / "spoilt"
    spoilt.mkdir()
    for content in (weights.read_bytes()[:1000], b"", b"something else"):
        (spoilt / weights.name).write_bytes(content)
        assert_refused(call(*asked, spoilt), str(spoilt))
    prior.save(spoilt / weights.name)
    assert_refused(call(*asked, spoilt), "no grasp cascade")
    assert_refused(call(*asked, tmp_path), "no file")
    assert_refused(call(*asked, "modell"), "unknown model 'modell'")
    assert not (tmp_path / "g.json").exists()


def test_sampling_loads_neither_torch_nor_pyarrow_nor_the_physics_engine(model: Path) -> None:
    arguments = ["sample", "tripod", "box_medium", "--model", str(model)]
    code = (
        f"import sys; from graspcascade.cli import main; status = main({arguments!r}); "
        "heavy = {'torch', 'pyarrow', 'mujoco', 'scipy.optimize'} & set(sys.modules); "
        "sys.exit(f'{status} {heavy}' if status or heavy else 0)"
    )
    done = python("-c", code)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("model", ["heuristic", "screened"])
def test_a_heuristic_takes_any_size(call: Call, model: str, tmp_path: Path) -> None:
    out = tmp_path / "own.json"
    asked = ["sample", "tripod", "box:32x41x60mm", "--model", model, "--side-cm", 4.1, "--n", 3]
    assert call(*asked, "--out", out).status == 0
    grasps = load_grasps(out)
    assert grasps.tasks.objects["box:32x41x60mm"].sides_m == pytest.approx({"x": 0.032, "y": 0.041, "z": 0.06})
    assert set(grasps.side_m) == {0.041}
    metadata = load_document(out).metadata
    assert (metadata["source"], metadata["model"], metadata["measured"]) == ("heuristic", model, {})
    assert metadata["prior"] == PosturePrior.pretrained().fingerprint()
    assert call("trial", out, "--json").json["grasps"][0]["object"] == "box:32x41x60mm"


def test_the_papers_cascade_refuses_an_own_size_and_says_what_takes_it(call: Call) -> None:
    said = call("sample", "tripod", "box:32x41x60mm")
    assert_refused(said, "box:32x41x60mm", "the nearest of these is box_medium", "--model", "screened")


def test_a_prior_is_the_heuristics_alone(call: Call, prior: PosturePrior, tmp_path: Path) -> None:
    prior.save(tmp_path / "p.safetensors")
    asked = ["sample", "tripod", "box_medium", "--n", 1, "--prior", tmp_path / "p.safetensors"]
    assert call(*asked, "--model", "screened").status == 0
    assert_refused(call(*asked), "--model heuristic or screened", "--model default")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["sample", "tripod", "box_medium", "--model", ""], ["--model is empty"]),
        (["sample", "tripod", "box_medium", "--model="], ["--model is empty"]),
        (["sample", "tripod", "box_medium", "--prior", ""], ["--prior is empty"]),
        (["trial", ""], ["an argument is empty"]),
        (["trial", "absent.yaml"], ["there is no file or folder absent.yaml"]),
        (["export", "absent.xyz", "--out", "g.json"], ["there is no file or folder absent.xyz"]),
        (["sample", "tripod", "box_medium", "--model", "heuristc"], ["Did you mean 'heuristic'", "screened", "folder"]),
        (["sample", "tripod", "box_medium", "--object-pose", *"000100"], ["7 values are needed, got 6"]),
        (["collect", "--out", "new", "--prior", "absent.safetensors"], ["no file"]),
    ],
)
def test_what_is_empty_or_absent_is_said_to_be(
    call: Call, arguments: list[str], words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_refused(call(*arguments), *words)
    assert list(tmp_path.iterdir()) == []


def test_an_empty_frame_is_the_objects_own(call: Call, saved: Path, tmp_path: Path) -> None:
    out = tmp_path / "g.yaml"
    assert call("export", saved, "--format", "moveit_grasp", "--frame-id", "", "--out", out).status == 0


def test_grasps_that_no_draw_helped_are_counted(call: Call) -> None:
    said = call("sample", "tripod", "box:1x20x20mm", "--side-axis", "x", "--n", 3, "--model", "screened")
    assert said.status == 0
    assert "of 3 grasps are not screened" in said.err


def test_types_that_cannot_be_made_are_left_out_and_named(
    call: Call, prior: PosturePrior, tmp_path: Path, cut_hands: Mapping[int, Hand]
) -> None:
    kinds = np.repeat(["tripod", "tip_pinch"], 20)
    drawn = load_hand("shadow").clip(prior.sample(kinds, np.random.default_rng(0)))
    postures = LabelledPostures(prior.joint_names, drawn, kinds)
    fit_prior(load_hand("shadow"), postures, TrainingSpec(epochs=1)).save(tmp_path / "two.safetensors")
    asked = ["--prior", tmp_path / "two.safetensors", "--hand", hand_file(cut_hands[2])]
    said = call("evaluate", "--model", "heuristic", *asked, "--per-cell", 1, "--json")
    assert {cell["grasp_type"] for cell in said.json["cells"]} == {"tip_pinch"}
    assert "graspcascade evaluate: left out tripod, palmar_pinch, parallel_extension" in said.err
    refused = call("sample", "palmar_pinch", "box_medium", "--model", "screened", *asked)
    assert_refused(refused, "has seen no postures of palmar_pinch; it knows tripod, tip_pinch")


# -- hands and bounds, of every verb


@pytest.mark.parametrize(
    "arguments",
    [
        ["sample", "tripod", "box_medium"],
        ["sample", "tripod", "box_medium", "--model", "screened"],
        ["trial", "grasps.json"],
        ["evaluate"],
        ["evaluate", "--model", "heuristic"],
        ["seeds"],
        ["prior"],
        ["collect", "--out", "data"],
        ["train", "--data", "data", "--out", "model"],
        ["export", "grasps.json", "--out", "g.json"],
        ["objects"],
        ["view"],
    ],
    ids=" ".join,
)
def test_every_verb_that_touches_a_hand_takes_one(
    call: Call, arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if arguments == ["view"]:
        pytest.importorskip("viser")
    monkeypatch.chdir(tmp_path)
    assert_refused(call(*arguments, "--hand", "barrett"), "unknown hand 'barrett'", "hand file")
    assert list(tmp_path.iterdir()) == []


def test_a_cascade_is_tried_with_another_model_of_its_hand_only(
    call: Call, model: Path, tmp_path: Path, cut_hands: Mapping[int, Hand]
) -> None:
    other, out = write_hand(tmp_path, name="other_model"), tmp_path / "g.json"
    asked = ["sample", "tripod", "box_medium", "--side-cm", 3, "--n", 1, "--model", model]
    assert call(*asked, "--hand", other, "--out", out).status == 0
    assert call("trial", out, "--hand", other).status == 0
    report = call("evaluate", "--model", model, "--hand", other, "--per-cell", 1, "--json").json
    assert report["hand"] == "other_model"
    small = hand_file(cut_hands[2])
    for command in (asked, ["evaluate", "--model", model]):
        assert_refused(call(*command, "--hand", small), "is for shadow_hand_right", "hand_of_2 has other joints")
    assert_refused(call("trial", out, "--hand", small), "hand_of_2")


def test_a_hand_of_its_own_is_sampled_and_tried(call: Call, tmp_path: Path, cut_hands: Mapping[int, Hand]) -> None:
    out, small = tmp_path / "g.json", hand_file(cut_hands[2])
    asked = ["--hand", small, "--model", "screened", "--n", 2, "--out", out]
    assert call("sample", "tip_pinch", "sphere:30mm", *asked).status == 0
    rows = call("trial", out, "--hand", small, "--json").json["grasps"]
    assert {place for row in rows for place in row["touching_closed"]} <= {"thumb", "index", "palm"}
    assert_refused(call("sample", "tripod", "sphere:30mm", *asked), "hand_of_2 cannot make a tripod", "tip_pinch")


def test_a_model_of_a_hand_that_is_not_shipped_asks_for_its_file(call: Call, model: Path, tmp_path: Path) -> None:
    sampler = GraspSampler.load(model)
    replace(sampler, hand=replace(sampler.hand, name="my_hand")).save(tmp_path / "mine")
    said = call("evaluate", "--model", tmp_path / "mine")
    assert_refused(said, "hand 'my_hand' is not shipped; give its file (--hand FILE")


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["sample", "tripod", "box_medium", "--n", 1_000_001], "n must be at most 1000000, got 1000001"),
        (["sample", "tripod", "box_medium", "--seed", 2**63], "seed must be at most"),
        (["trial", "g.json", "--threads", 4097], "threads must be at most 4096"),
        (["evaluate", "--per-cell", 10**9 + 1], "per_cell must be at most 1000000,"),
        (["evaluate", "--threads", 10**9], "threads must be at most"),
        (["evaluate", "--workers", 10**9], "workers must be at most"),
        (["seeds", "--per-type", 10**10], "per_type must be at most"),
        (["collect", "--out", "x", "--round-per-cell", 10**10], "round_per_cell must be at most"),
        (["collect", "--out", "x", "--trials-per-cell", 10**20], "trials_per_cell must be at most"),
        (["collect", "--out", "x", "--workers", -1], "workers must not be negative"),
        (["train", "--data", "x", "--out", "y", "--workers", 4097], "workers must be at most"),
    ],
)
def test_what_no_machine_can_do_is_refused(
    call: Call, arguments: list[Any], word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_refused(call(*arguments), word)
    assert list(tmp_path.iterdir()) == []


# -- trial


def test_trial_takes_an_engine_by_name(call: Call, saved: Path) -> None:
    assert call("trial", saved, "--engine", "mujoco").status == 0
    assert_refused(call("trial", saved, "--engine", "physix"), "unknown engine 'physix'", "'physx'", "mujoco")
    assert_refused(call("evaluate", "--engine", "bullet"), "unknown engine 'bullet'")


def test_an_engine_that_is_not_installed_is_refused_with_what_to_install(
    call: Call, saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "sapien", None)
    for verb in (["trial", saved], ["verify", saved], ["evaluate", "--out", tmp_path / "evaluation"]):
        assert_refused(call(*verb, "--engine", "physx"), "needs sapien", "extra 'physx'", "pip install '.[physx]'")
    assert not (tmp_path / "evaluation").exists()


def test_trial_json_gives_totals_and_a_verdict_for_each_grasp(call: Call, saved: Path, tmp_path: Path) -> None:
    said = call("trial", saved, "--json", "--out", tmp_path / "report.json")
    assert (said.status, said.err) == (0, "")
    report = said.json
    assert json.loads((tmp_path / "report.json").read_text()) == report
    named = [report[name] for name in ("protocol", "engine", "model", "n")]
    assert named == ["paper", "mujoco", "by hand", 3]
    verdicts = [row["verdict"] for row in report["grasps"]]
    assert set(verdicts) <= set(VERDICTS)
    assert verdicts[2] == "missed"
    assert report["grasps"][2]["touching_end"] == []
    assert report["held"]["rate"] == pytest.approx(verdicts.count("held") / 3)
    assert report["held"]["low"] <= report["held"]["rate"] <= report["held"]["high"]
    assert set(report["faithful"]) == {"rate", "low", "high"}
    assert sum(report["verdicts"].values()) == 3


def test_trial_prints_verdicts_and_a_rate_with_its_protocol(call: Call, saved: Path) -> None:
    said = call("trial", saved)
    assert "missed" in said.out
    assert "protocol paper, engine mujoco, 3 trials: held" in said.out
    assert "(95 %: " in said.out


def test_grasps_are_tried_and_verified_by_pushes(call: Call, saved: Path) -> None:
    said = call("trial", saved, "--protocol", "six-directions", "--json")
    assert (said.status, said.json["protocol"]) == (0, "six-directions")
    assert set(said.json["verdicts"]) == set(VERDICTS)
    held = said.json["verdicts"]["held"]
    said = call("verify", saved, "--protocol", "six-directions", "--draws", "1", "--json")
    assert said.json["held"]["rate"] == pytest.approx(held / 3)
    assert_refused(call("verify", saved, "--protocol", "six-directions"), "six-directions is the same; give one draw")


def test_trial_refuses_what_is_no_grasp_file(call: Call, saved: Path, tmp_path: Path, drawn: Grasps) -> None:
    cut = tmp_path / "cut.json"
    cut.write_text(saved.read_text()[:500])
    assert_refused(call("trial", cut), str(cut), "not complete JSON")
    assert_refused(call("trial", tmp_path / "absent.json"), "no file")
    assert_refused(call("trial", tmp_path / "g.npy"), "no file")
    assert_refused(call("trial", saved, "--protocol", "papper"), "unknown protocol 'papper'", "Did you mean 'paper'")
    assert_refused(call("trial", saved, "--protocol", "six"), "unknown protocol")
    assert_refused(call("trial", saved, "--out", tmp_path / "report.csv"), ".json")
    save_grasps(tmp_path / "none.json", drawn[[]], metadata={})
    assert_refused(call("trial", tmp_path / "none.json"), "no grasps")


def test_a_report_never_takes_the_place_of_the_grasps(call: Call, saved: Path) -> None:
    before = saved.read_bytes()
    assert_refused(call("trial", saved, "--out", saved), "holds the grasps", saved.name)
    assert_refused(call("trial", saved, "--out", saved.parent / "." / saved.name), "holds the grasps")
    assert saved.read_bytes() == before


def test_trial_refuses_the_grasps_of_another_hand(call: Call, drawn: Grasps, tmp_path: Path) -> None:
    some = drawn[:1]
    columns = some.columns()
    columns |= {name: columns[name][:, 1:] for name in ("posture", "pregrasp")}
    other = Grasps.from_columns(some.hand, some.joint_names[1:], some.tasks, columns)
    save_grasps(tmp_path / "other.json", other, metadata={})
    assert_refused(call("trial", tmp_path / "other.json"), "lacks joints of shadow_hand_right", drawn.joint_names[0])


def test_a_trial_that_breaks_is_a_verdict_and_leaves_no_file(
    drawn: Grasps, saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    grasps = Grasps.concatenate([drawn[:1]])  # a copy, as a slice is a view
    grasps.X_hand_object.position_m[0] = 1e12
    # No file can hold such a grasp and no engine takes it, but physics can come to the same.
    monkeypatch.setattr("graspcascade.engines.mujoco.runner.check_trials", lambda *_: None)
    monkeypatch.setattr("graspcascade.cli.trials.load_executable", lambda *_, **__: GraspDocument(grasps))
    monkeypatch.chdir(tmp_path)
    assert main(["trial", saved.name, "--json"]) == 0
    said = capfd.readouterr()
    assert json.loads(said.out)["grasps"][0]["verdict"] == "unstable"
    assert said.err == ""
    assert list(tmp_path.iterdir()) == [saved]


# -- evaluate


def test_evaluate_prints_rates_with_their_protocol_and_goes_on_from_its_folder(call: Call, tmp_path: Path) -> None:
    asked = ["evaluate", "--model", "heuristic", "--per-cell", 1, "--out", tmp_path / "run"]
    report = call(*asked, "--json").json
    assert (report["protocol"], report["model"], report["n"]) == ("paper", "heuristic", 54)
    assert set(report["held"]) == {"rate", "low", "high"}
    assert {"grasp_type", "object", "n", "held", "faithful"} <= set(report["cells"][0])
    said = call(*asked)
    assert said.out.startswith("heuristic under protocol paper")
    assert "protocol paper, engine mujoco, 54 trials: held" in said.out
    assert all(label in said.out for label in CATALOGUE)
    assert_refused(call(*asked, "--seed", 1), str(tmp_path / "run"))


def test_evaluate_draws_objects_of_random_size(call: Call) -> None:
    asked = ["evaluate", "--model", "heuristic", "--object", "any", "--per-cell", 1]
    report = call(*asked, "--json").json
    assert (report["n"], list(report["verdicts"]["by_object"])) == (18, ["any:box", "any:cylinder", "any:sphere"])
    said = call(*asked)
    assert "any:cylinder" in said.out
    assert "box_small" not in said.out


def test_evaluate_tells_a_users_model_from_others_of_its_kind(call: Call, model: Path) -> None:
    assert call("evaluate", "--model", model, "--per-cell", 1).out.startswith(f"model3 ({model}) under protocol paper")


def test_evaluate_refuses_before_any_trial(call: Call, tmp_path: Path) -> None:
    out = tmp_path / "run"
    assert_refused(call("evaluate", "--per-cell", 0, "--out", out), "per_cell must be at least 1")
    assert_refused(call("evaluate", "--model", "heuristics", "--out", out), "unknown model 'heuristics'")
    assert_refused(call("evaluate", "--model", "heuristic", "--protocol", "x", "--out", out), "unknown protocol")
    assert_refused(call("evaluate", "--model", "heuristic", "--prior", "absent.safetensors"), "no file")
    asked = ["evaluate", "--prior", "p.safetensors", "--per-cell", 1, "--out", out]
    assert_refused(call(*asked), "--model heuristic", "--model default")
    assert list(tmp_path.iterdir()) == []


# -- postures


def test_seeds_prints_how_human_they_are_and_writes_what_the_importer_reads(
    call: Call, hand: Hand, tmp_path: Path
) -> None:
    said = call("seeds", "--per-type", 3, "--out", tmp_path / "seeds.csv")
    assert said.status == 0
    assert all(name in said.out for name in GRASP_TYPES)
    assert f"18 seed postures written to {tmp_path / 'seeds.csv'}" in said.out
    found = import_postures(tmp_path / "seeds.csv", hand)
    assert (len(found), found.n_clipped) == (18, 0)


def test_seeds_json_counts_the_joints_of_the_digits_that_hold(call: Call) -> None:
    types = {row["grasp_type"]: row for row in call("seeds", "--per-type", 2, "--json").json["types"]}
    assert set(types) == set(GRASP_TYPES)
    assert {name[:2] for name in types["tripod"]["deviation_sd"]} == {"TH", "FF", "MF"}
    assert {name[:2] for name in types["tip_pinch"]["deviation_sd"]} == {"TH", "FF"}
    for row in types.values():
        outside = [name for name, value in row["deviation_sd"].items() if abs(value) > 1]
        assert row["share_within"] == pytest.approx(1 - len(outside) / len(row["deviation_sd"]))
        assert set(row["outliers"]) == set(outside)


def test_a_prior_is_trained_on_recordings(call: Call, hand: Hand, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    posture = rng.uniform(hand.lower_rad, hand.upper_rad, (24, len(hand.joint_names)))
    posture[0, 0] = posture[1, 1] = posture[2, 1] = 2.0
    recorded = LabelledPostures(hand.joint_names, posture, np.repeat(list(GRASP_TYPES), 4))
    export_postures(tmp_path / "mine.csv", recorded)
    asked = ["prior", "--postures", tmp_path / "mine.csv", "--out", tmp_path / "mine.safetensors"]
    quick = ["--epochs", 1, "--min-steps", 0]
    said = call(*asked, *quick)
    assert said.status == 0
    names = hand.joint_names
    assert f"3 of 528 angles were beyond limits and clipped, most often of {names[1]} (2), {names[0]} (1)" in said.out
    assert PosturePrior.load(tmp_path / "mine.safetensors").metadata["n_postures"] == 24
    bare = (tmp_path / "mine.csv").read_text().replace("_rad", "")
    (tmp_path / "mine.csv").write_text(bare)
    assert_refused(call(*asked), "has no unit", "--unit deg")
    assert_refused(call(*asked, "--unit", "deg"), "look like radians", "--unit rad")
    facts = call(*asked, *quick, "--unit", "rad", "--json").json
    assert (facts["n_clipped"], facts["clipped"]) == (3, {names[0]: 1, names[1]: 2})


def test_a_prior_refuses_bad_recordings_and_writes_nothing(call: Call, tmp_path: Path) -> None:
    (tmp_path / "bad.csv").write_text("type,FFJ3_deg\ntripod,30\ntripod,nan\n")
    asked = ["prior", "--postures", tmp_path / "bad.csv", "--out"]
    assert_refused(call(*asked, tmp_path / "p.safetensors"), "line 3", "FFJ3_deg")
    assert_refused(call(*asked, tmp_path / "p.bin"), ".safetensors")
    assert [path.name for path in tmp_path.iterdir()] == ["bad.csv"]


# -- collect and train


def test_collect_writes_a_dataset_and_goes_on_with_the_same_arguments(call: Call, tmp_path: Path) -> None:
    asked = ["collect", "--out", tmp_path / "data", "--round-per-cell", 1, "--json"]
    first = call(*asked, "--trials-per-cell", 1)
    assert (first.status, first.err) == (0, "")
    assert (first.json["rounds"], first.json["trials"]) == (1, 54)
    before = (tmp_path / "data" / "metadata.json").read_bytes()
    assert call(*asked, "--trials-per-cell", 1).json["trials"] == 54
    assert_refused(call(*asked, "--trials-per-cell", 2, "--seed", 9), "seed")
    assert (tmp_path / "data" / "metadata.json").read_bytes() == before
    said = call("train", "--data", tmp_path / "data", "--out", tmp_path / "model")
    assert_refused(said, "at least 100 are needed")
    assert not (tmp_path / "model").exists()


def test_collect_takes_objects_of_ones_own_and_of_random_size_and_spreads_them(call: Call, tmp_path: Path) -> None:
    asked = ["collect", "--out", tmp_path / "data", "--object", "any:sphere", "--object", "box:32x41x60mm"]
    asked += ["--trials-per-cell", 2, "--round-per-cell", 2, "--protocol", "varied"]
    said = call(*asked, "--spread")
    assert said.status == 0
    assert "24 screened trials under protocol varied" in said.out
    metadata = json.loads((tmp_path / "data" / "metadata.json").read_text())
    names = [cell["object"] for cell in metadata["counts"]["cells"]]
    assert names == ["any:sphere"] * 6 + ["box:32x41x60mm"] * 6
    assert metadata["placement"]["offset_share"] == pytest.approx(1 / 3)
    assert_refused(call(*asked), "another placement")


def test_cells_of_random_size_that_lack_grasps_are_named(call: Call, tmp_path: Path) -> None:
    asked = ["--object", "any:box", "--trials-per-cell", 0, "--successes-per-cell", 50, "--most-trials-per-cell", 1]
    said = call("collect", "--out", tmp_path / "data", "--round-per-cell", 1, *asked)
    assert "given up: any:box/tripod (1 trials), any:box/palmar_pinch (1 trials)" in said.out


@pytest.mark.parametrize("verb", [["collect", "--out", "data"], ["evaluate", "--model", "heuristic"]])
def test_unknown_repeated_and_too_large_objects_are_refused(
    call: Call, verb: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_refused(call(*verb, "--object", "any:bxo"), "unknown family of objects 'any:bxo'", "'any:box'")
    assert_refused(call(*verb, "--object", "box_smal"), "unknown object 'box_smal'", "'box_small'")
    assert_refused(call(*verb, "--object", "any", "--object", "any:box"), "each object and type once")
    assert_refused(call(*verb, "--object", "sphere:80mm"), "no side of sphere:80mm is within the hand's reach")
    assert_refused(call("sample", "tripod", "any:box"), "'any:box' means objects of random size")
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_collect_says_once_which_shards_it_collects_again(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def mending(*_: object, progress: Callable[[CollectionState], None], **__: object) -> CollectionState:
        for lost in (("part-00001.parquet", "part-00007.parquet"), ("part-00007.parquet",), ()):
            state = CollectionState(8 - len(lost), *[np.full(54, 1200)] * 3, lost)
            progress(state)
        return state

    monkeypatch.setattr("graspcascade.cli.learning.collect", mending)
    said = call("collect", "--out", tmp_path / "data")
    assert said.status == 0
    again = "missing or changed shards are collected again: part-00001.parquet, part-00007.parquet"
    assert said.err == f"graspcascade collect: {again}\n"


def test_collect_names_what_hardly_ever_holds_once_unless_it_will_be_given_up(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    held = np.full(54, 900)
    held[4] = 12

    def endless(*_: object, progress: Callable[[CollectionState], None], **__: object) -> CollectionState:
        for rounds in (5, 6):
            progress(CollectionState(rounds, np.full(54, 200 * rounds), held, held))
        return CollectionState(6, np.full(54, 1200), held, held)

    monkeypatch.setattr("graspcascade.cli.learning.collect", endless)
    asked = ["collect", "--out", tmp_path / "data", "--successes-per-cell", 1000]
    name = "box_small/lateral_tripod"
    said = f"graspcascade collect: {name} hardly ever holds; --most-trials-per-cell gives such cells up\n"
    assert call(*asked).err == said
    assert call(*asked, "--most-trials-per-cell", 5000).err == ""


@dataclass
class SeenBar(Bar):
    """Keep what a progress bar is told: done, total."""

    seen: list[tuple[int, int | None]]

    def show(self, done: int, total: int | None = None, note: str | None = None) -> None:
        self.seen.append((done, total))


@pytest.mark.parametrize(
    ("asked", "held_share", "seen"),
    [
        # Rounds of 20 trials for 54 cells, of which less are asked for: whole rounds are counted.
        (["--trials-per-cell", 30], 0.0, [(0, 2160), (540, 2160), (1080, 2160), (1620, 2160), (2160, 2160)]),
        # Half of them hold: two rounds give 20 of 20. Until something is known, half is assumed.
        (["--trials-per-cell", 0, "--successes-per-cell", 20], 0.5, [(0, 2160), (540, 2160), (1080, 2160)]),
        # None hold: three rounds, then cells are given up.
        (
            ["--trials-per-cell", 0, "--successes-per-cell", 20, "--most-trials-per-cell", 50],
            0.0,
            [(0, 2160), (540, 2160), (1080, 2160), (1080, 3240), (1620, 3240), (2160, 3240)],
        ),
    ],
)
def test_collect_counts_the_trials_that_whole_rounds_execute(
    call: Call,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    asked: list[Any],
    held_share: float,
    seen: list[tuple[int, int]],
) -> None:
    shown = SeenBar([])

    @contextmanager
    def seen_bar(title: str, total: int | None = None) -> Iterator[SeenBar]:
        yield shown

    def collecting(
        *_: object, progress: Callable[[CollectionState], None], tick: Callable[[int], None], **__: object
    ) -> CollectionState:
        for rounds in range(3):
            trials = np.full(54, 20 * rounds)
            held = (held_share * trials).astype(int)
            state = CollectionState(rounds, trials, held, held)
            progress(state)
            for decided in [540, 540] if rounds < 2 else []:
                tick(decided)
        return state

    monkeypatch.setattr("graspcascade.cli.console.bar", seen_bar)
    monkeypatch.setattr("graspcascade.cli.learning.collect", collecting)
    assert call("collect", "--out", tmp_path / "data", "--round-per-cell", 20, *asked).status == 0
    assert list(dict.fromkeys(shown.seen))[: len(seen)] == seen


def test_collect_leaves_a_foreign_folder_alone(call: Call, tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    assert_refused(call("collect", "--out", tmp_path), "holds no collection")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize("verb", ["collect", "train", "prior"])
def test_verbs_that_need_the_extra_say_so_before_they_begin(
    call: Call, verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for package in ("torch", "pyarrow"):
        monkeypatch.setitem(sys.modules, package, None)
    out = tmp_path / "out.safetensors"
    more = ["--data", tmp_path] if verb == "train" else []
    assert_refused(call(verb, "--out", out, *more), "pip install '.[train]' in a checkout")
    assert list(tmp_path.iterdir()) == []


def test_training_says_what_it_did(call: Call, data: Path, tmp_path: Path) -> None:
    said = call(
        *["train", "--data", data, "--out", tmp_path / "m", "--factorization", "model1", "--epochs", 1, "--json"]
    )
    assert (said.status, said.err) == (0, "")
    assert said.json["factorization"] == "model1"
    assert set(said.json["final_loss"]) == {"grasp"}
    assert call("sample", "tripod", "box_small", "--model", tmp_path / "m").status == 0


def test_training_refuses_an_unreadable_dataset_and_writes_nothing(call: Call, data: Path, tmp_path: Path) -> None:
    bad, out = tmp_path / "bad", tmp_path / "model"
    bad.mkdir()
    assert_refused(call("train", "--data", bad, "--out", out), "metadata.json")
    (bad / "metadata.json").write_text("{")
    assert_refused(call("train", "--data", bad, "--out", out), "metadata")
    (bad / "metadata.json").write_bytes((data / "metadata.json").read_bytes())
    assert_refused(call("train", "--data", bad, "--out", out), "part-00000.parquet")
    (bad / "part-00000.parquet").write_bytes((data / "part-00000.parquet").read_bytes()[:2000])
    assert_refused(call("train", "--data", bad, "--out", out), "part-00000.parquet")
    assert not out.exists()


def test_training_never_writes_over_a_model(call: Call, data: Path, model: Path) -> None:
    before = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in model.iterdir()}
    assert_refused(call("train", "--data", data, "--out", model, "--epochs", 1), "not empty")
    assert {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in model.iterdir()} == before
    assert_refused(call("train", "--data", data, "--out", model / "x", "--factorization", "model9"), "unknown factoriz")


# -- hands and objects


def test_objects_lists_sides_and_which_can_be_held(call: Call) -> None:
    rows = {row["name"]: row for row in call("objects", "--json").json}
    assert list(rows) == list(CATALOGUE)
    assert rows["box_large"]["graspable_sides_m"] == {"x": 0.04, "y": 0.055}
    assert rows["sphere_large"]["mass_kg"] == pytest.approx(600 * np.pi / 6 * 0.06**3)
    assert all(label in call("objects").out for label in CATALOGUE)


def test_hands_shows_joints_limits_coupling_and_frames(call: Call, hand: Hand) -> None:
    assert {name: facts["name"] for name, facts in call("hands", "--json").json.items()} == {
        "shadow": "shadow_hand_right"
    }
    assert "shadow_hand_right" in call("hands").out
    facts = call("hands", "show", "shadow_hand_right", "--json").json
    assert [joint["name"] for joint in facts["joints"]] == list(hand.joint_names)
    np.testing.assert_allclose([j["lower_deg"] for j in facts["joints"]], np.degrees(hand.lower_rad), atol=1e-3)
    by_name = {joint["name"]: joint for joint in facts["joints"]}
    assert by_name["FFJ1"]["actuator"] == by_name["FFJ2"]["actuator"] == "FFJ0"
    assert by_name["THJ5"]["actuator"] == "THJ5"
    actuators = {actuator["name"]: actuator for actuator in facts["actuators"]}
    assert actuators["FFJ0"]["weights"] == {"FFJ2": 1.0, "FFJ1": 1.0}
    assert actuators["FFJ0"]["gain_nm_per_rad"] > 0
    assert set(facts["places"]) == set(hand.places)
    assert list(facts["digits"]) == ["thumb", "index", "middle", "ring", "little"]
    assert facts["grasp_types"] == list(GRASP_TYPES)
    assert facts["frame"]["X_base_hand"]["position_m"] == pytest.approx([0, -0.01, 0.24701])
    shown = call("hands", "show").out
    assert all(name in shown for name in (*hand.joint_names, "thumb_pad", "in degrees", "tripod", "6.5 cm"))
    assert_refused(call("hands", "show", "barrett"), "unknown hand 'barrett'", "shadow_hand_right", "hand file")


def test_hands_shows_a_hand_file(call: Call, cut_hands: Mapping[int, Hand]) -> None:
    file = hand_file(cut_hands[2])
    facts = call("hands", "show", file, "--json").json
    assert facts["name"] == "hand_of_2"
    assert list(facts["digits"]) == ["thumb", "index"]
    assert "tripod" not in facts["grasp_types"]
    assert "hand_of_2: digits thumb, index;" in call("hands", "show", file).out
    assert_refused(call("hands", "show", file.with_name("absent.yaml")), "absent.yaml")


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_completion_scripts_know_every_command(call: Call, shell: str) -> None:
    script = call("completion", shell)
    assert script.status == 0
    for name in ("sample", "trial", "evaluate", "collect", "train", "view", "export", "hands"):
        assert name in script.out


def test_completion_for_an_unknown_shell_names_the_known_ones(call: Call) -> None:
    refused = call("completion", "powershell")
    assert refused.status == 2
    assert "bash" in refused.err
