"""The conditional variational autoencoder (torch).

Kingma and Welling, Auto-Encoding Variational Bayes (2014), DOI 10.48550/arXiv.1312.6114; conditional as in Sohn, Lee
and Yan, Learning Structured Output Representation using Deep Conditional Generative Models (NeurIPS 2015).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from ..core.errors import InputError
from .specs import KAPPA_FLOOR, KAPPA_MAX, LOG_KAPPA_MAX, Block, VaeSpec, components

SERIES_BELOW = 0.1
"""Concentration below which the density is a power series, exact to 1e-14 there and with a gradient at zero."""


def concentration(raw: Tensor) -> Tensor:
    """Map raw decoder outputs to concentrations; the torch twin of `heads.concentration`."""
    return KAPPA_FLOOR + KAPPA_MAX * torch.sigmoid(raw - LOG_KAPPA_MAX)


def log_peak_density(kappa: Tensor) -> Tensor:
    """Compute log C_4(kappa) + kappa, the log density at the mean, differentiable for every kappa >= 0.

    Computed in float64 whatever the input: its gradient, 1 - A_4(kappa), is a difference of close numbers.
    """
    wide = kappa.double()
    # Each branch gets an argument inside its own range, so that the unused one never sends back a NaN.
    small, large = wide.clamp(max=SERIES_BELOW), wide.clamp(min=SERIES_BELOW)
    square = small**2
    series = small - square * (1 / 8 - square * (1 / 384 - square * (1 / 9216 - square / 184320)))
    bessel = torch.log(large / (2.0 * torch.special.i1e(large)))
    return torch.where(wide < SERIES_BELOW, series, bessel) - math.log(2.0 * math.pi**2)


def vmf_log_prob(mean: Tensor, kappa: Tensor, x: Tensor) -> Tensor:
    """Compute the von Mises-Fisher log density of unit vectors on S^3.

    Written with ``mean . x = 1 - |mean - x|^2 / 2``, which keeps its digits at high concentration. Constants as in
    Mardia and Jupp, Directional Statistics (2000), section 9.3.2, DOI 10.1002/9780470316979.

    Unit vectors `mean` and `x` are ``(..., 4)``, concentrations ``(...)`` as is the result, in the type of `mean`.
    """
    distance = (mean - x).square().sum(-1)
    return log_peak_density(kappa).to(mean.dtype) - 0.5 * kappa * distance


def vmf_mixture_log_prob(raw: Tensor, x: Tensor) -> Tensor:
    """Compute the log density ``(n,)`` of unit vectors ``(n, 4)`` under the mixtures that raw outputs describe."""
    parts, logits = components(raw)
    each = vmf_log_prob(functional.normalize(parts[..., :4], dim=-1), concentration(parts[..., 4]), x[:, None])
    return torch.logsumexp(functional.log_softmax(logits, dim=-1) + each, dim=-1)


def head_loss(block: Block, output: Tensor, x: Tensor) -> Tensor:
    """Compute one head's weighted loss per row ``(n,)`` from all raw outputs and all (standardised) targets."""
    raw, target = output[:, block.output], x[:, block.target]
    if block.head.kind == "gaussian":
        return block.head.weight * (raw - target).square().sum(-1)
    if block.head.kind == "chance":
        each = functional.binary_cross_entropy_with_logits(raw, target, reduction="none")
        return block.head.weight * each.sum(-1)
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
    """Compute the squared length per row ``(n,)`` of `metric` ``(n, k, d)`` times the error of a gaussian block.

    `unit` ``(d,)`` is what a column's error of one is in the units that the metric acts on; 1 where None.
    """
    error = output[:, block.output] - x[:, block.target]
    if unit is not None:
        error = error * unit
    return torch.bmm(metric, error.unsqueeze(-1)).square().sum((1, 2))


# Variances from e-10 to e+10: beyond, exp() of a wild early step would overflow.
LOG_VARIANCE_BOUND = 10.0


class Latent(NamedTuple):
    """Hold the mean and log variance ``(n, latent_dim)`` of q(z|x,c)."""

    mean: Tensor
    log_variance: Tensor


class Losses(NamedTuple):
    """Hold scalar losses, means over the rows; `reconstruction` includes the metric term, `kl` is unweighted."""

    total: Tensor
    reconstruction: Tensor
    kl: Tensor


class ConditionalVae(nn.Module):
    """Model p(x|c) through a latent z ~ N(0, I); all inputs and outputs are standardised."""

    def __init__(self, spec: VaeSpec) -> None:
        super().__init__()
        self.spec = spec
        self.blocks = spec.blocks
        if spec.latent_dim:
            self.encoder = _mlp(spec.encoder_widths)
        self.decoder = _mlp(spec.decoder_widths)

    def encode(self, x: Tensor, c: Tensor) -> Latent:
        """Compute q(z|x,c) for targets ``(n, target_dim)`` and conditions ``(n, condition_dim)``."""
        if not self.spec.latent_dim:
            return Latent(x[:, :0], x[:, :0])
        mean, log_variance = self.encoder(torch.cat([x, c], dim=-1)).chunk(2, dim=-1)
        return Latent(mean, log_variance.clamp(-LOG_VARIANCE_BOUND, LOG_VARIANCE_BOUND))

    def decode(self, z: Tensor, c: Tensor) -> Tensor:
        """Compute the raw outputs ``(n, output_dim)`` that the heads read."""
        output: Tensor = self.decoder(torch.cat([z, c], dim=-1))
        return output

    def loss(
        self,
        x: Tensor,
        c: Tensor,
        metric: Tensor | None = None,
        metric_weight: float = 0.0,
        kl_scale: float = 1.0,
        unit: Tensor | None = None,
    ) -> Losses:
        """Measure a batch with one latent draw per row, from torch's global generator.

        Args:
            x: ``(n, target_dim)`` targets.
            c: ``(n, condition_dim)`` conditions.
            metric: ``(n, k, d)`` matrices acting on the error of the first head, which must be gaussian of dim d;
                adds ``metric_weight * |metric @ (x_hat - x)|^2``.
            metric_weight: see `metric`.
            kl_scale: factor on the divergence's weight, for warming up.
            unit: ``(d,)`` natural units per standardised one, for a metric that acts on natural-unit errors; the
                metric acts on standardised errors where None.

        Raises:
            InputError: a metric is given and the first head is not gaussian.
        """
        q = self.encode(x, c)
        z = q.mean + torch.randn_like(q.mean) * (0.5 * q.log_variance).exp()
        output = self.decode(z, c)
        reconstruction = reconstruction_loss(self.blocks, output, x)
        if metric is not None and metric_weight > 0.0:
            if self.blocks[0].head.kind != "gaussian":
                raise InputError(f"a metric weights a gaussian first head, not {self.blocks[0].head.kind!r}")
            reconstruction = reconstruction + metric_weight * metric_error(self.blocks[0], metric, unit, output, x)
        kl = 0.5 * (q.mean.square() + q.log_variance.exp() - q.log_variance - 1.0).sum(-1).mean()
        mean_reconstruction = reconstruction.mean()
        return Losses(mean_reconstruction + kl_scale * self.spec.kl_weight * kl, mean_reconstruction, kl)


def _mlp(widths: Sequence[int]) -> nn.Sequential:
    """Stack linear layers with ReLU between them."""
    layers: list[nn.Module] = []
    for width_in, width_out in pairwise(widths):
        layers += [nn.Linear(width_in, width_out), nn.ReLU(inplace=True)]
    return nn.Sequential(*layers[:-1])
