"""The von Mises-Fisher distribution on S^3: its sampler and its torch density, against Bessel functions."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.integrate import quad
from scipy.special import ive

from graspcascade.core.errors import InputError
from graspcascade.nets import vmf
from graspcascade.nets.vae import SERIES_BELOW, log_peak_density, vmf_log_prob

POLES = np.array([[1.0, 0, 0, 0], [-1.0, 0, 0, 0], [0, 0, 1.0, 0], [-1e-300, 0.6, 0, 0.8]])


def unit_rows(rng: np.random.Generator, n: int) -> np.ndarray:
    rows = rng.standard_normal((n, 4))
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def bessel_argument(kappa: ArrayLike) -> np.ndarray:
    return np.maximum(np.asarray(kappa, dtype=np.float64), 1e-150)  # at zero the functions below would divide by it


def log_normaliser(kappa: ArrayLike) -> np.ndarray:
    """Give log C_4 = log kappa - log(4 pi^2) - log I_1(kappa): Mardia and Jupp, eq. 9.3.4, without a series."""
    k = bessel_argument(kappa)
    return -np.log(2.0 * np.pi**2) - np.log(2.0 * ive(1, k) / k) - k


def mean_cosine(kappa: ArrayLike) -> np.ndarray:
    """Give A_4 = I_2(kappa) / I_1(kappa): Mardia and Jupp, eq. 9.3.8."""
    k = bessel_argument(kappa)
    return np.asarray(ive(2, k) / ive(1, k))


def log_peak(kappa: float) -> tuple[float, float]:
    """Give what the loss takes for the log density at the mean, and its slope."""
    k = torch.tensor(kappa, dtype=torch.float64, requires_grad=True)
    value = log_peak_density(k)
    (slope,) = torch.autograd.grad(value, k)
    return value.item(), slope.item()


@pytest.mark.parametrize("kappa", [0.0, 1e-6, 0.099, 0.101, 1.0, 10.0, 1e3, 1e5])
def test_density_integrates_to_one_over_the_sphere(kappa: float) -> None:
    peak, _ = log_peak(kappa)

    def ring(angle: float) -> float:
        return float(4 * np.pi * np.sin(angle) ** 2 * np.exp(peak + kappa * (np.cos(angle) - 1)))

    reach = min(np.pi, 40 / np.sqrt(max(kappa, 1e-9)))
    assert quad(ring, 0, reach, limit=200, epsabs=0, epsrel=1e-11)[0] == pytest.approx(1.0, rel=1e-9)


def test_the_density_is_uniform_at_zero_and_tangent_gaussian_at_a_million() -> None:
    assert log_peak(0.0)[0] == pytest.approx(-np.log(2 * np.pi**2), abs=1e-15)
    k = 1e6
    assert log_peak(k)[0] == pytest.approx(1.5 * np.log(k / (2 * np.pi)) + 3 / (8 * k), abs=1e-9)


@given(st.floats(0.0, 1e6))
def test_the_density_falls_with_the_cosine_that_is_to_be_expected(kappa: float) -> None:
    expected = float(mean_cosine(kappa))
    assert 0.0 <= expected < 1.0
    assert 1.0 - log_peak(kappa)[1] == pytest.approx(expected, abs=1e-12, rel=1e-9)


def test_density_and_slope_are_continuous_where_the_series_takes_over() -> None:
    below, above = (log_peak(SERIES_BELOW * factor) for factor in (1 - 1e-14, 1.0))
    assert below == pytest.approx(above, abs=1e-13)


@pytest.mark.parametrize("kappa", [0.0, 0.5, 4.0, 60.0, 1e4, 1e6])
@pytest.mark.parametrize("mean", POLES, ids=["pole", "antipole", "equator", "tiny"])
def test_samples_have_the_expected_cosine_and_are_isotropic_about_the_mean(mean: np.ndarray, kappa: float) -> None:
    n = 20_000
    x = vmf.sample(np.tile(mean, (n, 1)), kappa, np.random.default_rng(1))
    np.testing.assert_allclose(np.linalg.norm(x, axis=1), 1.0, atol=1e-14)
    off_cosine = 0.5 * np.square(x - mean).sum(1)
    expected = 1 - float(mean_cosine(kappa))
    assert off_cosine.mean() == pytest.approx(expected, abs=5 * off_cosine.std() / np.sqrt(n))
    tangent = (x - (x @ mean)[:, None] * mean) @ np.linalg.svd(mean[None])[2][1:].T
    spread = tangent.T @ tangent / n
    np.testing.assert_allclose(spread / np.trace(spread), np.eye(3) / 3, atol=0.02)
    assert np.abs(tangent.mean(0)).max() < 5 * np.sqrt(np.trace(spread) / 3 / n)


def test_every_row_keeps_its_own_mean_and_concentration() -> None:
    rng = np.random.default_rng(2)
    means, kappas = unit_rows(rng, 6), np.array([0.0, 1.0, 10.0, 100.0, 1e4, 1e6])
    x = vmf.sample(np.repeat(means, 20_000, axis=0), np.repeat(kappas, 20_000), rng).reshape(6, -1, 4)
    off_cosine = 0.5 * np.square(x - means[:, None]).sum(2)
    np.testing.assert_allclose(off_cosine.mean(1), 1 - mean_cosine(kappas), rtol=0.03)


def test_the_whole_distribution_of_the_cosine_is_exact() -> None:
    kappa, n = 3.0, 40_000
    cosine = np.sort(vmf.sample(np.tile(POLES[2], (n, 1)), kappa, np.random.default_rng(3))[:, 2])
    grid = np.linspace(-1, 1, 20_001)
    density = np.sqrt(1 - grid**2) * np.exp(kappa * (grid - 1))
    cumulative = np.cumsum(density) / density.sum()
    assert np.abs(np.interp(cosine, grid, cumulative) - np.arange(n) / n).max() < 1.95 / np.sqrt(n)


@pytest.mark.parametrize("kappa", [-1.0, np.nan, np.inf])
def test_impossible_concentrations_are_refused(kappa: float) -> None:
    with pytest.raises(InputError, match="concentrations"):
        vmf.sample(POLES, kappa, np.random.default_rng(0))


def test_no_rows_give_no_samples() -> None:
    assert vmf.sample(np.empty((0, 4)), np.empty(0), np.random.default_rng(0)).shape == (0, 4)


@given(st.floats(0.0, 1e6))
def test_torch_log_density_agrees_with_bessel_functions(kappa: float) -> None:
    mean, x = unit_rows(np.random.default_rng(4), 2)
    ours = vmf_log_prob(torch.from_numpy(mean)[None], torch.tensor([kappa], dtype=torch.float64), torch.from_numpy(x))
    assert float(ours) == pytest.approx(float(log_normaliser(kappa)) + kappa * float(mean @ x), rel=1e-9)


@pytest.mark.parametrize("kappa", [1e-3, 0.05, 0.2, 1.0, 50.0, 1e3])
def test_log_density_gradients_agree_with_finite_differences(kappa: float) -> None:
    mean, x = (torch.from_numpy(row)[None] for row in unit_rows(np.random.default_rng(5), 2))
    k = torch.tensor([kappa], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(vmf_log_prob, (mean.requires_grad_(), k, x), eps=1e-7 * max(kappa, 1), atol=1e-5)


def test_log_density_gradient_is_finite_at_zero_and_keeps_its_digits_in_float32() -> None:
    kappa = torch.tensor([0.0, 1e-4, 1.0, 1e4, 1e6], requires_grad=True)
    (slope,) = torch.autograd.grad(log_peak_density(kappa).sum(), kappa)
    expected = 1 - mean_cosine(kappa.detach().numpy())
    np.testing.assert_allclose(slope.numpy(), expected, rtol=1e-6)
