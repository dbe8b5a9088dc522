"""Signed distances from points to primitives: what a hand sees of an object, whatever its shape."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .objects import Shape

Array = NDArray[Any]


@dataclass(frozen=True)
class Distances:
    """Signed distances ``(n, m)``, metres, negative inside, and unit gradients ``(n, m, 3)``, away from the object."""

    distance_m: Array
    gradient: Array | None
    """None where they were not asked for."""


def signed_distances(
    shapes: Sequence[Shape], shape_of_row: NDArray[np.intp], points: Array, *, gradients: bool = True
) -> Distances:
    """Measure points against the shape of their row, in its body frame.

    Where a gradient is not unique (centres, edges seen from inside) it is one of the possible ones.

    Args:
        shapes: boxes, cylinders and spheres.
        shape_of_row: ``(n,)`` which shape each row is measured against.
        points: ``(n, m, 3)`` metres; its type of real number is that of the result, and so is its order in memory. With
            n last in memory it is fastest.
        gradients: whether these are wanted; distances alone are cheaper.

    Examples:
        >>> from graspcascade.core.objects import Sphere
        >>> measured = signed_distances([Sphere(0.04)], np.array([0]), np.array([[[0.0, 0.0, 0.05]]]))
        >>> measured.distance_m.round(3).tolist(), measured.gradient.tolist()
        ([[0.03]], [[[0.0, 0.0, 1.0]]])
    """
    halves = np.array([shape.extents_m for shape in shapes], dtype=points.dtype).reshape(-1, 3) / 2
    kinds = np.array([shape.kind for shape in shapes])
    distance, gradient = np.empty_like(points[..., 0]), np.empty_like(points) if gradients else None
    for kind in dict.fromkeys(kinds.tolist()):
        rows: Any = slice(None) if (kinds == kind).all() else np.flatnonzero((kinds == kind)[shape_of_row])
        half, chosen = np.moveaxis(halves[shape_of_row[rows]][:, None], -1, 0), np.moveaxis(points[rows], -1, 0)
        distance[rows], slopes = _MEASURES[kind](list(half), list(chosen), gradients)
        if gradient is not None:
            for axis, slope in enumerate(slopes):
                gradient[rows, :, axis] = slope
    return Distances(distance, gradient)


_Measured = tuple[Array, list[Array]]
"""Distances ``(n, m)``, and their gradients' components, as many as axes, or none."""


def _from_box(half: list[Array], points: list[Array], gradients: bool) -> _Measured:
    """Measure from half extents ``(n, 1)`` along any number of axes to points, ``(n, m)`` along each."""
    beyond = [np.abs(point) - end for point, end in zip(points, half, strict=True)]
    deepest = reduce(np.maximum, beyond)
    outside = [np.maximum(each, 0, out=None if gradients else each) for each in beyond]
    distance = _length(outside)
    signed = distance + np.minimum(deepest, 0)
    if not gradients:
        return signed, []
    scale, is_inside = _inverse(distance), distance == 0
    for slope, each, point in zip(outside, beyond, points, strict=True):
        is_nearest = is_inside & (each == deepest)
        is_inside ^= is_nearest
        slope *= scale
        slope += is_nearest
        np.copysign(slope, point, out=slope)
    return signed, outside


def _from_cylinder(half: list[Array], points: list[Array], gradients: bool) -> _Measured:
    # A cylinder is a rectangle in the plane of its axis and the point.
    x, y, z = points
    radius = _length([x, y])
    signed, slopes = _from_box([half[0], half[2]], [radius, z], gradients)
    if not gradients:
        return signed, []
    outward, along = slopes
    return signed, [outward * part for part in _unit([x, y], radius)] + [along]


def _from_sphere(half: list[Array], points: list[Array], gradients: bool) -> _Measured:
    radius = _length(points)
    return radius - half[0], _unit(points, radius) if gradients else []


def _length(vectors: list[Array]) -> Array:
    first, *others = vectors
    squares = first * first
    for other in others:
        squares += other * other
    return np.asarray(np.sqrt(squares, out=squares))


def _unit(vectors: list[Array], length: Array) -> list[Array]:
    """Divide vectors by their lengths; one of no length becomes the first axis."""
    scale = _inverse(length)
    first, *others = (vector * scale for vector in vectors)
    first += length == 0
    return [first, *others]


def _inverse(length: Array) -> Array:
    """Divide one by lengths, zero counting as one."""
    # np.where takes ten times as long.
    return np.asarray(1 / (length + (length == 0)))


_MEASURES: Mapping[str, Callable[[list[Array], list[Array], bool], _Measured]] = {
    "box": _from_box,
    "cylinder": _from_cylinder,
    "sphere": _from_sphere,
}
