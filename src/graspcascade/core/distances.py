"""Signed distances from points to primitives: what a hand sees of an object, whatever its shape."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .objects import Shape

Array = NDArray[Any]


@dataclass(frozen=True)
class Distances:
    """Signed distances ``(n, m)``, metres, negative inside, and unit gradients ``(n, m, 3)``, away from the object."""

    distance_m: Array
    gradient: Array


def signed_distances(shapes: Sequence[Shape], shape_of_row: NDArray[np.intp], points: Array) -> Distances:
    """Measure points against the shape of their row, in its body frame.

    Where a gradient is not unique (centres, edges seen from inside) it is one of the possible ones.

    Args:
        shapes: boxes, cylinders and spheres.
        shape_of_row: ``(n,)`` which shape each row is measured against.
        points: ``(n, m, 3)`` metres; its type of real number is that of the result.

    Examples:
        >>> from graspcascade.core.objects import Sphere
        >>> measured = signed_distances([Sphere(0.04)], np.array([0]), np.array([[[0.0, 0.0, 0.05]]]))
        >>> measured.distance_m.round(3).tolist(), measured.gradient.tolist()
        ([[0.03]], [[[0.0, 0.0, 1.0]]])
    """
    distance, gradient = np.empty(points.shape[:2], points.dtype), np.empty(points.shape, points.dtype)
    halves = np.array([shape.extents_m for shape in shapes], dtype=points.dtype).reshape(-1, 3) / 2
    kinds = np.array([shape.kind for shape in shapes])[shape_of_row]
    half = halves[shape_of_row][:, None]
    for kind in np.unique(kinds):
        rows = kinds == kind
        if rows.all():
            distance, gradient = _MEASURES[str(kind)](half, points)
        else:
            distance[rows], gradient[rows] = _MEASURES[str(kind)](half[rows], points[rows])
    return Distances(distance, gradient)


def _from_box(half: Array, points: Array) -> tuple[Array, Array]:
    """Measure from half extents ``(n, 1, k)`` along k axes to points ``(n, m, k)``."""
    beyond = np.abs(points) - half
    outside = np.maximum(beyond, 0)
    distance = np.sqrt(np.einsum("nmi,nmi->nm", outside, outside))
    is_inside = distance == 0
    nearest = beyond.argmax(axis=-1)
    towards = np.eye(points.shape[-1], dtype=points.dtype)[nearest]
    gradient = np.where(is_inside[..., None], towards, outside / np.where(is_inside, 1, distance)[..., None])
    return np.where(is_inside, beyond.max(axis=-1), distance), np.copysign(gradient, points)


def _from_cylinder(half: Array, points: Array) -> tuple[Array, Array]:
    # A cylinder is a rectangle in the plane of its axis and the point.
    radius = np.hypot(points[..., 0], points[..., 1])
    flat = np.stack([radius, points[..., 2]], axis=-1)
    distance, gradient = _from_box(half[..., [0, 2]], flat)
    return distance, np.concatenate([gradient[..., :1] * _unit(points[..., :2], radius), gradient[..., 1:]], axis=-1)


def _from_sphere(half: Array, points: Array) -> tuple[Array, Array]:
    radius = np.sqrt(np.einsum("nmi,nmi->nm", points, points))
    return radius - half[..., 0], _unit(points, radius)


def _unit(vectors: Array, length: Array) -> Array:
    """Divide vectors by their lengths; one of no length becomes the first axis."""
    divided = vectors / np.where(length > 0, length, 1)[..., None]
    divided[..., 0] += length == 0
    return np.asarray(divided)


_MEASURES: Mapping[str, Callable[[Array, Array], tuple[Array, Array]]] = {
    "box": _from_box,
    "cylinder": _from_cylinder,
    "sphere": _from_sphere,
}
