"""Pictures: what they show, that they are small, and what is said where they cannot be drawn."""

import importlib.util
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from graspcascade.cascade import GraspSampler
from graspcascade.errors import InputError
from graspcascade.grasps import Grasps
from graspcascade.pictures import Studio, grasp_strip, need_matplotlib, objects_sheet, pose_frames, save_png, stages_of
from graspcascade.pictures import sheets as sheets_module
from graspcascade.pictures.paper import check_png
from graspcascade.poses import Pose
from graspcascade.taxonomy import GRASP_TYPES
from graspcascade.trials import Protocol

MAX_BYTES = 300_000


def drawable() -> bool:
    try:
        Studio(width=8, height=8).close()
    except InputError:
        return False
    return importlib.util.find_spec("matplotlib") is not None


needs_drawing = pytest.mark.skipif(not drawable(), reason="needs libosmesa6 and matplotlib")


@pytest.fixture
def studio() -> Iterator[Studio]:
    with Studio(width=70, height=84) as found:
        yield found


@pytest.fixture(scope="module")
def grasps() -> Grasps:
    return GraspSampler.pretrained().sample("tripod", "box_medium", "x", n=2, seed=0)


def orange(picture: np.ndarray) -> int:
    red, _, blue = picture.astype(int).transpose(2, 0, 1)
    return int((red - blue > 60).sum())


def shot(studio: Studio, grasps: Grasps, label: str = "box_medium", away_m: float = 0.0) -> np.ndarray:
    pose = grasps.X_hand_object
    at = Pose(pose.position_m[0] + [0.0, 0.0, away_m], pose.quat_wxyz[0])
    return studio.grasp(label, grasps.joint_names, grasps.pregrasp[0], at)


def size_of(path: Path) -> tuple[int, int]:
    image = importlib.import_module("PIL.Image")
    with image.open(path) as opened:
        return tuple(opened.size)


@needs_drawing
def test_a_picture_shows_hand_and_object_before_white(studio: Studio, grasps: Grasps) -> None:
    picture = shot(studio, grasps)
    assert picture.shape == (84, 70, 3)
    assert (picture[0, 0] == 255).all()
    assert orange(picture) > 100
    grey = (picture < 250).all(axis=2).sum() - orange(picture)
    assert grey > 300


@needs_drawing
def test_a_larger_object_covers_more_of_the_picture(studio: Studio, grasps: Grasps) -> None:
    areas = [orange(shot(studio, grasps, label)) for label in ("box_small", "box_medium", "box_large")]
    assert areas == sorted(areas)
    assert orange(shot(studio, grasps, away_m=1.0)) == 0


@needs_drawing
def test_pictures_do_not_depend_on_what_was_drawn_before(studio: Studio, grasps: Grasps) -> None:
    first = shot(studio, grasps)
    studio.object("sphere_large")
    shot(studio, grasps, "cylinder_small")
    np.testing.assert_array_equal(shot(studio, grasps), first)


def test_stages_go_from_the_open_hand_to_the_end_of_the_trial(grasps: Grasps, short: Protocol) -> None:
    for row, stages in enumerate(stages_of(grasps, short)):
        np.testing.assert_array_equal(stages.posture[0], grasps.pregrasp[row])
        np.testing.assert_allclose(stages.X_hand_object.position_m[0], grasps.X_hand_object.position_m[row])
        assert np.abs(stages.posture[1] - stages.posture[0]).max() > 0.1
        assert np.isfinite(stages.posture).all()
        assert stages.verdict == "held"


def test_a_trial_that_failed_at_its_start_repeats_the_start(grasps: Grasps, short: Protocol) -> None:
    inside = Grasps.from_columns(grasps.joint_names, grasps.columns() | {"position_m": np.zeros((2, 3))})
    stages = stages_of(inside, short)[0]
    assert stages.verdict == "overlap"
    np.testing.assert_array_equal(stages.posture, np.broadcast_to(stages.posture[0], stages.posture.shape))


@needs_drawing
def test_sheets_are_small_png_files(studio: Studio, grasps: Grasps, short: Protocol, tmp_path: Path) -> None:
    sampler = GraspSampler.pretrained()
    drawn = {
        "strip.png": grasp_strip(studio, grasps, short),
        "objects.png": objects_sheet(studio),
        "frames.png": pose_frames([sampler.sample(kind, "box_medium", n=5) for kind in GRASP_TYPES]),
    }
    for name, figure in drawn.items():
        save_png(figure, tmp_path / name)
        assert (tmp_path / name).stat().st_size < MAX_BYTES
        assert min(size_of(tmp_path / name)) > 400
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(drawn)


@needs_drawing
def test_a_type_none_of_whose_samples_is_faithful_is_named(studio: Studio, grasps: Grasps, short: Protocol) -> None:
    inside = Grasps.from_columns(grasps.joint_names, grasps.columns() | {"position_m": np.zeros((2, 3))})
    with pytest.raises(InputError, match="none of 2 tripod grasps of box_medium"):
        sheets_module.grasp_types_sheet(studio, lambda *_: inside, short)


def test_every_type_has_its_place_on_the_sheet() -> None:
    assert [kind for kind, _ in sheets_module.TYPES_ON] == list(GRASP_TYPES)


def test_a_missing_matplotlib_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("graspcascade.pictures.paper.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pip install 'graspcascade\[view\]'"):
        need_matplotlib()


def test_a_missing_renderer_names_the_package_and_the_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise ImportError("no OSMesa library")

    monkeypatch.setattr("graspcascade.pictures.studio._context_class", missing)
    with pytest.raises(InputError, match=r"libosmesa6.*MUJOCO_GL=osmesa"):
        Studio()


def test_a_renderer_that_is_not_there_is_one_line_on_the_command_line(tmp_path: Path) -> None:
    picture = tmp_path / "grasp.png"
    command = [sys.executable, "-m", "graspcascade.cli", "sample", "tripod", "box_medium", "--picture", str(picture)]
    # PyOpenGL cannot serve two platforms in one process, so OSMesa cannot be had with this one.
    environment = os.environ | {"MUJOCO_GL": "osmesa", "PYOPENGL_PLATFORM": "egl"}
    said = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert said.returncode == 2
    assert len(said.stderr.splitlines()) == 1
    assert "libosmesa6" in said.stderr or "graspcascade[view]" in said.stderr
    assert not picture.exists()


@pytest.mark.parametrize("name", ["grasps.jpg", "nowhere/grasps.png", "folder.png"])
def test_a_picture_that_cannot_be_written_is_refused_first(name: str, tmp_path: Path) -> None:
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(InputError, match=r"picture is a \.png file|is a folder"):
        check_png(tmp_path / name)


def test_sampling_alone_loads_no_renderer() -> None:
    code = "import graspcascade.cli.sample, sys; sys.exit(any(m in sys.modules for m in ('mujoco', 'matplotlib')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
