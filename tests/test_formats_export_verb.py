"""The export verb: from any format into any other, by the command line."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml

from command_line import Call
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import CATALOGUE
from graspcascade.core.outcomes import VERDICTS
from graspcascade.core.protocols import PAPER
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.formats import FORMATS_BY_NAME, load_document, load_grasps, save_grasps
from graspcascade.studies.record import Cell, Evaluation


@pytest.fixture
def export(call: Call) -> Call:
    return partial(call, "export")


@pytest.fixture
def saved(drawn: Grasps, tmp_path: Path) -> Path:
    save_grasps(tmp_path / "grasps.json", drawn[[0, 10, 20]], metadata={"model": "by hand"})
    return tmp_path / "grasps.json"


def test_help_names_every_format(export: Call) -> None:
    said = export("--help")
    assert said.status == 0
    for name in FORMATS_BY_NAME:
        assert name in said.out


@pytest.mark.parametrize(
    ("name", "target"),
    [
        ("parquet", "g.parquet"),
        ("isaac_grasp", "isaac"),
        ("moveit_grasp", "g.yaml"),
        ("dexgraspbench", "bench"),
        ("dexgraspnet", "net"),
    ],
)
def test_there_and_back(export: Call, saved: Path, tmp_path: Path, name: str, target: str) -> None:
    out, back = tmp_path / target, tmp_path / "back.json"
    assert export(saved, "--format", name, "--out", out).status == 0
    trust = ["--trust-pickle"] if FORMATS_BY_NAME[name].pickled else []
    said = export(out, "--out", back, *trust, "--json")
    assert (said.status, said.err) == (0, "")
    assert json.loads(said.out) == {"out": str(back), "n": 3, "without_confidence": 3, "held": None}
    assert load_grasps(back).tasks.same_as(load_grasps(saved).tasks)
    np.testing.assert_array_equal(load_grasps(back).posture, load_grasps(saved).posture)
    assert load_document(back).metadata == {"model": "by hand"}


def test_pickles_need_the_flag(export: Call, saved: Path, tmp_path: Path) -> None:
    export(saved, "--format", "dexgraspbench", "--out", tmp_path / "bench")
    said = export(tmp_path / "bench", "--out", tmp_path / "back.json")
    assert (said.status, said.out) == (2, "")
    assert "--trust-pickle" in said.err
    assert len(said.err.splitlines()) == 1
    assert not (tmp_path / "back.json").exists()


def test_an_evaluation_gives_the_confidence(export: Call, saved: Path, tmp_path: Path) -> None:
    cells = tuple(
        Cell(dict.fromkeys(VERDICTS, 0) | {"held": 3, "dropped": 1}, 0, kind, label)
        for label in CATALOGUE
        for kind in GRASP_TYPES
    )
    Evaluation(PAPER, "m", "h", cells, 0, 4, {}, {}).save(tmp_path / "evaluation.json")
    arguments = [saved, "--format", "moveit_grasp", "--joint-prefix", "rh_"]
    said = export(*arguments, "--out", tmp_path / "known.yaml", "--evaluation", tmp_path / "evaluation.json")
    assert said.status == 0
    assert "--evaluation" not in said.out
    assert [line.split(": ")[1] for line in said.err.splitlines()] == [
        "the evaluation is of hand h, the grasps are of shadow_hand_right",
        "the evaluation is of model m, the grasps are of by hand",
    ]
    rows = yaml.safe_load((tmp_path / "known.yaml").read_text())["grasps"]
    assert [row["grasp_quality"] for row in rows] == [0.75] * 3
    assert rows[0]["grasp_posture"]["joint_names"][0] == "rh_WRJ2"
    said = export(saved, "--format", "moveit-grasp", "--out", tmp_path / "unknown.yaml")
    assert "3 of them have no measured confidence" in said.out
    said = export(*arguments, "--out", tmp_path / "x.yaml", "--evaluation", saved)
    assert said.status == 2
    assert "evaluate --json" in said.err


@pytest.mark.parametrize("name", [name for name, known in FORMATS_BY_NAME.items() if known.contact])
def test_a_format_of_hands_in_contact_tries_the_grasps_first(
    export: Call, saved: Path, tmp_path: Path, name: str
) -> None:
    said = export(saved, "--format", name, "--out", tmp_path / "tried")
    assert said.status == 0
    assert "held in the trial" in said.out
    assert any(contact_measured(tmp_path / "tried"))
    said = export(saved, "--format", name, "--out", tmp_path / "target", "--no-settle")
    assert said.status == 0
    assert "trial" not in said.out
    assert not any(contact_measured(tmp_path / "target"))


def contact_measured(folder: Path) -> list[bool]:
    rows = [row for file in folder.rglob("*.npy") for row in np.load(file, allow_pickle=True).reshape(-1)]
    return [row["graspcascade"]["grasp"]["contact_measured"] for row in rows]


def test_other_formats_are_settled_where_it_is_asked_for(export: Call, saved: Path, tmp_path: Path) -> None:
    assert "trial" not in export(saved, "--format", "isaac_grasp", "--out", tmp_path / "target").out
    assert "held in the trial" in export(saved, "--format", "isaac_grasp", "--out", tmp_path / "tried", "--settle").out


def test_an_empty_frame_is_the_objects_own(export: Call, saved: Path, tmp_path: Path) -> None:
    out = tmp_path / "g.yaml"
    for asked, frame in (([], "box_small"), (["--frame-id", "table"], "table"), (["--frame-id", ""], "")):
        assert export(saved, "--format", "moveit_grasp", "--out", out, *asked).status == 0
        assert yaml.safe_load(out.read_text())["grasps"][0]["grasp_pose"]["header"]["frame_id"] == frame


def test_notes_on_the_file_go_to_stderr(export: Call, saved: Path, tmp_path: Path) -> None:
    data = json.loads(saved.read_text())
    data["grasps"][0]["posture"]["THJ3"] = 0.4
    saved.write_text(json.dumps(data))
    said = export(saved, "--out", tmp_path / "g.parquet", "--json")
    assert said.status == 0
    assert "posture is beyond the joint limits of shadow_hand_right in 1 grasps: THJ3 1" in said.err
    assert len(said.err.splitlines()) == 1
    json.loads(said.out)


def test_an_object_that_is_not_known_is_what_the_user_says(export: Call, saved: Path, tmp_path: Path) -> None:
    data = json.loads(saved.read_text())
    data["grasps"] = data["grasps"][:1]
    saved.write_text(json.dumps(data))
    export(saved, "--format", "isaac_grasp", "--out", tmp_path / "mug.yaml")
    isaac = yaml.safe_load((tmp_path / "mug.yaml").read_text())
    del isaac["graspcascade"]
    isaac["object_frame"] = "/World/mug"
    (tmp_path / "mug.yaml").write_text(yaml.safe_dump(isaac))
    back = ["--out", tmp_path / "back.json", "--grasp-type", "tripod"]
    said = export(tmp_path / "mug.yaml", *back)
    assert said.status == 2
    assert "give --object" in said.err
    assert export(tmp_path / "mug.yaml", *back, "--object", "cylinder:60x90mm").status == 0
    assert list(load_grasps(tmp_path / "back.json").tasks.objects) == ["cylinder:60x90mm"]


@pytest.mark.parametrize(
    ("arguments", "keys"),
    [
        (["--frame-keys", "frame_link"], {"object_frame_link", "gripper_frame_link"}),
        (["--joint-prefix", "robot0:", "--joint-numbering", "0"], {"object_frame", "gripper_frame"}),
    ],
)
def test_names_in_the_file_are_a_choice(
    export: Call, saved: Path, tmp_path: Path, arguments: list[str], keys: set[str]
) -> None:
    export(saved, "--format", "isaac_grasp", "--out", tmp_path / "isaac", *arguments)
    for file in (tmp_path / "isaac").iterdir():
        data = yaml.safe_load(file.read_text())
        assert {key for key in data if "frame" in key} == keys
        first = next(iter(next(iter(data["grasps"].values()))["cspace_position"]))
        assert first == ("robot0:FFJ3" if "robot0:" in arguments else "FFJ4")


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--out", "x.yaml"], "isaac_grasp, moveit_grasp"),
        (["--out", "x.json", "--format", "isac_grasp"], "Did you mean 'isaac_grasp'"),
        (["--out", "absent/x.json"], "no folder"),
        (["--out", "x.yaml", "--format", "isaac_grasp"], "one object"),
        (["--out", "x.json", "--object-pose", "0", "0", "0", "1", "1", "0", "0"], "norm 1"),
        (["--out", "x.yaml", "--format", "moveit_grasp", "--parent-link", "elbow"], "elbow"),
        (["--out", "x.json", "--object", "box_mediun"], "Did you mean 'box_medium'"),
        (["--out", "x.json", "--grasp-type", "tripodd"], "Did you mean 'tripod'"),
        (["--out", "x.json", "--hand", "barrett"], "unknown hand 'barrett'"),
        (["--out", "x.json", "--object-pose", "400", "0", "100", "1", "0", "0", "0"], "were millimetres meant?"),
        (["--out", "x.json", "--joint-numbering", "2"], "--joint-numbering"),
        (["--out", "x.json", "--side-axis", "Q"], "unknown side axis 'Q'"),
        (["--out", "x.json", "--side-axis", "x"], "--side-axis says nothing of an export from json to json"),
        (["--out", "x.json", "--object", "box_small"], "--object says nothing"),
        (
            ["--out", "x.json", "--joint-prefix", "rh_"],
            "--joint-prefix says nothing of an export from json to json; it",
        ),
        (["--out", "x.parquet", "--frame-id", ""], "--frame-id says nothing of an export from json to parquet; it"),
        (["--out", "x", "--format", "isaac_grasp", "--frame-id", "map"], "--frame-id says nothing"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(
    export: Call, saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], word: str
) -> None:
    monkeypatch.chdir(tmp_path)
    said = export(saved, *arguments)
    assert (said.status, said.out) == (2, "")
    assert word in said.err
    assert len(said.err.splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["grasps.json"]


@pytest.mark.parametrize("name", ["isaac_grasp", "moveit_grasp", "dexgraspbench", "dexgraspnet"])
def test_a_file_that_lacks_a_joint_is_refused_in_one_line(export: Call, saved: Path, tmp_path: Path, name: str) -> None:
    data = json.loads(saved.read_text())
    data["joint_names"].remove("FFJ4")
    for row in data["grasps"]:
        del row["posture"]["FFJ4"], row["pregrasp"]["FFJ4"]
    saved.write_text(json.dumps(data))
    target = "g.yaml" if name == "moveit_grasp" else "folder"
    said = export(saved, "--format", name, "--out", tmp_path / target)
    assert (said.status, said.out) == (2, "")
    assert "lack joints" in said.err
    assert "FFJ4" in said.err
    assert len(said.err.splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == [saved.name]


def test_no_grasps_are_not_exported(export: Call, drawn: Grasps, tmp_path: Path) -> None:
    save_grasps(tmp_path / "none.json", drawn[[]], metadata={})
    said = export(tmp_path / "none.json", "--out", tmp_path / "x.parquet")
    assert said.status == 2
    assert "no grasps" in said.err
