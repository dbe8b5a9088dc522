"""Meshes on the page: closed, of the engine's own extent and volume, lit as they are curved, on the right bodies."""

import os

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

if not os.environ.get("CI"):  # where everything must run, a missing package is an error
    pytest.importorskip("trimesh")

from trimesh import Trimesh

from graspcascade.hands import HandModel
from graspcascade.objects import CATALOGUE
from graspcascade.poses import Pose, quat_to_matrix
from graspcascade.viewer.shapes import geom_part, hand_meshes, object_part

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
    part = geom_part(model, 0)
    assert part is not None
    assert part.rgb == (255, 36, 36)
    assert_closed(part.mesh)
    r, half = size[0], size[1]
    x, y, z = {
        "sphere": (r, r, r),
        "capsule": (r, r, half + r),
        "cylinder": (r, r, half),
    }.get(kind, size)
    turned = np.abs(quat_to_matrix(PLACE.quat_wxyz)) @ [2 * x, 2 * y, 2 * z]
    np.testing.assert_allclose(np.ptp(part.mesh.vertices, axis=0), turned, rtol=1e-6)
    np.testing.assert_allclose(part.mesh.bounds.mean(axis=0), PLACE.position_m, atol=1e-7)
    # Facets cut a few percent off a round body; a mesh inside out would have a negative volume.
    volume = float(model.body_mass[1])
    assert (1 - 1e-6 if kind == "box" else 0.95) * volume < part.mesh.volume < (1 + 1e-6) * volume


@pytest.mark.parametrize("kind", KINDS)
def test_flat_faces_are_lit_flat_and_round_ones_round(kind: str) -> None:
    size = {"sphere": (0.02,), "capsule": (0.01, 0.02), "cylinder": (0.01, 0.02)}.get(kind, (0.01, 0.015, 0.02))
    part = geom_part(compiled(kind, size), 0)
    assert part is not None
    assert shading_error_rad(part.mesh) < np.radians(1e-3 if kind == "box" else 15)


def test_a_geom_without_volume_has_no_mesh() -> None:
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom type='plane' size='1 1 1'/></worldbody></mujoco>")
    assert geom_part(model, 0) is None


@pytest.mark.parametrize("label", CATALOGUE)
def test_objects_have_their_catalogue_extents_and_are_lit_as_they_are_curved(label: str) -> None:
    obj, mesh = CATALOGUE[label], object_part(CATALOGUE[label]).mesh
    assert_closed(mesh)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), obj.extents_m)
    assert 0.99 * obj.volume_m3 < mesh.volume < (1 + 1e-9) * obj.volume_m3
    assert shading_error_rad(mesh) < np.radians(1e-3 if obj.shape == "box" else 6)


def test_every_moving_body_of_the_hand_has_a_shape_and_the_pads_lie_on_it(hand: HandModel) -> None:
    meshes = hand_meshes(hand)
    assert set(meshes) == {link.name for link in hand.kinematics.links}
    for place in hand.description.places.values():
        vertices = np.concatenate([part.mesh.vertices for part in meshes[place.body]])
        normal = np.array(place.normal)
        assert (vertices @ normal).max() == pytest.approx(float(np.dot(place.point_m, normal)), abs=0.0015)


def test_forearm_and_wrist_are_below_the_palm(hand: HandModel) -> None:
    palm = np.concatenate([part.mesh.vertices for part in hand_meshes(hand)["palm"]])
    assert palm[:, 2].min() < -0.2
    assert palm[:, 2].max() < 0.11
