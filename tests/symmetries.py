"""Random rotations that map a shape onto itself, drawn independently of how shapes list and fold them."""

import numpy as np
from scipy.spatial.transform import Rotation

from graspcascade.core.objects import Array, Box, Cylinder, Shape, Sphere
from graspcascade.core.poses import as_quat, canonical_quat, quat_multiply

_HALF_TURNS = np.eye(4)  # identity, then half-turns about x, y and z, as quaternions


def random_symmetry(shape: Shape, rng: np.random.Generator, n: int) -> Array:
    """Draw ``(n, 4)`` rotations of a shape's symmetry group, wxyz."""
    match shape:
        case Box():
            return _HALF_TURNS[rng.integers(4, size=n)]
        case Cylinder():
            turns = np.zeros((n, 3))
            turns[:, 2] = rng.uniform(0, 2 * np.pi, n)
            flips = _HALF_TURNS[rng.integers(2, size=n)]
            return canonical_quat(quat_multiply(as_quat(Rotation.from_rotvec(turns)), flips))
        case Sphere():
            return canonical_quat(rng.normal(size=(n, 4)))
    raise NotImplementedError(f"no symmetries of a {type(shape).__name__}")
