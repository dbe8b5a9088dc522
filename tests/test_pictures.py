"""Pictures: what they show, that they are small, and what is said where they cannot be drawn."""

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import as_object
from graspcascade.core.poses import Pose
from graspcascade.core.protocols import Protocol
from graspcascade.hands import Hand, load_hand
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.viewer import Frame, pictures, record
from graspcascade.viewer.pictures import (
    Renderer,
    View,
    check_png,
    grasp_strip,
    need_matplotlib,
    save_png,
)

MAX_BYTES = 300_000


def drawable() -> bool:
    try:
        Renderer(load_hand(), width=8, height=8).close()
    except InputError:
        return False
    return importlib.util.find_spec("matplotlib") is not None


needs_drawing = pytest.mark.skipif(not drawable(), reason="needs libosmesa6 and matplotlib")


@pytest.fixture
def renderer(hand: Hand) -> Iterator[Renderer]:
    with Renderer(hand, width=70, height=84) as one:
        yield one


@pytest.fixture(scope="module")
def grasps() -> Grasps:
    return GraspSampler.pretrained().sample("tripod", "box_medium", "x", n=2, seed=0)


@pytest.fixture
def overlapping(grasps: Grasps) -> Grasps:
    columns = grasps.columns() | {"position_m": np.zeros((2, 3))}
    return Grasps.from_columns(grasps.hand, grasps.joint_names, grasps.tasks, columns)


def orange(picture: np.ndarray) -> int:
    red, _, blue = picture.astype(int).transpose(2, 0, 1)
    return int((red - blue > 60).sum())


def shot(
    renderer: Renderer, grasps: Grasps, obj: str = "box_medium", away_m: float = 0.0, view: View | None = None
) -> np.ndarray:
    pose = grasps.X_hand_object
    at = Pose(pose.position_m[0] + [0.0, 0.0, away_m], pose.quat_wxyz[0])
    return renderer.frame(Frame(as_object(obj), grasps.pregrasp[0], at, np.zeros(3)), view or View())


def size_of(path: Path) -> tuple[int, int]:
    image = importlib.import_module("PIL.Image")
    with image.open(path) as opened:
        return tuple(opened.size)


@needs_drawing
def test_a_picture_shows_hand_and_object_before_white(renderer: Renderer, grasps: Grasps) -> None:
    picture = shot(renderer, grasps)
    assert picture.shape == (84, 70, 3)
    assert (picture[0, 0] == 255).all()
    assert orange(picture) > 100
    grey = (picture < 250).all(axis=2).sum() - orange(picture)
    assert grey > 300


@needs_drawing
def test_a_larger_object_covers_more_of_the_picture(renderer: Renderer, grasps: Grasps) -> None:
    areas = [
        orange(shot(renderer, grasps, label)) for label in ("box_small", "box:24x37x50mm", "box_medium", "box_large")
    ]
    assert areas == sorted(areas)
    assert orange(shot(renderer, grasps, away_m=1.0)) == 0


@needs_drawing
def test_pictures_do_not_depend_on_what_was_drawn_before(renderer: Renderer, grasps: Grasps) -> None:
    first = shot(renderer, grasps)
    renderer.object(as_object("sphere_large"))
    shot(renderer, grasps, "cylinder_small")
    shot(renderer, grasps, "box:60x60x60mm")
    np.testing.assert_array_equal(shot(renderer, grasps), first)


@needs_drawing
def test_the_whole_hand_is_in_the_picture_from_every_side(hand: Hand, renderer: Renderer, grasps: Grasps) -> None:
    for azimuth in (28.0, 90.0, 162.0):
        drawn = (shot(renderer, grasps, view=View(azimuth_deg=azimuth)) < 250).any(axis=2)
        assert not drawn[0].any()
        assert not drawn[:60, [0, -1]].any()


@needs_drawing
def test_a_hand_is_drawn_upright_however_its_model_lies(
    hand: Hand, renderer: Renderer, grasps: Grasps, tmp_path: Path
) -> None:
    lying, file = tmp_path / "lying.xml", tmp_path / "hand.yaml"
    model = hand.mjcf.read_text()
    lying.write_text(model.replace('<body name="forearm">', '<body name="forearm" pos="1 2 3" euler="1.5 0.4 0">'))
    file.write_text(json.dumps({"base": "shadow", "mjcf": "lying.xml"}))
    with Renderer(load_hand(file), width=70, height=84) as other:
        apart = shot(other, grasps).astype(int) - shot(renderer, grasps)
    assert np.abs(apart).mean() < 1


@needs_drawing
def test_two_views_show_what_one_hides(hand: Hand, renderer: Renderer, grasps: Grasps, short: Protocol) -> None:
    (one,) = record(grasps[:1], hand, short)
    near, far = (renderer.frame(one.frame(-1), view) for view in (pictures.THUMB_SIDE, pictures.FINGER_SIDE))
    assert np.abs(near.astype(int) - far).mean() > 5


def test_moments_go_from_the_open_hand_to_the_end_of_the_trial(grasps: Grasps, hand: Hand, short: Protocol) -> None:
    for row, one in enumerate(record(grasps, hand, short)):
        placed, closed, end = pictures.moments(one)
        np.testing.assert_array_equal(placed.posture, grasps.pregrasp[row])
        np.testing.assert_allclose(placed.X_hand_object.position_m, grasps.X_hand_object.position_m[row])
        np.testing.assert_array_equal(closed.posture, one.outcome.settled_posture[0])
        np.testing.assert_array_equal(end.posture, one.posture[-1])


def test_a_trial_that_failed_at_its_start_repeats_the_start(overlapping: Grasps, hand: Hand, short: Protocol) -> None:
    one = record(overlapping, hand, short)[0]
    assert str(one.outcome.verdict[0]) == "overlap"
    for frame in pictures.moments(one):
        np.testing.assert_array_equal(frame.posture, overlapping.pregrasp[0])


@needs_drawing
def test_sheets_are_small_png_files(renderer: Renderer, grasps: Grasps, short: Protocol, tmp_path: Path) -> None:
    drawn = {"strip.png": grasp_strip(renderer, grasps, short)}
    for name, figure in drawn.items():
        save_png(figure, tmp_path / name)
        assert (tmp_path / name).stat().st_size < MAX_BYTES
        assert min(size_of(tmp_path / name)) > 400
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(drawn)


@needs_drawing
def test_a_sheet_tells_a_grasps_chance_where_it_is_known(renderer: Renderer, grasps: Grasps, short: Protocol) -> None:
    known = replace(grasps[:2], probability=np.array([0.93, np.nan]))
    words = [text.get_text() for axes in grasp_strip(renderer, known, short).axes for text in axes.texts]
    assert ["chance 93 %" in words[0], "chance" in words[1]] == [True, False]


@needs_drawing
def test_grasps_of_other_joints_are_refused(renderer: Renderer, grasps: Grasps) -> None:
    turned = replace(grasps, joint_names=grasps.joint_names[::-1])
    with pytest.raises(InputError, match="other joints"):
        grasp_strip(renderer, turned)


def test_a_missing_matplotlib_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("graspcascade.viewer.pictures.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pip install '.\[view\]'"):
        need_matplotlib()


def test_a_missing_renderer_names_the_package_and_the_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise ImportError("no OSMesa library")

    monkeypatch.setattr("graspcascade.viewer.pictures._context_class", missing)
    with pytest.raises(InputError, match=r"libosmesa6.*MUJOCO_GL=osmesa"):
        Renderer(load_hand())


def test_a_renderer_that_is_not_there_is_one_line_on_the_command_line(tmp_path: Path) -> None:
    picture = tmp_path / "grasp.png"
    command = [sys.executable, "-m", "graspcascade", "sample", "tripod", "box_medium", "--picture", str(picture)]
    # PyOpenGL cannot serve two platforms in one process, so OSMesa cannot be had with this one.
    environment = os.environ | {"MUJOCO_GL": "osmesa", "PYOPENGL_PLATFORM": "egl"}
    said = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert said.returncode == 2
    assert len(said.stderr.splitlines()) == 1
    assert "libosmesa6" in said.stderr or "'.[view]'" in said.stderr
    assert not picture.exists()


@pytest.mark.parametrize("name", ["grasps.jpg", "nowhere/grasps.png", "folder.png"])
def test_a_picture_that_cannot_be_written_is_refused_first(name: str, tmp_path: Path) -> None:
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(InputError, match=r"picture is a \.png file|is a folder"):
        check_png(tmp_path / name)


def test_sampling_alone_loads_no_renderer() -> None:
    code = "import graspcascade.cli.grasps, sys; sys.exit(any(m in sys.modules for m in ('mujoco', 'matplotlib')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
