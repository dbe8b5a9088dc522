"""Meshes on the page: closed, of the engine's own extent and volume, lit as they are curved, on the right bodies."""

import json
import os
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

if not os.environ.get("CI"):  # where everything must run, a missing package is an error
    pytest.importorskip("trimesh")

from trimesh import Trimesh

from graspcascade.core.objects import CATALOGUE, as_object
from graspcascade.core.poses import Pose, quat_to_matrix
from graspcascade.core.yaml_files import load_yaml
from graspcascade.hands import Hand, load_hand, shipped_hands
from graspcascade.viewer.shapes import body_rgb, geom_mesh, hand_bounds, hand_parts, shape_mesh

lengths = st.floats(0.001, 0.2)
# A third of a turn: axes stay axes, so that extents can be told.
PLACE = Pose.of([0.1, 0.2, 0.3], [0.5, 0.5, -0.5, 0.5])
KINDS = ["box", "sphere", "ellipsoid", "capsule", "cylinder"]


def assert_closed(mesh: Trimesh) -> None:
    """Every edge is walked once in each direction, corners at one place counting as one."""
    _, place = np.unique(np.round(mesh.vertices, 9), axis=0, return_inverse=True)
    corners = place.reshape(-1)[mesh.faces]
    walks = np.concatenate([corners[:, [i, (i + 1) % 3]] for i in range(3)])
    numbers, times = np.unique(walks @ [len(place), 1], return_counts=True)
    assert (times == 1).all()
    np.testing.assert_array_equal(np.sort(walks @ [1, len(place)]), numbers)


def shading_error_rad(mesh: Trimesh) -> float:
    """Measure the largest angle between a triangle and the light at its corners, as a browser works that out.

    A vertex is lit along the mean of the triangles that share it, by area.
    """
    a, b, c = np.moveaxis(np.asarray(mesh.vertices)[mesh.faces], 1, 0)
    facing = np.cross(b - a, c - a)
    lit = np.zeros_like(mesh.vertices)
    for corner in range(3):
        np.add.at(lit, mesh.faces[:, corner], facing)
    lit /= np.linalg.norm(lit, axis=1, keepdims=True)
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    along = np.einsum("fi,fci->fc", facing, lit[mesh.faces])
    return float(np.arccos(np.clip(along, -1, 1)).max())


def compiled(kind: str, size: tuple[float, ...]) -> mujoco.MjModel:
    """Compile one geom of density 1, so that the engine's mass of it is its volume."""
    numbers, place, turn = (" ".join(map(str, values)) for values in (size, PLACE.position_m, PLACE.quat_wxyz))
    return mujoco.MjModel.from_xml_string(
        "<mujoco><compiler boundmass='0' boundinertia='0'/><worldbody><body>"
        f"<geom type='{kind}' size='{numbers}' density='1' pos='{place}' quat='{turn}' rgba='1 0 0 1'/>"
        "</body></worldbody></mujoco>"
    )


@given(st.sampled_from(KINDS), st.tuples(lengths, lengths, lengths))
def test_a_geom_is_meshed_where_and_as_large_as_the_engine_has_it(kind: str, size: tuple[float, float, float]) -> None:
    model = compiled(kind, size[: {"sphere": 1, "capsule": 2, "cylinder": 2}.get(kind, 3)])
    mesh = geom_mesh(model, 0)
    assert mesh is not None
    assert_closed(mesh)
    r, half = size[0], size[1]
    x, y, z = {
        "sphere": (r, r, r),
        "capsule": (r, r, half + r),
        "cylinder": (r, r, half),
    }.get(kind, size)
    turned = np.abs(quat_to_matrix(PLACE.quat_wxyz)) @ [2 * x, 2 * y, 2 * z]
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), turned, rtol=1e-6)
    np.testing.assert_allclose(mesh.bounds.mean(axis=0), PLACE.position_m, atol=1e-7)
    # Facets cut a few percent off a round body; a mesh inside out would have a negative volume.
    volume = float(model.body_mass[1])
    assert (1 - 1e-6 if kind == "box" else 0.95) * volume < mesh.volume < (1 + 1e-6) * volume


@pytest.mark.parametrize("kind", KINDS)
def test_flat_faces_are_lit_flat_and_round_ones_round(kind: str) -> None:
    size = {"sphere": (0.02,), "capsule": (0.01, 0.02), "cylinder": (0.01, 0.02)}.get(kind, (0.01, 0.015, 0.02))
    mesh = geom_mesh(compiled(kind, size), 0)
    assert mesh is not None
    assert shading_error_rad(mesh) < np.radians(1e-3 if kind == "box" else 15)


def test_a_geom_without_volume_has_no_mesh() -> None:
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom type='plane' size='1 1 1'/></worldbody></mujoco>")
    assert geom_mesh(model, 0) is None


@pytest.mark.parametrize("name", [*CATALOGUE, "box:32x41x60mm", "cylinder:18x120mm", "sphere:41mm"])
def test_objects_have_their_extents_and_are_lit_as_they_are_curved(name: str) -> None:
    obj = as_object(name)
    mesh = shape_mesh(obj.shape)
    assert_closed(mesh)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), obj.extents_m)
    assert 0.99 * obj.shape.volume_m3 < mesh.volume < (1 + 1e-9) * obj.shape.volume_m3
    assert shading_error_rad(mesh) < np.radians(1e-3 if obj.shape.kind == "box" else 6)
    assert shape_mesh(as_object(name).shape) is mesh


def vertices(hand: Hand, body: str) -> np.ndarray:
    return np.concatenate([part.mesh.vertices for part in hand_parts(hand) if part.body == body])


def test_every_moving_body_of_the_hand_has_a_shape_and_the_pads_lie_on_it(hand: Hand) -> None:
    assert {part.body for part in hand_parts(hand)} == {link.name for link in hand.kinematics.links}
    for place in hand.places.values():
        normal = np.array(place.normal)
        surface = float((vertices(hand, place.body) @ normal).max())
        assert surface == pytest.approx(float(np.dot(place.point_m, normal)), abs=0.0015)


def test_forearm_and_wrist_are_below_the_palm_in_a_colour_of_their_own(hand: Hand) -> None:
    palm = vertices(hand, "palm")
    assert palm[:, 2].min() < -0.2
    assert palm[:, 2].max() < 0.11
    assert {part.rgb for part in hand_parts(hand) if part.body == "palm"} == {
        body_rgb(hand, "palm"),
        body_rgb(hand, "forearm"),
    }


def test_a_hand_of_three_digits_is_drawn_and_framed(tmp_path: Path) -> None:
    entries, kept = load_yaml(shipped_hands()["shadow"]), ("thumb", "index", "middle")
    some = {key: {k: v for k, v in entries[key].items() if k.startswith(kept)} for key in ("digits", "places")}
    file = tmp_path / "hand.yaml"
    file.write_text(json.dumps({"base": "shadow", "name": "three"} | some))
    three = load_hand(file)
    assert list(three.digits) == ["thumb", "index", "middle"]
    assert {part.body for part in hand_parts(three)} == {link.name for link in three.kinematics.links}
    centre, radius = hand_bounds(three)
    for posture in (three.pregrasp, np.zeros_like(three.pregrasp)):
        for tip in three.tips(posture, list(three.digits)).values():
            assert np.linalg.norm(tip - centre) < radius + 0.02
