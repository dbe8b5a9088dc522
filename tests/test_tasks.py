"""`Task` and `Tasks`: what is to be grasped, row by row, and how sides are drawn."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspcascade.core.errors import InputError
from graspcascade.core.families import FAMILIES
from graspcascade.core.objects import CATALOGUE, Box, GraspObject, Site, Sphere, as_object
from graspcascade.core.tasks import Task, Tasks, draw_tasks
from graspcascade.core.taxonomy import GRASP_TYPES, as_type

CELLS = [(obj, kind) for obj in CATALOGUE.values() for kind in GRASP_TYPES.values()]
TASKS = [
    Task.of("tripod", "box:32x41x60mm", "x"),
    Task.of("tripod", "box:32x41x60mm", "y"),
    Task.of("tip_pinch", "sphere_small", "z"),
    Task.of("palmar_pinch", "cylinder_small", "z"),
]

rows = st.lists(st.integers(0, len(TASKS) - 1), max_size=12)


def batch(places: list[int]) -> Tasks:
    return Tasks.of(TASKS[place] for place in places)


def test_a_task_is_made_of_a_type_an_object_and_a_side() -> None:
    task = Task.of("Writing Tripod", "cylinder:27x80mm", "y", reach_m=0.065)
    assert task.grasp_type is GRASP_TYPES["writing_tripod"]
    assert task.object == as_object("cylinder:27x80mm")
    assert task.site == Site((1.0, 0.0, 0.0), 0.027)
    assert task.cell == ("cylinder:27x80mm", "writing_tripod")


@pytest.mark.parametrize(
    ("size", "axis", "length"),
    [
        ("box:32x41x60mm", "x", 0.06),
        ("box:32x41x60mm", "z", 0.041),
        ("cylinder:27x80mm", "x", 0.08),
        ("cylinder:27x80mm", "z", 0.027),
        ("cylinder:50x20mm", "y", 0.05),
        ("sphere:40mm", "y", 0.04),
    ],
)
def test_an_object_is_as_long_as_its_longest_extent_across_the_opposition_axis(
    size: str, axis: str, length: float
) -> None:
    assert Task.of("tripod", size, axis).length_m == length


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("tripodd", "box_small", "x"), "unknown grasp type 'tripodd'. Did you mean 'tripod'"),
        (("tripod", "box_smal", "x"), "unknown object 'box_smal'. Did you mean 'box_small'"),
        (("tripod", "box_small", "w"), "unknown side axis 'w'"),
        (("tripod", "box_large", "z", 0.065), "beyond the hand's reach of 6.5 cm"),
    ],
)
def test_a_task_that_cannot_be_is_refused_in_one_line(arguments: tuple, says: str) -> None:
    with pytest.raises(InputError) as caught:
        Task.of(*arguments)
    assert says in str(caught.value)


@given(rows)
def test_rows_are_the_tasks_in_order_and_equal_ones_are_stored_once(places: list[int]) -> None:
    tasks = batch(places)
    assert list(tasks) == [TASKS[place] for place in places]
    assert len(tasks) == len(places)
    assert len(tasks.table) == len(set(places))
    assert tasks.grasp_type.tolist() == [TASKS[place].grasp_type.name for place in places]
    assert tasks.object_name.tolist() == [TASKS[place].object.name for place in places]
    assert tasks.side_axis.tolist() == [TASKS[place].site.name for place in places]
    assert tasks.side_m.tolist() == [TASKS[place].site.width_m for place in places]
    assert set(tasks.objects) == {TASKS[place].object.name for place in places}


@given(rows, st.data())
def test_slices_indices_and_masks_select_rows(places: list[int], data: st.DataObject) -> None:
    tasks = batch(places)
    start, stop = sorted(data.draw(st.tuples(st.integers(0, len(places)), st.integers(0, len(places)))))
    mask = np.zeros(len(places), dtype=bool)
    mask[start:stop] = True
    for selected in (tasks[start:stop], tasks[np.arange(start, stop)], tasks[mask]):
        assert selected.same_as(batch(places[start:stop]))
        assert set(selected.distinct) == {TASKS[place] for place in places[start:stop]}


@given(st.lists(rows, min_size=1, max_size=4))
def test_joined_rows_follow_each_other(parts: list[list[int]]) -> None:
    joined = Tasks.concatenate([batch(part) for part in parts])
    assert joined.same_as(batch([place for part in parts for place in part]))


@given(rows)
def test_groups_part_the_rows_by_a_key(places: list[int]) -> None:
    tasks, seen = batch(places), np.zeros(len(places), dtype=int)
    keys = []
    for kind, chosen in tasks.groups(lambda task: task.grasp_type):
        assert chosen.any()
        assert set(tasks.grasp_type[chosen]) == {kind.name}
        seen += chosen
        keys.append(kind)
    assert (seen == 1).all()
    assert len(keys) == len(set(keys))


def test_groups_that_no_row_belongs_to_are_left_out() -> None:
    assert [key for key, _ in batch([0, 1, 2])[:2].groups(lambda task: task.object.name)] == ["box:32x41x60mm"]


def test_a_column_is_a_value_of_each_rows_task() -> None:
    tasks = batch([2, 0, 1, 0])
    np.testing.assert_array_equal(
        tasks.column(lambda task: task.site.axis, np.float64), [[1, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]]
    )
    assert tasks.column(lambda task: task.object.mass_kg).shape == (4,)


def test_batches_with_other_rows_are_not_the_same() -> None:
    assert not batch([0, 1]).same_as(batch([1, 0]))
    assert not batch([0, 1]).same_as(batch([0]))
    assert Tasks.repeat(TASKS[0], 3).same_as(batch([0, 0, 0]))


def test_two_objects_of_one_name_are_refused_where_names_must_tell_them_apart() -> None:
    kind = as_type("tripod")
    cup, other = GraspObject("cup", Sphere(0.04)), GraspObject("cup", Box(0.04, 0.04, 0.04))
    tasks = Tasks.of([Task.of(kind, cup, "x"), Task.of(kind, other, "x")])
    with pytest.raises(InputError, match="two different objects are named 'cup'"):
        _ = tasks.objects
    assert tasks[:1].objects == {"cup": cup}


# -- drawing sides


def test_each_graspable_side_is_drawn_about_equally_often() -> None:
    tasks = draw_tasks(CELLS, 300, 0.065, np.random.default_rng(0))
    assert len(tasks) == 300 * len(CELLS)
    for number, (obj, kind) in enumerate(CELLS):
        part = tasks[300 * number : 300 * (number + 1)]
        assert {task.cell for task in part.distinct} == {(obj.name, kind.name)}
        sites = obj.sites(0.065)
        counts = [int((part.side_axis == axis).sum()) for axis in sites]
        assert sum(counts) == 300
        # Within four standard deviations of an equal share.
        share = 300 / len(sites)
        assert max(abs(count - share) for count in counts) <= 4 * np.sqrt(share)


def test_the_same_seed_draws_the_same_sides_and_another_seed_others() -> None:
    first, again, other = (draw_tasks(CELLS, 5, 0.065, np.random.default_rng(seed)) for seed in (3, 3, 4))
    assert first.same_as(again)
    assert not first.same_as(other)


def test_a_side_depends_on_the_reach_of_the_hand() -> None:
    cells = [(CATALOGUE["box_medium"], as_type("tripod"))]
    drawn = draw_tasks(cells, 50, 0.05, np.random.default_rng(0))
    assert set(drawn.side_axis) == {"x", "y"}
    with pytest.raises(InputError, match="no side of box_medium is within the hand's reach of 2 cm"):
        draw_tasks(cells, 1, 0.02, np.random.default_rng(0))


def test_each_row_of_a_family_has_an_object_of_its_own_and_a_side_drawn_evenly_among_the_graspable() -> None:
    kind, n = as_type("tripod"), 3000
    tasks = draw_tasks([(FAMILIES["any:box"], kind)], n, 0.065, np.random.default_rng(0))
    assert len(tasks.objects) > 0.99 * n
    assert {task.grasp_type for task in tasks.distinct} == {kind}
    assert all(task.site in task.object.sites(0.065).values() for task in tasks)
    # Whether the first of the sides that can be held is drawn, by how many there are.
    for n_sides in (1, 2, 3):
        some = [task for task in tasks if len(task.object.sites(0.065)) == n_sides]
        first = np.mean([task.site == next(iter(task.object.sites(0.065).values())) for task in some])
        assert first == pytest.approx(1 / n_sides, abs=4 * 0.5 / np.sqrt(len(some)))


def test_objects_of_a_family_are_within_the_hands_reach() -> None:
    cells = [(family, as_type("tripod")) for family in FAMILIES.values()]
    tasks = draw_tasks(cells, 50, 0.03, np.random.default_rng(0))
    assert tasks.side_m.max() <= 0.03
    with pytest.raises(InputError, match="any:sphere has no size of which a side is within the reach of 1 cm"):
        draw_tasks([(FAMILIES["any:sphere"], as_type("tripod"))], 1, 0.01, np.random.default_rng(0))


def test_a_family_beside_objects_leaves_their_sides_as_they_are() -> None:
    cells = [(CATALOGUE[name], as_type("tripod")) for name in ("box_small", "box_medium", "box_large")]
    mixed = [cells[0], (FAMILIES["any:box"], as_type("tripod")), cells[2]]
    alone, beside = (draw_tasks(some, 20, 0.065, np.random.default_rng(0)) for some in (cells, mixed))
    for rows in (slice(0, 20), slice(40, 60)):
        assert alone[rows].same_as(beside[rows])
    assert len(beside[20:40].objects) == 20


def test_selected_rows_keep_only_tasks_of_their_own() -> None:
    tasks = draw_tasks([(FAMILIES["any:cylinder"], as_type("tripod"))], 50, 0.065, np.random.default_rng(0))
    some = tasks[[7, 3, 7]]
    assert len(some.table) == 2
    assert list(some) == [list(tasks)[row] for row in (7, 3, 7)]
    assert tasks[:0].table == ()


def test_no_cells_draw_no_tasks() -> None:
    assert len(draw_tasks([], 5, 0.065, np.random.default_rng(0))) == 0


@pytest.mark.parametrize(("n", "message"), [(-1, "n must not be negative, got -1"), (1.5, "n must be a whole number")])
def test_a_number_of_rows_is_a_whole_one(n: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Tasks.repeat(Task.of("tripod", "box_medium", "x"), n)  # type: ignore[arg-type]
