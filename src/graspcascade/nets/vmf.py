"""The von Mises-Fisher distribution on unit quaternions (the sphere S^3), numpy only.

Density at unit x: ``C_4(kappa) * exp(kappa * mean . x)``; kappa is the concentration, 0 being uniform. The spread
about the mean is about ``1 / sqrt(kappa)`` per tangent direction, so ``2 / sqrt(kappa)`` radians of rotation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.errors import InputError

Array = NDArray[np.float64]


def sample(mean: ArrayLike, kappa: ArrayLike, rng: np.random.Generator) -> Array:
    """Draw one unit vector per row, exactly, each row with its own mean and concentration.

    Rejection from a Gamma envelope, which three normals give together with the tangent direction. Of the proposals
    56 % are accepted at zero concentration, 98 % at 3 and nearly all at 10 and above.

    Means are ``(n, 4)`` unit vectors, concentrations ``(n,)`` or a scalar; the draws are ``(n, 4)`` unit vectors.

    Raises:
        InputError: a shape is wrong, or a concentration is negative or not finite.
    """
    mean = np.asarray(mean, dtype=np.float64)
    kappa = np.asarray(kappa, dtype=np.float64)
    if mean.ndim != 2 or mean.shape[1] != 4 or kappa.shape not in ((), mean.shape[:1]):
        raise InputError(f"von Mises-Fisher needs means (n, 4) and kappas (n,), got {mean.shape} and {kappa.shape}")
    if not (np.isfinite(kappa).all() and (kappa >= 0).all()):
        raise InputError("von Mises-Fisher concentrations must be finite and not negative")
    return _from_pole(mean, _around_pole(np.broadcast_to(kappa, mean.shape[:1]), rng))


def _around_pole(kappa: Array, rng: np.random.Generator) -> Array:
    """Draw ``(n, 4)`` vectors about the pole (1, 0, 0, 0), proposing again for the rejected rows only."""
    drawn, accepted = _propose(kappa, rng)
    rows = np.flatnonzero(~accepted)
    while rows.size:
        again, accepted = _propose(kappa[rows], rng)
        drawn[rows[accepted]] = again[accepted]
        rows = rows[~accepted]
    return drawn


def _propose(kappa: Array, rng: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
    """Draw from the envelope and say which rows to accept.

    The height h = 1 - cosine has density ``exp(-kappa h) sqrt(h (2 - h))`` on [0, 2]. Half the squared length of three
    normals over the rate ``kappa + e`` has density ``exp(-(kappa + e) h) sqrt(h)``, so the ratio to bound is
    ``exp(e h) sqrt(1 - h/2)``. Its maximum is ``exp(2 e - 1/2) / sqrt(4 e)``, and the e of most acceptances solves
    ``e^2 + (kappa - 1) e = kappa / 4``. The tangent direction is that of the normals, and independent of their length.
    """
    shifted = kappa - 0.5
    beyond = 0.375 / (shifted + np.hypot(shifted, np.sqrt(0.75)))  # e - 1/4, in a form that never cancels
    excess = 0.25 + beyond
    scale = 1.0 / (kappa + excess)
    tangent = rng.standard_normal((len(kappa), 3))
    height = np.einsum("ij,ij->i", tangent, tangent) * (0.5 * scale)
    # Heights beyond the sphere are never accepted; the floor keeps their logarithm finite.
    inside = np.maximum(1.0 - 0.5 * height, 1e-300)
    point = np.empty((len(kappa), 4))
    np.subtract(1.0, height, out=point[:, 0])
    np.multiply(tangent, np.sqrt(scale * inside)[:, None], out=point[:, 1:])
    log_ratio = excess * height + 0.5 * np.log(inside * (1.0 + 4.0 * beyond)) - 2.0 * beyond
    return point, log_ratio >= -rng.standard_exponential(len(kappa))


def _from_pole(mean: Array, around_pole: Array) -> Array:
    """Carry the pole to each mean by a Householder reflection whose axis never vanishes."""
    sign = np.where(mean[:, 0] < 0.0, -1.0, 1.0)
    axis = mean.copy()
    axis[:, 0] += sign
    along = np.einsum("ij,ij->i", axis, around_pole) * (2.0 / np.einsum("ij,ij->i", axis, axis))
    carried: Array = (axis * along[:, None] - around_pole) * sign[:, None]
    return carried
