"""Rigid transforms: the group axioms, the sign of quaternions, angles, and what is refused."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from graspcascade.core.errors import InputError
from graspcascade.core.poses import (
    Pose,
    as_quat,
    as_rotation,
    canonical_quat,
    matrix_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_matrix,
    rotate,
    rotation_angle,
)

ORIGIN, IDENTITY = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
CLOSE = 1e-9

batch_shapes = st.sampled_from([(), (1,), (3,), (2, 3)])
coordinates = st.floats(-2.0, 2.0)


def vectors(shape: tuple[int, ...] = ()) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(float, (*shape, 3), elements=coordinates)


def raw_quats(shape: tuple[int, ...] = ()) -> st.SearchStrategy[np.ndarray]:
    def long_enough(quat: np.ndarray) -> bool:
        return bool((np.linalg.norm(quat, axis=-1) > 0.1).all())

    return hnp.arrays(float, (*shape, 4), elements=st.floats(-1.0, 1.0), fill=st.just(0.5)).filter(long_enough)


def quats(shape: tuple[int, ...] = ()) -> st.SearchStrategy[np.ndarray]:
    return raw_quats(shape).map(canonical_quat)


def poses(shape: tuple[int, ...] = ()) -> st.SearchStrategy[Pose]:
    return st.builds(Pose.of, vectors(shape), quats(shape))


def pose_batches(count: int) -> st.SearchStrategy[tuple[Pose, ...]]:
    return batch_shapes.flatmap(lambda shape: st.tuples(*[poses(shape)] * count))


def assert_same_pose(a: Pose, b: Pose) -> None:
    np.testing.assert_allclose(a.position_m, b.position_m, atol=CLOSE)
    assert a.quat_wxyz.shape == b.quat_wxyz.shape
    assert (rotation_angle(a.quat_wxyz, b.quat_wxyz) < 1e-7).all()


# -- the group of rigid transforms


@given(pose_batches(3))
def test_composition_is_associative(batch: tuple[Pose, Pose, Pose]) -> None:
    a, b, c = batch
    assert_same_pose((a @ b) @ c, a @ (b @ c))


@given(pose_batches(1))
def test_the_identity_changes_nothing_from_either_side(batch: tuple[Pose]) -> None:
    (pose,) = batch
    identity = Pose.of(ORIGIN, IDENTITY)
    assert_same_pose(identity @ pose, pose)
    assert_same_pose(pose @ identity, pose)


@given(pose_batches(1))
def test_a_pose_and_its_inverse_cancel_from_either_side(batch: tuple[Pose]) -> None:
    (pose,) = batch
    identity = Pose(np.zeros_like(pose.position_m), np.broadcast_to(IDENTITY, pose.quat_wxyz.shape))
    assert_same_pose(pose @ pose.inverse(), identity)
    assert_same_pose(pose.inverse() @ pose, identity)
    assert_same_pose(pose.inverse().inverse(), pose)


@given(pose_batches(2))
def test_the_inverse_of_a_composition_is_the_reversed_composition_of_inverses(batch: tuple[Pose, Pose]) -> None:
    a, b = batch
    assert_same_pose((a @ b).inverse(), b.inverse() @ a.inverse())


@given(batch_shapes.flatmap(lambda shape: st.tuples(poses(shape), poses(shape), vectors(shape))))
def test_applying_a_composition_is_applying_one_after_the_other(drawn: tuple[Pose, Pose, np.ndarray]) -> None:
    a, b, points = drawn
    np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), atol=CLOSE)
    np.testing.assert_allclose(a.inverse().apply(a.apply(points)), points, atol=CLOSE)


@given(poses(), poses((4,)))
def test_one_pose_composes_with_a_batch_as_with_each_of_its_rows(one: Pose, many: Pose) -> None:
    before, after = one @ many, many @ one
    for row in range(4):
        each = Pose(many.position_m[row], many.quat_wxyz[row])
        assert_same_pose(Pose(before.position_m[row], before.quat_wxyz[row]), one @ each)
        assert_same_pose(Pose(after.position_m[row], after.quat_wxyz[row]), each @ one)


@given(poses(), vectors((5,)))
def test_one_pose_maps_a_cloud_of_points_without_changing_distances(pose: Pose, points: np.ndarray) -> None:
    mapped = pose.apply(points)
    assert mapped.shape == points.shape
    np.testing.assert_allclose(
        np.linalg.norm(mapped[0] - mapped, axis=-1), np.linalg.norm(points[0] - points, axis=-1), atol=CLOSE
    )


def test_composition_reads_like_its_frames() -> None:
    # A quarter turn about z, one metre along x: the body's x axis points along the world's y.
    X_world_body = Pose.of([1.0, 0.0, 0.0], canonical_quat([1.0, 0.0, 0.0, 1.0]))
    np.testing.assert_allclose(X_world_body.apply([1.0, 0.0, 0.0]), [1.0, 1.0, 0.0], atol=CLOSE)
    X_body_tool = Pose.of([0.0, 2.0, 0.0], IDENTITY)
    np.testing.assert_allclose((X_world_body @ X_body_tool).position_m, [-1.0, 0.0, 0.0], atol=CLOSE)


def test_empty_batches_stay_empty() -> None:
    nothing = Pose.of(np.zeros((0, 3)), np.zeros((0, 4)))
    assert (nothing @ nothing.inverse()).position_m.shape == (0, 3)
    assert (Pose.of(ORIGIN, IDENTITY) @ nothing).quat_wxyz.shape == (0, 4)
    assert quat_to_matrix(nothing.quat_wxyz).shape == (0, 3, 3)


# -- quaternions


@given(batch_shapes.flatmap(raw_quats), st.floats(0.01, 100.0))
def test_canonical_quaternions_are_unit_with_w_not_negative(quat: np.ndarray, scale: float) -> None:
    canonical = canonical_quat(quat * scale)
    np.testing.assert_allclose(np.linalg.norm(canonical, axis=-1), 1.0, atol=CLOSE)
    assert (canonical[..., 0] >= 0).all()
    np.testing.assert_allclose(canonical_quat(canonical), canonical, atol=CLOSE)


@given(raw_quats())
def test_a_quaternion_and_its_negative_have_one_canonical_form(quat: np.ndarray) -> None:
    np.testing.assert_allclose(canonical_quat(-quat), canonical_quat(quat), atol=1e-11)
    np.testing.assert_allclose(
        quat_to_matrix(canonical_quat(quat)), as_rotation(quat).as_matrix(), atol=CLOSE, err_msg="the rotation changed"
    )


@given(batch_shapes.flatmap(raw_quats))
def test_a_matrix_gives_back_its_quaternion(quat: np.ndarray) -> None:
    unit = canonical_quat(quat)
    assert (rotation_angle(matrix_to_quat(quat_to_matrix(unit)), unit) < 1e-7).all()


@pytest.mark.parametrize("axis", np.eye(3))
def test_half_turns_survive_the_way_through_a_matrix(axis: np.ndarray) -> None:
    # At a half-turn three of the four formulas divide by zero.
    np.testing.assert_allclose(matrix_to_quat(2 * np.outer(axis, axis) - np.eye(3)), [0.0, *axis], atol=CLOSE)


@pytest.mark.parametrize(
    ("quat", "canonical"),
    [
        ([0, -1, 0, 0], [0, 1, 0, 0]),
        ([0, 0, -2, 0], [0, 0, 1, 0]),
        ([0, 0, 0, -1], [0, 0, 0, 1]),
        ([-3, 0, 0, 0], [1, 0, 0, 0]),
        ([1e-17, -1, 0, 0], [0, 1, 0, 0]),
        ([-1e-14, 1, 0, 0], [0, 1, 0, 0]),
    ],
)
def test_the_sign_of_a_half_turn_follows_its_first_component_and_not_rounding(quat: list, canonical: list) -> None:
    made = canonical_quat(quat)
    np.testing.assert_allclose(made, canonical, atol=1e-12)
    assert made[0] >= 0


def test_canonicalising_leaves_its_argument_alone() -> None:
    quat = np.array([-1.0, 0.0, 0.0, 0.0])
    canonical_quat(quat)
    assert quat.tolist() == [-1, 0, 0, 0]


@given(quats(), quats(), vectors())
def test_a_product_rotates_by_its_right_factor_first(a: np.ndarray, b: np.ndarray, vector: np.ndarray) -> None:
    np.testing.assert_allclose(rotate(quat_multiply(a, b), vector), rotate(a, rotate(b, vector)), atol=CLOSE)


@given(quats((3,)), quats((3,)))
def test_products_and_matrices_agree_with_scipy(a: np.ndarray, b: np.ndarray) -> None:
    expected = as_rotation(a) * as_rotation(b)
    assert (rotation_angle(quat_multiply(a, b), as_quat(expected)) < 1e-7).all()
    np.testing.assert_allclose(quat_to_matrix(a) @ quat_to_matrix(b), expected.as_matrix(), atol=CLOSE)


@given(quats(), vectors())
def test_rotating_back_by_the_conjugate_restores_a_vector(quat: np.ndarray, vector: np.ndarray) -> None:
    np.testing.assert_allclose(rotate(quat_conjugate(quat), rotate(quat, vector)), vector, atol=CLOSE)
    np.testing.assert_allclose(quat_to_matrix(quat) @ vector, rotate(quat, vector), atol=CLOSE)


@given(batch_shapes.flatmap(quats))
def test_a_quaternion_survives_the_way_through_scipy(quat: np.ndarray) -> None:
    flat = quat.reshape(-1, 4)
    assert (rotation_angle(as_quat(as_rotation(flat)), flat) < 1e-7).all()
    assert quat_to_matrix(quat).shape == (*quat.shape[:-1], 3, 3)


# -- the angle between rotations


@given(quats(), vectors(), st.floats(0.0, np.pi))
def test_turning_by_an_angle_is_that_angle_away(quat: np.ndarray, axis: np.ndarray, angle_rad: float) -> None:
    assume(np.linalg.norm(axis) > 0.1)
    axis = axis / np.linalg.norm(axis)
    turn = np.concatenate([[np.cos(angle_rad / 2)], np.sin(angle_rad / 2) * axis])
    assert rotation_angle(quat, quat_multiply(quat, turn)) == pytest.approx(angle_rad, abs=1e-7)
    assert rotation_angle(quat, -quat_multiply(quat, turn)) == pytest.approx(angle_rad, abs=1e-7)


@given(quats(), quats(), quats())
def test_the_angle_is_a_distance_that_does_not_depend_on_the_frame(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    assert 0 <= rotation_angle(a, b) <= np.pi + CLOSE
    assert rotation_angle(a, a) < 1e-7
    assert rotation_angle(a, b) == pytest.approx(rotation_angle(b, a), abs=1e-7)
    assert rotation_angle(a, c) <= rotation_angle(a, b) + rotation_angle(b, c) + 1e-7
    assert rotation_angle(quat_multiply(c, a), quat_multiply(c, b)) == pytest.approx(rotation_angle(a, b), abs=1e-7)


# -- what is refused


@given(quats(), st.floats(0.0, 10.0).filter(lambda norm: abs(norm - 1) > 0.0011))
def test_a_quaternion_that_is_not_unit_is_refused_with_its_norm(quat: np.ndarray, norm: float) -> None:
    with pytest.raises(InputError, match=r"\(qw qx qy qz\) must have norm 1, got norm "):
        Pose.of(ORIGIN, quat * norm)


@given(quats(), st.floats(0.9995, 1.0005))
def test_a_norm_off_by_rounding_is_accepted_and_mended(quat: np.ndarray, norm: float) -> None:
    mended = Pose.of(ORIGIN, quat * norm).quat_wxyz
    np.testing.assert_allclose(np.linalg.norm(mended), 1.0, atol=CLOSE)


def test_the_worst_norm_of_a_batch_is_the_one_reported() -> None:
    with pytest.raises(InputError, match=r"got norm 3$"):
        Pose.of(np.zeros((3, 3)), [IDENTITY, IDENTITY * 3, IDENTITY * 2])


def test_a_norm_too_large_to_compute_is_refused_without_a_warning() -> None:
    with pytest.raises(InputError, match="got norm inf"):
        Pose.of(ORIGIN, [1e300, 1e300, 0, 0])


@given(st.integers(0, 6), st.sampled_from([np.nan, np.inf, -np.inf]))
def test_a_value_that_is_not_finite_is_refused_wherever_it_stands(place: int, value: float) -> None:
    numbers = np.concatenate([ORIGIN, IDENTITY])
    numbers[place] = value
    with pytest.raises(InputError, match="must be finite"):
        Pose.of(numbers[:3], numbers[3:])


@pytest.mark.parametrize(
    ("position_shape", "quat_shape"),
    [((2,), (4,)), ((3,), (3,)), ((2, 3), (4,)), ((2, 3), (3, 4)), ((), (4,)), ((4,), (3,)), ((3, 1), (4, 1))],
)
def test_wrong_shapes_are_refused_and_named(position_shape: tuple[int, ...], quat_shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError) as caught:
        Pose.of(np.zeros(position_shape), np.ones(quat_shape))
    assert str(position_shape) in str(caught.value)
    assert str(quat_shape) in str(caught.value)


@pytest.mark.parametrize("quat", [["one", 0, 0, 0], [[1, 0, 0, 0], [1, 0]], None, [1 + 2j, 0, 0, 0]])
def test_what_is_no_array_of_numbers_is_refused(quat: object) -> None:
    with pytest.raises(InputError, match="a pose needs"):
        Pose.of(ORIGIN, quat)
