"""`Task`: which grasp type, of which object, at which site; `Tasks`: one for each row of a batch."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .errors import InputError, check_whole
from .families import ObjectFamily
from .objects import GraspObject, Site, as_object
from .taxonomy import GraspType, as_type, taxonomy_of

Key = TypeVar("Key", bound=Hashable)
_MOST_ROWS = 10**9


@dataclass(frozen=True)
class Task:
    """What is to be grasped, how, and at which site of the object.

    Examples:
        >>> task = Task.of("tripod", "box:32x41x60mm", "x")
        >>> task.grasp_type.feix_number, task.site.width_m
        (14, 0.032)
    """

    grasp_type: GraspType
    object: GraspObject
    site: Site

    @classmethod
    def of(cls, grasp_type: GraspType | str, obj: GraspObject | str, axis: str, reach_m: float = np.inf) -> Task:
        """Make a task from a type, an object or its spelling, and the body axis along which its side is held.

        Raises:
            InputError: an unknown name, or a side that is wider than the reach.
        """
        target = as_object(obj)
        return cls(as_type(grasp_type), target, target.site(axis, reach_m))

    @property
    def length_m(self) -> float:
        """Length of the object across the opposition axis: its longest extent along the other two body axes."""
        along = int(np.argmax(np.abs(self.site.axis)))
        return max(extent for place, extent in enumerate(self.object.extents_m) if place != along)

    @property
    def cell(self) -> tuple[str, str]:
        """Names of object and grasp type, by which rates are counted."""
        return self.object.name, self.grasp_type.name


def _names(value: Callable[[Task], str]) -> cached_property[NDArray[np.str_]]:
    return cached_property(lambda tasks: tasks.column(value, str))


@dataclass(frozen=True, eq=False)
class Tasks:
    """A batch of n tasks: a short table of distinct ones, and for each row its place ``(n,)`` in the table.

    Examples:
        >>> tasks = Tasks.of([Task.of("tripod", "sphere:40mm", "x")] * 2 + [Task.of("tip_pinch", "box_small", "y")])
        >>> len(tasks), len(tasks.table), tasks.side_m.tolist()
        (3, 2, [0.04, 0.04, 0.03])
    """

    table: tuple[Task, ...]
    row: NDArray[np.intp]

    @classmethod
    def of(cls, tasks: Iterable[Task]) -> Tasks:
        """Make a batch of tasks in their order."""
        places: dict[Task, int] = {}
        row = [places.setdefault(task, len(places)) for task in tasks]
        return cls(tuple(places), np.array(row, dtype=np.intp))

    @classmethod
    def repeat(cls, task: Task, n: int) -> Tasks:
        """Repeat one task n times."""
        check_whole("n", n, most=_MOST_ROWS)
        return cls((task,), np.zeros(n, dtype=np.intp))

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.row)

    def __getitem__(self, rows: Any) -> Tasks:
        """Select rows by slice, index array or mask."""
        row = self.row[rows]
        if len(self.table) <= len(row):
            return Tasks(self.table, row)
        # Of a long table, as of many objects, a few rows keep what is theirs.
        places, row = np.unique(row, return_inverse=True)
        return Tasks(tuple(self.table[place] for place in places.tolist()), row)

    def __iter__(self) -> Iterator[Task]:
        """Iterate over the tasks of the rows."""
        return (self.table[place] for place in self.row.tolist())

    def same_as(self, other: Tasks) -> bool:
        """Tell whether the rows hold the same tasks in the same order."""
        return len(self) == len(other) and all(a == b for a, b in zip(self, other, strict=True))

    @classmethod
    def concatenate(cls, parts: Sequence[Tasks]) -> Tasks:
        """Join batches."""
        table = cls.of(task for part in parts for task in part.table)
        starts = np.cumsum([0, *(len(part.table) for part in parts[:-1])])
        places = np.concatenate([part.row + start for part, start in zip(parts, starts, strict=True)])
        return cls(table.table, table.row[places])

    @cached_property
    def used(self) -> list[int]:
        """Places of the table that some row has, in order."""
        return np.flatnonzero(np.bincount(self.row, minlength=len(self.table))).tolist()

    @cached_property
    def distinct(self) -> tuple[Task, ...]:
        """Tasks of the table that some row asks for."""
        return tuple(self.table[place] for place in self.used)

    def column(self, value: Callable[[Task], Any], dtype: Any = None) -> NDArray[Any]:
        """Compute a value of each row's task, once for each task of the table; ``(n, ...)``."""
        values = np.array([value(task) for task in self.table], dtype=dtype)
        return np.asarray(values[self.row]) if self.table else values

    def groups(self, key: Callable[[Task], Key]) -> Iterator[tuple[Key, NDArray[np.bool_]]]:
        """Iterate over the distinct values of a key, each with the flags ``(n,)`` of the rows that have it."""
        numbers: dict[Key, int] = {}
        table = [numbers.setdefault(key(task), len(numbers)) for task in self.table]
        number = np.array(table, dtype=np.intp)[self.row]
        used = set(number.tolist())
        for value, place in numbers.items():
            if place in used:
                yield value, number == place

    grasp_type = _names(lambda task: task.grasp_type.name)
    """Names of the grasp types ``(n,)``."""
    object_name = _names(lambda task: task.object.name)
    """Names of the objects ``(n,)``."""
    side_axis = _names(lambda task: task.site.name)
    """Names of the sites ``(n,)``: the body axis of the side held."""

    @cached_property
    def side_m(self) -> NDArray[np.float64]:
        """Widths of the sites ``(n,)``, metres."""
        return self.column(lambda task: task.site.width_m, np.float64)

    @property
    def taxonomy(self) -> str:
        """Name of the taxonomy that the rows' types are of; types of several are an InputError."""
        return taxonomy_of(task.grasp_type for task in self.distinct)

    @property
    def objects(self) -> dict[str, GraspObject]:
        """Objects of the rows by name; two different ones of one name are an InputError."""
        named: dict[str, GraspObject] = {}
        for task in self.distinct:
            if named.setdefault(task.object.name, task.object) != task.object:
                raise InputError(f"two different objects are named {task.object.name!r}; name each object once")
        return named


def draw_tasks(
    cells: Sequence[tuple[GraspObject | ObjectFamily, GraspType]], n: int, reach_m: float, rng: np.random.Generator
) -> Tasks:
    """Make n tasks for each pair of object and type, the rows of a pair together, with sides drawn at random.

    Of a family, each row has an object of its own. Sides are drawn, one number a row, among those no wider than
    `reach_m`; an object without any is an InputError. Objects are drawn after all of these numbers.
    """
    check_whole("n", n, most=_MOST_ROWS)
    share = rng.uniform(size=n * len(cells)).reshape(len(cells), n)
    table: list[Task] = []
    rows = []
    for (obj, kind), shares in zip(cells, share, strict=True):
        if isinstance(obj, ObjectFamily):
            drawn = zip(obj.draw(n, rng, reach_m), shares.tolist(), strict=True)
            own = Tasks.of(_at_side(kind, each, number, reach_m) for each, number in drawn)
            rows.append(len(table) + own.row)
            table += own.table
            continue
        sites = list(obj.sites(reach_m).values())
        if not sites:
            raise InputError(f"no side of {obj.name} is within the hand's reach of {reach_m * 100:g} cm")
        rows.append(len(table) + (shares * len(sites)).astype(np.intp))
        table += [Task(kind, obj, site) for site in sites]
    return Tasks(tuple(table), np.concatenate(rows) if rows else np.zeros(0, dtype=np.intp))


def _at_side(kind: GraspType, obj: GraspObject, share: float, reach_m: float) -> Task:
    sites = list(obj.sites(reach_m).values())
    return Task(kind, obj, sites[int(share * len(sites))])
