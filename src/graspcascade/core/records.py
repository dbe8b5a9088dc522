"""What files say of grasps: parts of arrays as plain columns; tasks as names, their objects described beside them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import FileFormatError, InputError, unknown
from .objects import GraspObject, as_object
from .poses import Pose
from .tasks import Task, Tasks
from .taxonomy import TAXONOMIES, GraspType, as_type

Columns = dict[str, NDArray[Any]]
"""Arrays ``(n,)`` by column name."""
_TOLERANCE_M = 5e-6
"""A stored width may differ from the object's own by so much: datasets keep single precision."""
_XYZ, _WXYZ = ("x_m", "y_m", "z_m"), ("qw", "qx", "qy", "qz")


def spread(prefix: str, names: tuple[str, ...], values: NDArray[Any]) -> Columns:
    """Spread the parts of values ``(n, len(names))`` as columns ``<prefix>_<name>``."""
    return {f"{prefix}_{name}": np.ascontiguousarray(values[:, i]) for i, name in enumerate(names)}


def spread_pose(prefix: str, pose: Pose) -> Columns:
    """Spread poses ``(n, 3)`` and ``(n, 4)`` as columns ``<prefix>_x_m`` to ``<prefix>_qz``, quaternions wxyz."""
    return spread(prefix, _XYZ, pose.position_m) | spread(prefix, _WXYZ, pose.quat_wxyz)


def gather(columns: Mapping[str, NDArray[Any]], prefix: str, names: tuple[str, ...]) -> NDArray[np.float64]:
    """Join columns ``<prefix>_<name>`` to ``(n, len(names))`` in double precision; a missing one is a KeyError."""
    return np.stack([np.asarray(columns[f"{prefix}_{name}"], dtype=np.float64) for name in names], axis=1)


def gather_pose(columns: Mapping[str, NDArray[Any]], prefix: str) -> Pose:
    """Join the columns of poses, quaternions as they are stored; a missing one is a KeyError."""
    return Pose(gather(columns, prefix, _XYZ), gather(columns, prefix, _WXYZ))


def objects_to_json(tasks: Tasks) -> dict[str, dict[str, Any]]:
    """Describe each object of the tasks by its name, as files carry it; names must differ (see `Tasks.objects`)."""
    return {name: obj.to_json() for name, obj in tasks.objects.items()}


def objects_from_json(data: object) -> dict[str, GraspObject]:
    """Read the objects that a file carries; a FileFormatError names one that is malformed."""
    if not isinstance(data, Mapping):
        raise FileFormatError("objects is not a mapping of objects by name")
    for name, about in data.items():
        if not isinstance(about, Mapping):
            raise FileFormatError(f"object {str(name)[:60]!r} is not described by shape and extents")
    try:
        return {str(name): GraspObject.from_json(str(name), about) for name, about in data.items()}
    except InputError as error:
        raise FileFormatError(str(error)) from error


def taxonomy_to_json(name: str) -> dict[str, str]:
    """Write the name of a taxonomy as files do, which leave out the paper's."""
    return {} if name == "paper" else {"taxonomy": name}


def types_from_json(data: Mapping[str, Any]) -> Mapping[str, GraspType]:
    """Look up the grasp types that a file's names are of; a FileFormatError says that it names no known taxonomy."""
    name = data.get("taxonomy", "paper")
    if not isinstance(name, str) or name not in TAXONOMIES:
        raise FileFormatError(str(unknown("taxonomy", name, TAXONOMIES)))
    return TAXONOMIES[name]


def read_tasks(grasp_types: ArrayLike, names: ArrayLike, axes: ArrayLike, about: Mapping[str, Any]) -> Tasks:
    """Make tasks of a file's columns ``(n,)``.

    Args:
        grasp_types: type names.
        names: names of objects that the file carries or of the catalogue, or sizes.
        axes: body axes of the sides held.
        about: what the file says of all rows: `objects` by name, and the `taxonomy` of the types.

    Raises:
        FileFormatError: a row names something unknown; rows count from 0.
    """
    own, types = objects_from_json(about.get("objects", {})), types_from_json(about)
    columns = (np.asarray(column, dtype=str).tolist() for column in (grasp_types, names, axes))
    made: dict[tuple[str, str, str], Task] = {}
    tasks = []
    for row, cell in enumerate(zip(*columns, strict=True)):
        if cell not in made:
            kind, name, axis = cell
            try:
                obj = own[name] if name in own else as_object(name)
                made[cell] = Task(as_type(kind, types), obj, obj.site(axis))
            except InputError as error:
                raise FileFormatError(f"grasp {row}: {error}") from error
        tasks.append(made[cell])
    return Tasks.of(tasks)


def check_widths(tasks: Tasks, side_m: NDArray[np.float64]) -> None:
    """Check that widths ``(n,)`` of a file, metres, are those of the tasks; a FileFormatError tells of the first."""
    for row in np.flatnonzero(~(np.abs(tasks.side_m - side_m) <= _TOLERANCE_M))[:1].tolist():
        (task,) = tasks[[row]].distinct
        site = f"side {task.site.name} of {task.object.name} is {task.site.width_m:g} m"
        raise FileFormatError(f"grasp {row}: its side is {side_m[row]:g} m wide, but {site}")
