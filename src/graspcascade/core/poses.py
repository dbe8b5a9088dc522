"""Rigid transforms: positions ``(..., 3)`` in metres and unit quaternions ``(..., 4)`` in wxyz order, w >= 0."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def canonical_quat(quat_wxyz: ArrayLike) -> Array:
    """Normalise quaternions ``(..., 4)`` and choose the sign with w >= 0 (first non-zero component positive)."""
    quat = np.asarray(quat_wxyz, dtype=np.float64)
    w, x, y, z = _parts(quat)
    quat = quat / np.sqrt(w * w + x * x + y * y + z * z)[..., None]
    first = quat[..., :1]
    if (np.abs(first) <= 1e-12).any():
        first = np.take_along_axis(quat, np.argmax(np.abs(quat) > 1e-12, axis=-1)[..., None], axis=-1)
    quat = np.asarray(np.where(first < 0, -quat, quat), dtype=np.float64)
    # At a half-turn w is rounding noise and another component decides the sign: drop the noise below zero.
    quat[..., 0] = np.maximum(quat[..., 0], 0.0)
    return quat


def as_rotation(quat_wxyz: ArrayLike) -> Rotation:
    """Make a scipy rotation from ``(n, 4)`` or ``(4,)`` wxyz quaternions."""
    # Sampling needs no scipy and should not wait for it to load.
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.asarray(quat_wxyz, dtype=np.float64), scalar_first=True)


def as_quat(rotation: Rotation) -> Array:
    """Read the wxyz quaternions of a scipy rotation, w >= 0."""
    return canonical_quat(rotation.as_quat(scalar_first=True))


def quat_multiply(a: ArrayLike, b: ArrayLike) -> Array:
    """Multiply wxyz quaternions with broadcasting: rotate by `b`, then by `a`."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    aw, ax, ay, az = _parts(a)
    bw, bx, by, bz = _parts(b)
    w = aw * bw - ax * bx - ay * by - az * bz
    x = aw * bx + ax * bw + ay * bz - az * by
    y = aw * by - ax * bz + ay * bw + az * bx
    z = aw * bz + ax * by - ay * bx + az * bw
    return np.stack([w, x, y, z], axis=-1)


def _parts(vectors: Array) -> list[Array]:
    """List the components of vectors ``(..., k)``; `np.moveaxis` takes as long as an operation on 1,000 of them."""
    return [vectors[..., part] for part in range(vectors.shape[-1])]


def quat_conjugate(quat_wxyz: ArrayLike) -> Array:
    """Invert unit quaternions ``(..., 4)``."""
    return np.asarray(np.asarray(quat_wxyz, dtype=np.float64) * np.array([1.0, -1.0, -1.0, -1.0]))


def quat_to_matrix(quat_wxyz: ArrayLike) -> Array:
    """Compute the rotation matrices ``(..., 3, 3)`` of unit quaternions ``(..., 4)``."""
    quat = np.asarray(quat_wxyz, dtype=np.float64)
    return np.asarray(as_rotation(quat.reshape(-1, 4)).as_matrix()).reshape(*quat.shape[:-1], 3, 3)


def axes_of(quat_wxyz: Array) -> Array:
    """Compute the rows ``(3, 3, n)`` of the rotation matrices of unit quaternions ``(n, 4)``, without scipy."""
    w, *vector = quat_wxyz.T
    doubled = [2.0 * part for part in vector]
    rows = np.empty((3, 3, len(quat_wxyz)))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        rows[i, i] = 1.0 - vector[j] * doubled[j] - vector[k] * doubled[k]
        product, turned = vector[i] * doubled[j], w * doubled[k]
        rows[i, j], rows[j, i] = product - turned, product + turned
    return rows


def matrix_to_quat(matrix: ArrayLike) -> Array:
    """Compute the unit quaternions ``(..., 4)``, w >= 0, of rotation matrices ``(..., 3, 3)``."""
    # Each of four formulas divides by one component; the largest is taken (Shepperd 1978, DOI 10.2514/3.55767b).
    m = np.moveaxis(np.asarray(matrix, dtype=np.float64), (-2, -1), (0, 1))
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    products = np.empty((*trace.shape, 4, 4))  # 4 q_i q_j
    products[..., 0, 0] = 1.0 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        products[..., i + 1, i + 1] = 1.0 - trace + 2.0 * m[i, i]
        products[..., 0, i + 1] = products[..., i + 1, 0] = m[k, j] - m[j, k]
        products[..., i + 1, j + 1] = products[..., j + 1, i + 1] = m[i, j] + m[j, i]
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    return canonical_quat(np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :])


@dataclass(frozen=True)
class Pose:
    """A batch of rigid transforms: positions ``(..., 3)`` in metres, unit quaternions ``(..., 4)`` with w >= 0."""

    position_m: Array
    quat_wxyz: Array

    @classmethod
    def of(cls, position_m: ArrayLike, quat_wxyz: ArrayLike) -> Pose:
        """Check and canonicalise a transform.

        Raises:
            InputError: a value is not finite, a shape is wrong, or a quaternion's norm is off one by more than 1e-3.
        """
        try:
            position, quat = (np.asarray(part, dtype=np.float64) for part in (position_m, quat_wxyz))
        except (TypeError, ValueError) as error:
            raise InputError(f"a pose needs numbers: {error}") from error
        if position.shape[-1:] != (3,) or quat.shape[-1:] != (4,) or position.shape[:-1] != quat.shape[:-1]:
            raise InputError(f"a pose needs shapes (..., 3) and (..., 4), got {position.shape} and {quat.shape}")
        if not (np.isfinite(position).all() and np.isfinite(quat).all()):
            raise InputError("a pose must be finite: x y z in metres, then a unit quaternion qw qx qy qz")
        with np.errstate(over="ignore"):  # a norm too large for a float is refused below like any other
            norm = np.linalg.norm(quat, axis=-1)
        if np.abs(norm - 1.0).max(initial=0.0) > 1e-3:
            worst = float(norm.reshape(-1)[np.abs(norm - 1.0).argmax()])
            raise InputError(f"the quaternion (qw qx qy qz) must have norm 1, got norm {worst:.4g}")
        return cls(position, canonical_quat(quat))

    def inverse(self) -> Pose:
        """Invert: X_a_b becomes X_b_a."""
        back = quat_conjugate(self.quat_wxyz)
        return Pose(-rotate(back, self.position_m), canonical_quat(back))

    def __matmul__(self, other: Pose) -> Pose:
        """Compose with broadcasting: ``X_a_b @ X_b_c`` is X_a_c."""
        quat = canonical_quat(quat_multiply(self.quat_wxyz, other.quat_wxyz))
        return Pose(self.apply(other.position_m), quat)

    def apply(self, points: ArrayLike) -> Array:
        """Map points ``(..., 3)`` given in frame b into frame a."""
        return self.position_m + rotate(self.quat_wxyz, points)


def rotate(quat_wxyz: ArrayLike, vectors: ArrayLike) -> Array:
    """Rotate vectors ``(..., 3)`` by unit quaternions ``(..., 4)`` with broadcasting."""
    quat, vectors = np.asarray(quat_wxyz, dtype=np.float64), np.asarray(vectors, dtype=np.float64)
    w, *u = _parts(quat)
    t = [2.0 * part for part in _cross(u, _parts(vectors))]
    turned = zip(_parts(vectors), t, _cross(u, t), strict=True)
    return np.stack([part + w * along + across for part, along, across in turned], axis=-1)


def _cross(a: list[Array], b: list[Array]) -> list[Array]:
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]


def rotation_angle(a: ArrayLike, b: ArrayLike) -> Array:
    """Compute the angle in radians between rotations given as wxyz quaternions, q and -q being the same."""
    difference = quat_multiply(quat_conjugate(a), b)
    half: Array = np.arctan2(np.linalg.norm(difference[..., 1:], axis=-1), np.abs(difference[..., 0]))
    return 2.0 * half
