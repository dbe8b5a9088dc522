"""Signed distances from points to primitives, compared with MuJoCo's and with themselves."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspcascade.core.distances import signed_distances
from graspcascade.core.objects import Box, Cylinder, Shape, Sphere

lengths = st.floats(0.01, 0.1)
shapes = st.one_of(
    st.builds(Box, lengths, lengths, lengths), st.builds(Cylinder, lengths, lengths), st.builds(Sphere, lengths)
)
points = st.lists(st.tuples(*[st.floats(-0.12, 0.12)] * 3), min_size=1, max_size=8).map(np.array)
ZERO = np.zeros(1, dtype=np.intp)


@settings(deadline=None)
@given(shapes, points)
def test_a_step_against_the_gradient_ends_on_the_surface(shape: Shape, some: np.ndarray) -> None:
    measured = signed_distances([shape], ZERO, some[None])
    assert measured.gradient is not None
    landed = some - measured.distance_m[0][:, None] * measured.gradient[0]
    again = signed_distances([shape], ZERO, landed[None]).distance_m[0]
    np.testing.assert_allclose(again, 0.0, atol=1e-9)


@settings(deadline=None)
@given(shapes, points, st.integers(0, 2**32 - 1))
def test_no_distance_changes_faster_than_the_point_moves(shape: Shape, some: np.ndarray, seed: int) -> None:
    moved = some + 0.01 * np.random.default_rng(seed).standard_normal(some.shape)
    before, after = (signed_distances([shape], ZERO, each[None]).distance_m[0] for each in (some, moved))
    assert (np.abs(after - before) <= np.linalg.norm(moved - some, axis=1) + 1e-12).all()


@pytest.mark.parametrize(
    ("shape", "geom"),
    [
        (Box(0.03, 0.05, 0.07), 'type="box" size="0.015 0.025 0.035"'),
        (Cylinder(0.04, 0.07), 'type="cylinder" size="0.02 0.035"'),
        (Sphere(0.05), 'type="sphere" size="0.025"'),
    ],
)
def test_distances_outside_are_those_of_mujoco(shape: Shape, geom: str) -> None:
    probe = '<body name="probe"><freejoint/><geom name="probe" size="0.001"/></body>'
    model = mujoco.MjModel.from_xml_string(f'<mujoco><worldbody><geom name="it" {geom}/>{probe}</worldbody></mujoco>')
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    outside = [
        p for p in rng.uniform(-0.1, 0.1, (200, 3)) if signed_distances([shape], ZERO, p[None, None]).distance_m > 0.002
    ]
    assert len(outside) > 100
    for point in outside:
        data.qpos[:3] = point
        mujoco.mj_kinematics(model, data)
        theirs = mujoco.mj_geomDistance(model, data, model.geom("it").id, model.geom("probe").id, 1.0, None) + 0.001
        ours = signed_distances([shape], ZERO, point[None, None]).distance_m[0, 0]
        assert ours == pytest.approx(theirs, abs=2e-5)


def test_rows_of_mixed_shapes_are_measured_each_against_its_own() -> None:
    rng = np.random.default_rng(0)
    kinds, row = [Box(0.02, 0.03, 0.04), Sphere(0.05), Cylinder(0.03, 0.06)], rng.integers(3, size=40)
    some = rng.uniform(-0.05, 0.05, (40, 7, 3)).astype(np.float32)
    together = signed_distances(kinds, row, some)
    assert together.gradient is not None
    assert together.distance_m.dtype == together.gradient.dtype == np.float32
    without = signed_distances(kinds, row, some, gradients=False)
    assert without.gradient is None
    np.testing.assert_array_equal(without.distance_m, together.distance_m)
    for place in range(40):
        alone = signed_distances([kinds[row[place]]], ZERO, some[place : place + 1])
        np.testing.assert_array_equal(together.distance_m[place], alone.distance_m[0])
        assert alone.gradient is not None
        np.testing.assert_array_equal(together.gradient[place], alone.gradient[0])
