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
        points: ``(n, m, 3)`` metres; its type of real number is that of the result.
        gradients: whether these are wanted; distances alone are cheaper.

    Examples:
        >>> from graspcascade.core.objects import Sphere
        >>> measured = signed_distances([Sphere(0.04)], np.array([0]), np.array([[[0.0, 0.0, 0.05]]]))
        >>> measured.distance_m.round(3).tolist(), measured.gradient.tolist()
        ([[0.03]], [[[0.0, 0.0, 1.0]]])
    """
    halves = np.array([shape.extents_m for shape in shapes], dtype=points.dtype).reshape(-1, 3) / 2
    kinds = np.array([shape.kind for shape in shapes])[shape_of_row]
    half, present = halves[shape_of_row][:, None], np.unique(kinds).tolist()
    if len(present) == 1:
        return _MEASURES[present[0]](half, points, gradients)
    distance, gradient = np.empty(points.shape[:2], points.dtype), np.empty(points.shape, points.dtype)
    for kind in present:
        rows = kinds == kind
        measured = _MEASURES[kind](half[rows], points[rows], gradients)
        distance[rows] = measured.distance_m
        if measured.gradient is not None:
            gradient[rows] = measured.gradient
    return Distances(distance, gradient if gradients else None)


def _from_box(half: Array, points: Array, gradients: bool) -> Distances:
    """Measure from half extents ``(n, 1, k)`` along k axes to points ``(n, m, k)``."""
    beyond = np.abs(points) - half
    outside = np.maximum(beyond, 0)
    distance = np.sqrt(np.einsum("nmi,nmi->nm", outside, outside))
    is_inside = distance == 0
    signed = np.where(is_inside, beyond.max(axis=-1), distance)
    if not gradients:
        return Distances(signed, None)
    towards = np.eye(points.shape[-1], dtype=points.dtype)[beyond.argmax(axis=-1)]
    gradient = np.where(is_inside[..., None], towards, outside / np.where(is_inside, 1, distance)[..., None])
    return Distances(signed, np.copysign(gradient, points))


def _from_cylinder(half: Array, points: Array, gradients: bool) -> Distances:
    # A cylinder is a rectangle in the plane of its axis and the point.
    radius = np.hypot(points[..., 0], points[..., 1])
    flat = _from_box(half[..., [0, 2]], np.stack([radius, points[..., 2]], axis=-1), gradients)
    if flat.gradient is None:
        return flat
    outward = flat.gradient[..., :1] * _unit(points[..., :2], radius)
    return Distances(flat.distance_m, np.concatenate([outward, flat.gradient[..., 1:]], axis=-1))


def _from_sphere(half: Array, points: Array, gradients: bool) -> Distances:
    radius = np.sqrt(np.einsum("nmi,nmi->nm", points, points))
    return Distances(radius - half[..., 0], _unit(points, radius) if gradients else None)


def _unit(vectors: Array, length: Array) -> Array:
    """Divide vectors by their lengths; one of no length becomes the first axis."""
    divided = vectors / np.where(length > 0, length, 1)[..., None]
    divided[..., 0] += length == 0
    return np.asarray(divided)


_MEASURES: Mapping[str, Callable[[Array, Array, bool], Distances]] = {
    "box": _from_box,
    "cylinder": _from_cylinder,
    "sphere": _from_sphere,
}
