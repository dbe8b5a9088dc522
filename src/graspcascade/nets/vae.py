"""The conditional variational autoencoder (torch).

Kingma and Welling, Auto-Encoding Variational Bayes (2014), DOI 10.48550/arXiv.1312.6114; conditional as in Sohn, Lee
and Yan, Learning Structured Output Representation using Deep Conditional Generative Models (NeurIPS 2015).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn

from ..errors import InputError
from .losses import metric_error, reconstruction_loss
from .specs import VaeSpec

__all__ = ["ConditionalVae", "Latent", "Losses", "VaeSpec"]

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
        self.encoder = _mlp(spec.encoder_widths)
        self.decoder = _mlp(spec.decoder_widths)

    def encode(self, x: Tensor, c: Tensor) -> Latent:
        """Give q(z|x,c) for targets ``(n, target_dim)`` and conditions ``(n, condition_dim)``."""
        mean, log_variance = self.encoder(torch.cat([x, c], dim=-1)).chunk(2, dim=-1)
        return Latent(mean, log_variance.clamp(-LOG_VARIANCE_BOUND, LOG_VARIANCE_BOUND))

    def decode(self, z: Tensor, c: Tensor) -> Tensor:
        """Give the raw outputs ``(n, output_dim)`` that the heads read."""
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
