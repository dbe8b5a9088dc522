"""`Grasps`: selecting, joining and rebuilding batches, where the hand goes, what to command, symmetric copies."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import CATALOGUE, GraspObject, as_object
from graspcascade.core.poses import Pose, canonical_quat, rotation_angle
from graspcascade.core.tasks import Task, Tasks, draw_tasks
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.hands import Hand, read_spec

JOINTS = ("THJ5", "THJ4", "FFJ3")
COLUMNS = {"posture", "pregrasp", "grasp_size_m", "object_size_m", "probability", "position_m", "quat_wxyz"}
CELLS = [(obj, kind) for obj in CATALOGUE.values() for kind in GRASP_TYPES.values()]

seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(0, 6)


def random_pose(rng: np.random.Generator, *shape: int) -> Pose:
    return Pose.of(rng.normal(size=(*shape, 3)), canonical_quat(rng.normal(size=(*shape, 4))))


def make_grasps(n: int, seed: int = 0, joint_names: tuple[str, ...] = JOINTS, tasks: Tasks | None = None) -> Grasps:
    rng = np.random.default_rng(seed)
    some = draw_tasks(CELLS, 1, 0.065, rng)[rng.integers(len(CELLS), size=n)] if tasks is None else tasks
    return Grasps(
        hand="a_hand",
        joint_names=joint_names,
        tasks=some,
        posture=rng.uniform(0, 1.5, (n, len(joint_names))),
        pregrasp=rng.uniform(0, 0.5, (n, len(joint_names))),
        X_hand_object=random_pose(rng, n),
        grasp_size_m=rng.uniform(0.01, 0.06, n),
        object_size_m=np.full(n, np.nan),
        probability=rng.uniform(0, 1, n),
    )


def rebuilt(grasps: Grasps, **columns: np.ndarray) -> Grasps:
    """Rebuild grasps with other columns."""
    return Grasps.from_columns(grasps.hand, grasps.joint_names, grasps.tasks, grasps.columns() | columns)


def assert_same_grasps(a: Grasps, b: Grasps) -> None:
    assert (a.hand, a.joint_names) == (b.hand, b.joint_names)
    assert a.tasks.same_as(b.tasks)
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
    assert_same_grasps(Grasps.from_columns("a_hand", list(JOINTS), grasps.tasks, columns), grasps)


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
    at_origin = rebuilt(make_grasps(2), position_m=np.zeros((2, 3)), quat_wxyz=np.tile([1.0, 0, 0, 0], (2, 1)))
    X_world_object = Pose.of([0.1, 0.2, 0.3], canonical_quat([1.0, 2.0, 3.0, 4.0]))
    X_world_hand = at_origin.hand_pose(X_world_object)
    np.testing.assert_allclose(X_world_hand.position_m, np.tile(X_world_object.position_m, (2, 1)))


# -- joints


def test_angles_are_given_by_joint_name() -> None:
    grasps = make_grasps(4)
    by_name = grasps.posture_by_name()
    assert tuple(by_name) == JOINTS
    np.testing.assert_array_equal(np.stack([by_name[joint] for joint in JOINTS], axis=-1), grasps.posture)


# -- what a batch says of itself


def test_names_sides_and_widths_are_those_of_the_tasks() -> None:
    tasks = Tasks.of([Task.of("tripod", "box:32x41x60mm", "y"), Task.of("tip_pinch", "sphere_small", "x")])
    grasps = make_grasps(2, tasks=tasks)
    assert grasps.grasp_type.tolist() == ["tripod", "tip_pinch"]
    assert grasps.object_name.tolist() == ["box:32x41x60mm", "sphere_small"]
    assert grasps.side_axis.tolist() == ["y", "x"]
    assert grasps.side_m.tolist() == [0.041, 0.03]


def test_a_batch_is_worded_in_one_short_line() -> None:
    one = make_grasps(3, tasks=Tasks.repeat(Task.of("tripod", "box_medium", "x"), 3))
    assert repr(one) == "<Grasps: 3 tripod of box_medium, 3 joints of a_hand>"
    mixed = make_grasps(54, tasks=draw_tasks(CELLS, 1, 0.065, np.random.default_rng(0)))
    assert repr(mixed) == "<Grasps: 54 6 types of 9 objects, 3 joints of a_hand>"
    assert repr(mixed[:0]) == "<Grasps: 0, 3 joints of a_hand>"
    assert len(repr(make_grasps(0))) < 100


# -- what to command


def test_commands_are_the_targets_of_the_hands_actuators_within_their_ranges(hand: Hand, drawn: Grasps) -> None:
    controls = drawn.controls(hand)
    model = read_spec(hand).compile()
    names = [model.actuator(number).name for number in range(model.nu)]
    assert set(controls) == set(names)
    for number, name in enumerate(names):
        assert controls[name].shape == (len(drawn),)
        low, high = model.actuator_ctrlrange[number]
        assert ((controls[name] >= low) & (controls[name] <= high)).all(), name
    angles = drawn.posture_by_name()
    np.testing.assert_allclose(controls["FFJ0"], angles["FFJ2"] + angles["FFJ1"], atol=1e-12)
    np.testing.assert_allclose(controls["THJ4"], angles["THJ4"], atol=1e-12)
    assert not controls["WRJ1"].any()
    assert not controls["WRJ2"].any()


def test_commands_beyond_an_actuators_range_end_at_its_limit(hand: Hand, drawn: Grasps) -> None:
    far = rebuilt(drawn, posture=np.full_like(drawn.posture, 4.0)).controls(hand)
    assert far["FFJ0"].tolist() == pytest.approx([np.pi] * len(drawn))
    assert far["FFJ3"].tolist() == pytest.approx([np.pi / 2] * len(drawn))


def test_the_open_hand_is_commanded_on_request_and_joints_are_matched_by_name(hand: Hand, drawn: Grasps) -> None:
    opened = drawn.controls(hand, opened=True)
    assert opened["THJ4"].tolist() == pytest.approx([hand.pregrasp_rad["THJ4"]] * len(drawn))
    assert not opened["FFJ0"].any()
    turned = Grasps.from_columns(
        drawn.hand,
        drawn.joint_names[::-1],
        drawn.tasks,
        drawn.columns() | {"posture": drawn.posture[:, ::-1], "pregrasp": drawn.pregrasp[:, ::-1]},
    )
    for name, targets in turned.controls(hand).items():
        np.testing.assert_array_equal(targets, drawn.controls(hand)[name])


def test_a_hand_with_more_joints_than_the_grasps_cannot_be_commanded(hand: Hand) -> None:
    with pytest.raises(InputError, match="the grasps lack joints of shadow_hand_right: FFJ4, "):
        make_grasps(2).controls(hand)


# -- the same grasp from another side


def surface(obj: GraspObject, n: int = 40) -> np.ndarray:
    """Spread points over a shape's surface, in its body frame."""
    direction = np.random.default_rng(1).normal(size=(n, 3))
    half = np.array(obj.extents_m) / 2
    if obj.shape.kind == "sphere":
        return direction / np.linalg.norm(direction, axis=1, keepdims=True) * half
    if obj.shape.kind == "box":
        return direction / np.abs(direction).max(axis=1, keepdims=True) * half
    radius = np.maximum(np.hypot(direction[:, 0], direction[:, 1]), np.abs(direction[:, 2]))
    return direction / radius[:, None] * half


def depth(obj: GraspObject, points: np.ndarray) -> np.ndarray:
    """Measure how far body-frame points are from the surface, in units of the shape's half extents."""
    unit = np.abs(points / (np.array(obj.extents_m) / 2))
    if obj.shape.kind == "sphere":
        return np.abs(np.linalg.norm(unit, axis=-1) - 1)
    if obj.shape.kind == "box":
        return np.abs(unit.max(axis=-1) - 1)
    return np.abs(np.maximum(np.hypot(unit[..., 0], unit[..., 1]), unit[..., 2]) - 1)


@pytest.mark.parametrize("spelled", ["box:32x41x60mm", "cylinder:27x80mm", "sphere:40mm"])
def test_symmetric_copies_place_the_hand_elsewhere_and_the_objects_surface_where_it_was(spelled: str) -> None:
    obj = as_object(spelled)
    one = make_grasps(1, tasks=Tasks.repeat(Task.of("tripod", obj, "x"), 1))
    copies = one.symmetric_copies(turns=6)
    assert len(copies) == {"box": 4, "cylinder": 12, "sphere": 24}[obj.shape.kind]
    assert rotation_angle(copies.X_hand_object.quat_wxyz[0], one.X_hand_object.quat_wxyz[0]) < 1e-9
    # In the hand frame the surface is the same set of points; each copy's points lie on the original's surface.
    points = Pose(one.X_hand_object.position_m, copies.X_hand_object.quat_wxyz[:, None, :]).apply(surface(obj))
    np.testing.assert_allclose(depth(obj, one.X_hand_object.inverse().apply(points)), 0, atol=1e-9)
    # For an object that stands in the world, they are different approaches of the hand.
    hands = copies.hand_pose(Pose.of([0.4, 0.0, 0.1], [1, 0, 0, 0]))
    apart = rotation_angle(hands.quat_wxyz[:, None, :], hands.quat_wxyz[None, :, :]) + np.eye(len(copies))
    assert apart.min() > 0.1
    np.testing.assert_array_equal(copies.posture, np.repeat(one.posture, len(copies), axis=0))


def test_copies_of_mixed_shapes_follow_their_originals_in_order() -> None:
    names = ["sphere_small", "box_small", "sphere_large", "box_small"]
    grasps = make_grasps(4, tasks=Tasks.of(map(Task.of, ["tripod"] * 4, names, ["x"] * 4)))
    copies = grasps.symmetric_copies()
    assert len(copies) == 24 + 4 + 24 + 4
    order = np.repeat(np.arange(4), [24, 4, 24, 4])
    np.testing.assert_array_equal(copies.probability, grasps.probability[order])
    assert copies.object_name.tolist() == [names[row] for row in order]
    for row, first in enumerate([0, 24, 28, 52]):
        np.testing.assert_allclose(
            copies.X_hand_object.quat_wxyz[first], grasps.X_hand_object.quat_wxyz[row], atol=1e-12
        )
    assert len(make_grasps(0).symmetric_copies()) == 0


# -- what is refused


@pytest.mark.parametrize("name", sorted(COLUMNS))
def test_a_column_of_another_length_is_refused_by_name(name: str) -> None:
    grasps = make_grasps(3)
    with pytest.raises(InputError, match=rf"column {name} has shape \(2,"):
        rebuilt(grasps, **{name: grasps.columns()[name][:2]})


@pytest.mark.parametrize(("name", "width"), [("posture", 3), ("pregrasp", 3), ("position_m", 3), ("quat_wxyz", 4)])
def test_a_column_of_another_width_is_refused_by_name(name: str, width: int) -> None:
    grasps = make_grasps(3)
    column = grasps.columns()[name]
    for wrong in (column[:, 1:], column[:, 0]):
        with pytest.raises(InputError, match=rf"column {name} has shape .*, expected \(3, {width}\)"):
            rebuilt(grasps, **{name: wrong})


@pytest.mark.parametrize("name", ["object_size_m", "probability", "grasp_size_m"])
def test_a_scalar_column_that_is_a_table_is_refused(name: str) -> None:
    grasps = make_grasps(3)
    with pytest.raises(InputError, match=rf"column {name} has shape \(3, 1\), expected \(3,\)"):
        rebuilt(grasps, **{name: grasps.columns()[name][:, None]})


def test_columns_may_be_lists_of_numbers_and_nothing_else() -> None:
    grasps = make_grasps(3)
    assert_same_grasps(rebuilt(grasps, **{name: column.tolist() for name, column in grasps.columns().items()}), grasps)
    with pytest.raises(InputError, match="column posture must be numbers: could not convert"):
        rebuilt(grasps, posture=np.full(grasps.posture.shape, "bent"))


@pytest.mark.parametrize(("angle", "says"), [(70.0, "this looks like degrees"), (np.nan, "posture is not finite")])
def test_angles_that_are_no_radians_are_not_commanded(hand: Hand, drawn: Grasps, angle: float, says: str) -> None:
    with pytest.raises(InputError, match=f"grasp 0: .*{says}"):
        rebuilt(drawn, posture=np.full_like(drawn.posture, angle)).controls(hand)


def test_a_single_pose_cannot_stand_for_three_grasps() -> None:
    with pytest.raises(InputError, match="column position_m"):
        rebuilt(make_grasps(3), position_m=np.zeros(3), quat_wxyz=np.array([1.0, 0, 0, 0]))


def test_joints_must_fit_the_posture_and_tasks_the_rows() -> None:
    grasps = make_grasps(3)
    with pytest.raises(InputError, match=r"expected \(3, 2\)"):
        Grasps.from_columns("a_hand", JOINTS[:2], grasps.tasks, grasps.columns())
    with pytest.raises(InputError, match=r"column posture has shape \(3, 3\), expected \(2, 3\)"):
        Grasps.from_columns("a_hand", JOINTS, grasps.tasks[:2], grasps.columns())


def test_batches_of_other_joints_or_hands_cannot_be_joined() -> None:
    other_hand = Grasps.from_columns("b", JOINTS, make_grasps(1).tasks, make_grasps(1).columns())
    for other in (make_grasps(1, joint_names=JOINTS[::-1]), other_hand):
        with pytest.raises(InputError, match="the same hand and joints"):
            Grasps.concatenate([make_grasps(1), other])


def test_joining_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="at least one batch"):
        Grasps.concatenate([])
