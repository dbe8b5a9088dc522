"""Meshes: closed, of the right extent and volume, on the bodies they belong to."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspcascade.hands import HandModel
from graspcascade.objects import CATALOGUE
from graspcascade.poses import Pose
from graspcascade.viewer.shapes import Mesh, box, capsule, cylinder, ellipsoid, hand_meshes, join, object_mesh

lengths = st.floats(0.001, 0.2)


def assert_closed(mesh: Mesh) -> None:
    """Every edge is walked once in each direction, corners at one place counting as one."""
    _, place = np.unique(np.round(mesh.vertices_m, 9), axis=0, return_inverse=True)
    corners = place.reshape(-1)[mesh.faces]
    edges = Counter((int(a), int(b)) for i in range(3) for a, b in zip(corners[:, i], corners[:, i - 2], strict=True))
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)


def volume(mesh: Mesh) -> float:
    """Measure the volume inside, positive if the triangles face outwards (divergence theorem)."""
    a, b, c = np.moveaxis(mesh.vertices_m[mesh.faces], 1, 0)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def extent(mesh: Mesh) -> np.ndarray:
    return np.asarray(np.ptp(mesh.vertices_m, axis=0))


@given(st.tuples(lengths, lengths, lengths))
def test_a_box_is_exact(half: tuple[float, float, float]) -> None:
    mesh = box(half)
    assert_closed(mesh)
    np.testing.assert_allclose(extent(mesh), 2 * np.array(half))
    assert volume(mesh) == pytest.approx(8 * np.prod(half))


@given(lengths, lengths)
def test_round_shapes_are_closed_and_of_their_size(radius: float, half: float) -> None:
    for mesh, height, true_volume in (
        (ellipsoid((radius, radius, half)), 2 * half, 4 / 3 * np.pi * radius**2 * half),
        (cylinder(radius, half), 2 * half, 2 * np.pi * radius**2 * half),
        (capsule(radius, half), 2 * (half + radius), np.pi * radius**2 * (2 * half + 4 / 3 * radius)),
    ):
        assert_closed(mesh)
        np.testing.assert_allclose(extent(mesh), [2 * radius, 2 * radius, height])
        # Facets cut a few percent off a round body.
        assert 0.93 * true_volume < volume(mesh) < true_volume


def test_joining_and_moving_keep_what_is_inside() -> None:
    parts = [box((0.01, 0.02, 0.03)), capsule(0.01, 0.02)]
    moved = join(parts).moved(Pose.of([0.1, 0.2, 0.3], [0.5, 0.5, -0.5, 0.5]))
    assert volume(moved) == pytest.approx(sum(map(volume, parts)))


@pytest.mark.parametrize("label", CATALOGUE)
def test_objects_have_their_catalogue_extents(label: str) -> None:
    mesh = object_mesh(CATALOGUE[label])
    assert_closed(mesh)
    np.testing.assert_allclose(extent(mesh), CATALOGUE[label].extents_m)


def test_every_moving_body_of_the_hand_has_a_shape_and_the_pads_lie_on_it(hand: HandModel) -> None:
    meshes = hand_meshes(hand)
    assert set(meshes) == {link.name for link in hand.kinematics.links}
    for place in hand.description.places.values():
        vertices = np.concatenate([mesh.vertices_m for mesh in meshes[place.body]])
        normal = np.array(place.normal)
        assert (vertices @ normal).max() == pytest.approx(float(np.dot(place.point_m, normal)), abs=0.0015)


def test_forearm_and_wrist_are_below_the_palm(hand: HandModel) -> None:
    palm = np.concatenate([mesh.vertices_m for mesh in hand_meshes(hand)["palm"]])
    assert palm[:, 2].min() < -0.2
    assert palm[:, 2].max() < 0.11
