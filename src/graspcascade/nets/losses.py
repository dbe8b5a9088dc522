"""Losses of the output heads, in torch."""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from torch import Tensor
from torch.nn import functional

from .heads import KAPPA_FLOOR, KAPPA_MAX, LOG_KAPPA_MAX, Block, components

SERIES_BELOW = 0.1
"""Concentration below which the density is a power series, exact to 1e-14 there and with a gradient at zero."""


def concentration(raw: Tensor) -> Tensor:
    """Map raw decoder outputs to concentrations; the torch twin of `heads.concentration`."""
    return KAPPA_FLOOR + KAPPA_MAX * torch.sigmoid(raw - LOG_KAPPA_MAX)


def log_peak_density(kappa: Tensor) -> Tensor:
    """Give log C_4(kappa) + kappa, the log density at the mean, differentiable for every kappa >= 0.

    Computed in float64 whatever the input: its gradient, 1 - A_4(kappa), is a difference of close numbers.

    Args:
        kappa: concentrations, any shape.
    """
    wide = kappa.double()
    # Each branch gets an argument inside its own range, so that the unused one never sends back a NaN.
    small, large = wide.clamp(max=SERIES_BELOW), wide.clamp(min=SERIES_BELOW)
    square = small**2
    series = small - square * (1 / 8 - square * (1 / 384 - square * (1 / 9216 - square / 184320)))
    bessel = torch.log(large / (2.0 * torch.special.i1e(large)))
    return torch.where(wide < SERIES_BELOW, series, bessel) - math.log(2.0 * math.pi**2)


def vmf_log_prob(mean: Tensor, kappa: Tensor, x: Tensor) -> Tensor:
    """Give the von Mises-Fisher log density of unit vectors on S^3.

    Written with ``mean . x = 1 - |mean - x|^2 / 2``, which keeps its digits at high concentration. Constants as in
    Mardia and Jupp, Directional Statistics (2000), section 9.3.2, DOI 10.1002/9780470316979.

    Args:
        mean: ``(..., 4)`` unit vectors.
        kappa: ``(...)`` concentrations, ``>= 0``.
        x: ``(..., 4)`` unit vectors.

    Returns:
        ``(...)``, in the type of `mean`.
    """
    distance = (mean - x).square().sum(-1)
    return log_peak_density(kappa).to(mean.dtype) - 0.5 * kappa * distance


def vmf_mixture_log_prob(raw: Tensor, x: Tensor) -> Tensor:
    """Give the log density ``(n,)`` of unit vectors ``(n, 4)`` under the mixtures that raw outputs describe."""
    parts, logits = components(raw)
    each = vmf_log_prob(functional.normalize(parts[..., :4], dim=-1), concentration(parts[..., 4]), x[:, None])
    return torch.logsumexp(functional.log_softmax(logits, dim=-1) + each, dim=-1)


def head_loss(block: Block, output: Tensor, x: Tensor) -> Tensor:
    """Give one head's weighted loss per row ``(n,)`` from all raw outputs and all (standardised) targets."""
    raw, target = output[:, block.output], x[:, block.target]
    if block.head.kind == "gaussian":
        return block.head.weight * (raw - target).square().sum(-1)
    if block.head.kind == "vmf_mixture":
        return -block.head.weight * vmf_mixture_log_prob(raw, target)
    direction = functional.normalize(raw[:, :4], dim=-1)
    if block.head.kind == "unit":
        return block.head.weight * (direction - target).square().sum(-1)
    return -block.head.weight * vmf_log_prob(direction, concentration(raw[:, 4]), target)


def reconstruction_loss(blocks: Iterable[Block], output: Tensor, x: Tensor) -> Tensor:
    """Sum the heads' losses per row ``(n,)``."""
    return torch.stack([head_loss(block, output, x) for block in blocks]).sum(0)


def metric_error(block: Block, metric: Tensor, unit: Tensor | None, output: Tensor, x: Tensor) -> Tensor:
    """Give the squared length per row ``(n,)`` of `metric` ``(n, k, d)`` times the error of a gaussian block.

    `unit` ``(d,)`` is what a column's error of one is in the units that the metric acts on; 1 where None.
    """
    error = output[:, block.output] - x[:, block.target]
    if unit is not None:
        error = error * unit
    return torch.bmm(metric, error.unsqueeze(-1)).square().sum((1, 2))
