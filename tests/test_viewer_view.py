"""``graspcascade view``: what it refuses, and the standalone page as a file."""

import os
import re
import socket
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest

if not os.environ.get("CI"):  # where everything must run, a missing package is an error
    pytest.importorskip("viser")


from command_line import Said, assert_refused, said_by
from graspcascade.core.grasps import Grasps
from graspcascade.core.tasks import Task, Tasks
from graspcascade.formats import save_grasps
from graspcascade.hands import Hand
from graspcascade.proposals.heuristic import Heuristic, Screened
from graspcascade.proposals.prior import PosturePrior


@pytest.fixture
def taken() -> Iterator[int]:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        yield int(other.getsockname()[1])


def view(capsys: pytest.CaptureFixture[str], *arguments: object) -> Said:
    return said_by(capsys, "view", *arguments)


def test_a_port_in_use_is_refused(capsys: pytest.CaptureFixture[str], taken: int) -> None:
    assert_refused(view(capsys, "--port", taken), str(taken), "in use", "--port")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--port", 70000), ("port must be between 0 and 65535",)),
        (("--host", "203.0.113.7"), ("203.0.113.7",)),
        (("--n", 0), ("n must be a whole number between 1 and 200",)),
        (("--grasp-type", "tripood"), ("tripood", "Did you mean 'tripod'")),
        (("--object", "box_medum"), ("box_medum", "Did you mean 'box_medium'")),
        (("--side-axis", "w"), ("side axis",)),
        (("--allow-host", "http://lab.example"), ("host to allow", "http://lab.example")),
        (("--friction", -1), ("friction must be between",)),
        (("no_such_file.json",), ("no_such_file.json",)),
        (("some.json", "--n", 3), ("not both", "some.json", "n")),
        (("--html", "page.txt"), ("page.txt", ".html")),
        (("--html", "nowhere/page.html"), ("nowhere",)),
        (("--model", "no_such_model"), ("no_such_model",)),
    ],
)
def test_bad_arguments_are_refused(
    capsys: pytest.CaptureFixture[str], arguments: tuple[object, ...], words: tuple[str, ...]
) -> None:
    assert_refused(view(capsys, *arguments), *words)


def test_an_unreadable_file_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    broken = tmp_path / "broken.json"
    broken.write_text('{"kind": ')
    assert_refused(view(capsys, broken), "broken.json")


def test_a_pickled_file_is_read_only_on_trust(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pickled = tmp_path / "grasps.npy"
    np.save(pickled, np.array([{"no": "grasp"}], dtype=object))
    assert_refused(view(capsys, pickled), "--trust-pickle")
    assert "--trust-pickle" not in view(capsys, pickled, "--trust-pickle").err


def test_a_file_is_shown_with_a_hand_that_no_model_is_of(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, cut_hands: Mapping[int, Hand], prior: PosturePrior
) -> None:
    hand, source, out = cut_hands[2], tmp_path / "pinches.json", tmp_path / "page.html"
    assert hand.mjcf is not None
    tasks = Tasks.repeat(Task.of("tip_pinch", "sphere:30mm", "x"), 2)
    grasps = Screened(Heuristic(hand, prior)).propose(tasks, np.random.default_rng(0))
    save_grasps(source, grasps, metadata={})
    asked = ["--hand", hand.mjcf.with_name("hand.yaml"), "--html", out]
    said = view(capsys, source, *asked)
    assert (said.status, said.err) == (0, "")
    assert out.exists()
    assert_refused(view(capsys, *asked), "is for shadow_hand_right", "hand_of_2")
    assert_refused(view(capsys, source, *asked, "--prior", "p.safetensors"), "--model heuristic or screened")
    assert_refused(view(capsys, source, "--hand", "barrett"), "unknown hand 'barrett'")


def test_without_viser_the_extra_is_named(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("graspcascade.cli.console.find_spec", lambda name: None)
    assert_refused(view(capsys), "viser", "'.[view]'")


def test_a_standalone_page_of_a_file_holds_everything(
    capsys: pytest.CaptureFixture[str], drawn: Grasps, tmp_path: Path
) -> None:
    source, out = tmp_path / "mine <b>.json", tmp_path / "page.html"
    save_grasps(source, drawn[[0, 30]], metadata={})
    said = view(capsys, source, "--html", out)
    assert (said.status, said.err) == (0, "")
    assert said.out == f"wrote 2 grasps with their trials under protocol paper to {out}\n"
    assert [path.name for path in tmp_path.iterdir() if path.suffix == ".html"] == ["page.html"]
    page = out.read_text(encoding="utf-8")
    assert "<title>mine &lt;b&gt; - graspcascade</title>" in page
    assert page.count('class="gc-table"') == 1
    assert "protocol paper" in page
    assert re.findall(r"""(?:src|href)=["']?https?:""", page) == []
