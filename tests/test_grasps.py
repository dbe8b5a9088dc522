"""`Grasps`: selecting, joining and rebuilding batches, and the hand pose that keeps each grasp."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspcascade.errors import InputError
from graspcascade.grasps import Grasps
from graspcascade.objects import CATALOGUE
from graspcascade.poses import Pose, canonical_quat, rotation_angle
from graspcascade.taxonomy import GRASP_TYPES

JOINTS = ("THJ5", "THJ4", "FFJ3")
COLUMNS = {
    "grasp_type",
    "object_label",
    "side_axis",
    "side_m",
    "posture",
    "pregrasp",
    "grasp_size_m",
    "object_size_m",
    "probability",
    "position_m",
    "quat_wxyz",
}

seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(0, 6)


def random_pose(rng: np.random.Generator, *shape: int) -> Pose:
    return Pose.of(rng.normal(size=(*shape, 3)), canonical_quat(rng.normal(size=(*shape, 4))))


def make_grasps(n: int, seed: int = 0, joint_names: tuple[str, ...] = JOINTS) -> Grasps:
    rng = np.random.default_rng(seed)
    objects = [list(CATALOGUE.values())[i] for i in rng.integers(len(CATALOGUE), size=n)]
    axes = [rng.choice(list(obj.graspable_sides_m)) for obj in objects]
    return Grasps(
        joint_names=joint_names,
        grasp_type=np.array([list(GRASP_TYPES)[i] for i in rng.integers(len(GRASP_TYPES), size=n)], dtype=np.str_),
        object_label=np.array([obj.label for obj in objects], dtype=np.str_),
        side_axis=np.array(axes, dtype=np.str_),
        side_m=np.array([obj.sides_m[axis] for obj, axis in zip(objects, axes, strict=True)], dtype=float),
        posture=rng.uniform(0, 1.5, (n, len(joint_names))),
        pregrasp=rng.uniform(0, 0.5, (n, len(joint_names))),
        X_hand_object=random_pose(rng, n),
        grasp_size_m=rng.uniform(0.01, 0.06, n),
        object_size_m=np.full(n, np.nan),
        probability=rng.uniform(0, 1, n),
    )


def assert_same_grasps(a: Grasps, b: Grasps) -> None:
    assert a.joint_names == b.joint_names
    theirs = b.columns()
    for name, column in a.columns().items():
        np.testing.assert_array_equal(column, theirs[name], err_msg=name)


# -- round trips


@given(sizes, seeds)
def test_a_batch_survives_the_way_through_its_columns(n: int, seed: int) -> None:
    grasps = make_grasps(n, seed)
    columns = grasps.columns()
    assert set(columns) == COLUMNS
    assert all(len(column) == n for column in columns.values())
    assert_same_grasps(Grasps.from_columns(list(JOINTS), columns), grasps)


@given(st.lists(sizes, min_size=1, max_size=4), seeds)
def test_joining_and_selecting_undo_each_other(lengths: list[int], seed: int) -> None:
    parts = [make_grasps(n, seed + i) for i, n in enumerate(lengths)]
    joined = Grasps.concatenate(parts)
    assert len(joined) == sum(lengths)
    ends = np.cumsum(lengths)
    for part, end in zip(parts, ends, strict=True):
        assert_same_grasps(joined[end - len(part) : end], part)


@given(st.integers(1, 6), seeds)
def test_walking_gives_batches_of_one_that_join_to_the_whole(n: int, seed: int) -> None:
    grasps = make_grasps(n, seed)
    walked = list(grasps)
    assert [len(grasp) for grasp in walked] == [1] * n
    assert_same_grasps(Grasps.concatenate(walked), grasps)


def test_walking_an_empty_batch_gives_nothing() -> None:
    assert list(make_grasps(0)) == []


# -- selecting rows


@given(st.integers(1, 6), seeds, st.data())
def test_slices_indices_and_masks_that_name_the_same_rows_select_the_same(
    n: int, seed: int, data: st.DataObject
) -> None:
    grasps = make_grasps(n, seed)
    start, stop = sorted(data.draw(st.tuples(st.integers(0, n), st.integers(0, n))))
    mask = np.zeros(n, dtype=bool)
    mask[start:stop] = True
    by_slice = grasps[start:stop]
    assert len(by_slice) == stop - start
    for rows in (np.arange(start, stop), list(range(start, stop)), mask, mask.tolist()):
        assert_same_grasps(grasps[rows], by_slice)


@given(st.integers(1, 6), seeds, st.data())
def test_one_index_selects_a_batch_of_one(n: int, seed: int, data: st.DataObject) -> None:
    grasps, row = make_grasps(n, seed), data.draw(st.integers(-6, 5).filter(lambda i: -n <= i < n))
    chosen = grasps[row]
    assert len(chosen) == 1
    assert chosen.grasp_type[0] == grasps.grasp_type[row]
    np.testing.assert_array_equal(chosen.X_hand_object.position_m[0], grasps.X_hand_object.position_m[row])
    assert_same_grasps(grasps[np.int64(row)], chosen)


def test_rows_may_be_reordered_and_repeated() -> None:
    grasps = make_grasps(3)
    assert grasps[[2, 0, 2]].side_m.tolist() == [grasps.side_m[2], grasps.side_m[0], grasps.side_m[2]]
    assert_same_grasps(grasps[::-1][::-1], grasps)


@pytest.mark.parametrize("rows", [[], np.array([], dtype=int), np.zeros(3, dtype=bool), slice(0, 0)])
def test_selecting_nothing_gives_an_empty_batch_of_the_same_joints(rows: object) -> None:
    nothing = make_grasps(3)[rows]
    assert len(nothing) == 0
    assert nothing.joint_names == JOINTS
    assert nothing.posture.shape == (0, 3)


@pytest.mark.parametrize("rows", [3, [0, 7], np.array([True, False])])
def test_rows_that_do_not_exist_are_refused(rows: object) -> None:
    with pytest.raises(IndexError):
        make_grasps(3)[rows]


# -- the hand follows the object


@given(st.integers(0, 5), seeds)
def test_one_hand_pose_per_grasp_keeps_the_object_where_it_is(n: int, seed: int) -> None:
    grasps = make_grasps(n, seed)
    X_world_object = random_pose(np.random.default_rng(seed + 1))
    X_world_hand = grasps.hand_pose(X_world_object)
    assert X_world_hand.position_m.shape == (n, 3)
    assert X_world_hand.quat_wxyz.shape == (n, 4)
    back = X_world_hand @ grasps.X_hand_object
    np.testing.assert_allclose(back.position_m, np.broadcast_to(X_world_object.position_m, (n, 3)), atol=1e-9)
    assert (rotation_angle(back.quat_wxyz, X_world_object.quat_wxyz) < 1e-7).all()


@given(st.integers(1, 5), seeds)
def test_each_grasp_may_have_its_own_object_pose(n: int, seed: int) -> None:
    grasps = make_grasps(n, seed)
    X_world_object = random_pose(np.random.default_rng(seed + 1), n)
    X_world_hand = grasps.hand_pose(X_world_object)
    back = X_world_hand @ grasps.X_hand_object
    np.testing.assert_allclose(back.position_m, X_world_object.position_m, atol=1e-9)
    for row in range(n):
        alone = grasps[row].hand_pose(Pose(X_world_object.position_m[row], X_world_object.quat_wxyz[row]))
        np.testing.assert_allclose(alone.position_m[0], X_world_hand.position_m[row], atol=1e-9)


@given(seeds)
def test_the_relative_pose_is_the_same_wherever_the_object_stands(seed: int) -> None:
    grasps, rng = make_grasps(3, seed), np.random.default_rng(seed + 1)
    for X_world_object in (random_pose(rng), random_pose(rng)):
        relative = grasps.hand_pose(X_world_object).inverse() @ X_world_object
        np.testing.assert_allclose(relative.position_m, grasps.X_hand_object.position_m, atol=1e-9)
        assert (rotation_angle(relative.quat_wxyz, grasps.X_hand_object.quat_wxyz) < 1e-7).all()


def test_an_object_at_the_hand_origin_puts_the_hand_at_the_object() -> None:
    columns = make_grasps(2).columns() | {"position_m": np.zeros((2, 3)), "quat_wxyz": np.tile([1.0, 0, 0, 0], (2, 1))}
    X_world_object = Pose.of([0.1, 0.2, 0.3], canonical_quat([1.0, 2.0, 3.0, 4.0]))
    X_world_hand = Grasps.from_columns(JOINTS, columns).hand_pose(X_world_object)
    np.testing.assert_allclose(X_world_hand.position_m, np.tile(X_world_object.position_m, (2, 1)))


# -- joints


def test_angles_are_given_by_joint_name() -> None:
    grasps = make_grasps(4)
    by_name = grasps.posture_by_name()
    assert tuple(by_name) == JOINTS
    np.testing.assert_array_equal(np.stack([by_name[joint] for joint in JOINTS], axis=-1), grasps.posture)


# -- what is refused


@pytest.mark.parametrize("name", sorted(COLUMNS - {"grasp_type"}))
def test_a_column_of_another_length_is_refused_by_name(name: str) -> None:
    columns = make_grasps(3).columns()
    with pytest.raises(InputError, match=rf"column {name} has shape \(2,"):
        Grasps.from_columns(JOINTS, columns | {name: columns[name][:2]})


@pytest.mark.parametrize(("name", "width"), [("posture", 3), ("pregrasp", 3), ("position_m", 3), ("quat_wxyz", 4)])
def test_a_column_of_another_width_is_refused_by_name(name: str, width: int) -> None:
    columns = make_grasps(3).columns()
    for wrong in (columns[name][:, 1:], columns[name][:, 0]):
        with pytest.raises(InputError, match=rf"column {name} has shape .*, expected \(3, {width}\)"):
            Grasps.from_columns(JOINTS, columns | {name: wrong})


@pytest.mark.parametrize("name", ["side_m", "probability", "grasp_size_m"])
def test_a_scalar_column_that_is_a_table_is_refused(name: str) -> None:
    columns = make_grasps(3).columns()
    with pytest.raises(InputError, match=rf"column {name} has shape \(3, 1\), expected \(3,\)"):
        Grasps.from_columns(JOINTS, columns | {name: columns[name][:, None]})


def test_a_single_pose_cannot_stand_for_three_grasps() -> None:
    columns = make_grasps(3).columns()
    with pytest.raises(InputError, match="column position_m"):
        Grasps.from_columns(JOINTS, columns | {"position_m": np.zeros(3), "quat_wxyz": np.array([1.0, 0, 0, 0])})


def test_joints_must_fit_the_posture() -> None:
    with pytest.raises(InputError, match=r"expected \(3, 2\)"):
        Grasps.from_columns(JOINTS[:2], make_grasps(3).columns())


def test_batches_of_other_joints_cannot_be_joined() -> None:
    with pytest.raises(InputError, match="the same joints"):
        Grasps.concatenate([make_grasps(1), make_grasps(1, joint_names=JOINTS[::-1])])


def test_joining_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="at least one batch"):
        Grasps.concatenate([])
