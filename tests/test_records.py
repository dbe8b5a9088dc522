"""Tasks in files: objects carried by name, names and widths checked when they are read."""

import numpy as np
import pytest

from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.objects import CATALOGUE, Box, GraspObject, Sphere
from graspcascade.core.records import check_widths, objects_from_json, objects_to_json, read_tasks
from graspcascade.core.tasks import Task, Tasks

CUP = GraspObject("cup", Sphere(0.05), 300.0)
TASKS = Tasks.of(
    [Task.of("tripod", CUP, "x"), Task.of("tip_pinch", "box:32x41x60mm", "y"), Task.of("tripod", "cylinder_small", "z")]
)


def read(tasks: Tasks, objects: object, **columns: list) -> Tasks:
    given = {"grasp_types": tasks.grasp_type, "names": tasks.object_name, "axes": tasks.side_axis} | columns
    got = read_tasks(given["grasp_types"], given["names"], given["axes"], {"objects": objects})
    check_widths(got, given.get("side_m", tasks.side_m))
    return got


def test_tasks_survive_the_way_through_a_file() -> None:
    assert read(TASKS, objects_to_json(TASKS)).same_as(TASKS)
    assert len(read(TASKS[:0], {})) == 0


def test_widths_in_single_precision_are_accepted() -> None:
    assert read(TASKS, objects_to_json(TASKS), side_m=TASKS.side_m.astype(np.float32).astype(float)).same_as(TASKS)


def test_catalogue_names_and_sizes_need_no_description() -> None:
    assert read(TASKS[1:], {}).same_as(TASKS[1:])


def test_a_files_own_extents_win_over_a_catalogue_name() -> None:
    mine = GraspObject("box_small", Box(0.025, 0.03, 0.04))
    tasks = Tasks.of([Task.of("tripod", mine, "x")])
    again = read(tasks, objects_to_json(tasks))
    assert again.same_as(tasks)
    assert again.table[0].object != CATALOGUE["box_small"]


@pytest.mark.parametrize("off_m", [0.001, -0.001, np.nan, np.inf])
def test_a_width_that_is_not_its_objects_is_refused_with_its_row(off_m: float) -> None:
    side_m = TASKS.side_m + np.array([0.0, off_m, 0.0])
    with pytest.raises(
        FileFormatError, match=r"grasp 1: its side is .* m wide, but side y of box:32x41x60mm is 0.041 m"
    ):
        read(TASKS, objects_to_json(TASKS), side_m=side_m)


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ({"grasp_types": ["tripod", "tip pinsh", "tripod"]}, "grasp 1: unknown grasp type 'tip pinsh'"),
        ({"names": ["cup", "box:32x41x60mm", "cylinder"]}, "grasp 2: unknown object 'cylinder'"),
        ({"axes": ["x", "y", "w"]}, "grasp 2: unknown side axis 'w'"),
    ],
)
def test_an_unknown_name_is_refused_with_its_row(columns: dict, says: str) -> None:
    with pytest.raises(FileFormatError) as caught:
        read(TASKS, objects_to_json(TASKS), **columns)
    assert str(caught.value).startswith(says)


@pytest.mark.parametrize(
    ("objects", "says"),
    [
        ([], "objects is not a mapping"),
        (None, "objects is not a mapping"),
        ({"cup": "round"}, "object 'cup' is not described by shape and extents"),
        ({"cup": {"shape": "cup", "extents_m": [0.05] * 3}}, "unknown shape 'cup'"),
        ({"cup": {"shape": "sphere", "extents_m": [0.05, "wide", 0.05]}}, "three extents in metres"),
        ({"cup": {"shape": "sphere", "extents_m": [5.0] * 3}}, "extents are 1 mm to 1 m"),
        ({"c" * 100_000: "round"}, "is not described"),
    ],
)
def test_objects_that_are_no_objects_are_refused(objects: object, says: str) -> None:
    with pytest.raises(FileFormatError, match=says) as caught:
        objects_from_json(objects)
    assert len(str(caught.value)) < 300


def test_two_objects_of_one_name_cannot_be_written() -> None:
    other = GraspObject("cup", Sphere(0.04))
    with pytest.raises(InputError, match="two different objects are named 'cup'"):
        objects_to_json(Tasks.of([Task.of("tripod", CUP, "x"), Task.of("tripod", other, "x")]))
