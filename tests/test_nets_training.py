"""Training conditional VAEs: what they learn, how they repeat, and what they refuse."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ive
from torch.nn import functional

from graspcascade.core.errors import InputError
from graspcascade.nets import HeadSpec, NumpyDecoder, Standardisation, TrainingSpec, VaeSpec, vmf
from graspcascade.nets.specs import MIXTURE_COMPONENTS, concentration
from graspcascade.nets.training import EpochRecord, fit
from graspcascade.nets.vae import ConditionalVae, vmf_log_prob, vmf_mixture_log_prob
from graspcascade.nets.vae import concentration as torch_concentration

QUICK = TrainingSpec(epochs=30, batch_size=256, learning_rate=4e-3, averaging_fraction=0.05)
POSE = VaeSpec(5, (HeadSpec("gaussian", 3), HeadSpec("gaussian", 2), HeadSpec("vmf", 4), HeadSpec("unit", 4)), 2, (16,))


def unit_rows(rows: np.ndarray) -> np.ndarray:
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def pose_rows(n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    c = rng.standard_normal((n, 5)) * 0.01 + 3.0
    flat = rng.standard_normal((n, 5)) * [0.3, 0.2, 0.1, 0.005, 0.003] + [1.0, -1.0, 0.0, 0.1, 0.0]
    return np.hstack([flat, unit_rows(rng.standard_normal((n, 4))), unit_rows(rng.standard_normal((n, 4)))]), c


def test_a_noisy_circle_is_learned_with_its_centre_radius_and_spread() -> None:
    rng = np.random.default_rng(1)
    n = 6000
    centre = rng.uniform(-1, 1, (n, 1))
    angle, radius = rng.uniform(0, 2 * np.pi, n), 1 + 0.1 * rng.standard_normal(n)
    x = np.stack([radius * np.cos(angle) + 3 * centre[:, 0], radius * np.sin(angle)], axis=1)
    decoder = NumpyDecoder.from_fitted(
        fit(VaeSpec(1, (HeadSpec("gaussian", 2),), 2, (64, 64), 0.02), replace(QUICK, epochs=60), x, centre)
    )
    for middle in (-0.5, 0.5):
        drawn = decoder.sample(np.full((4000, 1), middle), np.random.default_rng(2)) - [3 * middle, 0.0]
        distance = np.linalg.norm(drawn, axis=1)
        assert np.abs(drawn.mean(0)).max() < 0.15
        assert distance.mean() == pytest.approx(1.0, abs=0.1)
        assert 0.03 < distance.std() < 0.25
        assert drawn.std(0) == pytest.approx(np.sqrt(0.5), abs=0.12)


def test_a_vmf_head_recovers_a_conditional_mean_and_concentration() -> None:
    rng = np.random.default_rng(3)
    n, kappas = 6000, np.array([20.0, 2000.0])
    sharp, u = rng.integers(0, 2, n), rng.uniform(-1, 1, (n, 2))
    means = unit_rows(np.column_stack([np.ones(n), u, u[:, 0] * u[:, 1]]))
    c = np.column_stack([sharp, u])
    spec = VaeSpec(3, (HeadSpec("vmf", 4),), 1, (32, 32), 1.0)
    decoder = NumpyDecoder.from_fitted(fit(spec, QUICK, vmf.sample(means, kappas[sharp], rng), c))
    mean = decoder.sample(c, rng, mode="mean", temperature=0.0)
    assert np.median(np.arccos((mean * means).sum(1).clip(-1, 1))) < 0.03
    learned = concentration(decoder.decode(np.zeros((n, 1)), c)[:, 4])
    for group, kappa in enumerate(kappas):
        assert np.median(learned[sharp == group]) == pytest.approx(kappa, rel=0.3)
    drawn = decoder.sample(c, rng)
    assert (drawn * means).sum(1)[sharp == 0].mean() == pytest.approx(ive(2, 20.0) / ive(1, 20.0), abs=0.02)


def test_a_mixture_recovers_directions_weights_and_concentration() -> None:
    rng = np.random.default_rng(5)
    n, share = 6000, 0.3
    means = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.6, 0.8, 0.0]])
    which = (rng.uniform(size=n) < share).astype(int)
    x = vmf.sample(means[which], np.full(n, 50.0), rng)
    # A heavy divergence keeps the latent out of it: the output alone must have two modes.
    spec = VaeSpec(1, (HeadSpec("vmf_mixture", 4),), 1, (16,), 10.0)
    decoder = NumpyDecoder.from_fitted(fit(spec, QUICK, x, np.ones((n, 1))))
    drawn = decoder.sample(np.ones((n, 1)), rng)
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0, atol=1e-12)
    near = drawn @ means.T > 0.75
    assert near.any(axis=1).mean() > 0.98
    assert near[:, 1].mean() == pytest.approx(share, abs=0.03)
    assert (drawn @ means[0])[near[:, 0]].mean() == pytest.approx(ive(2, 50.0) / ive(1, 50.0), abs=0.01)
    assert (decoder.sample(np.ones((5, 1)), rng, mode="mean") @ means[0]).min() > 0.99


def test_a_mixture_of_equal_components_is_one_of_them() -> None:
    torch.manual_seed(0)
    one, x = torch.randn(9, 5), functional.normalize(torch.randn(9, 4), dim=-1)
    raw = torch.cat([one.repeat(1, MIXTURE_COMPONENTS), torch.randn(9, MIXTURE_COMPONENTS)], dim=1)
    alone = vmf_log_prob(functional.normalize(one[:, :4], dim=-1), torch_concentration(one[:, 4]), x)
    torch.testing.assert_close(vmf_mixture_log_prob(raw, x), alone)


def test_a_unit_head_learns_a_conditional_rotation() -> None:
    rng = np.random.default_rng(4)
    c = rng.uniform(-1, 1, (3000, 2))
    x = unit_rows(np.column_stack([np.ones(3000), c, c[:, 0] * c[:, 1]]))
    decoder = NumpyDecoder.from_fitted(fit(VaeSpec(2, (HeadSpec("unit", 4),), 1, (32, 32), 1.0), QUICK, x, c))
    drawn = decoder.sample(c, rng)
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0, atol=1e-12)
    assert np.median(np.arccos((drawn * x).sum(1).clip(-1, 1))) < 0.05


def test_composite_heads_come_back_in_order_and_in_natural_units() -> None:
    x, c = pose_rows()
    fitted = fit(POSE, replace(QUICK, epochs=5), x, c)
    drawn = NumpyDecoder.from_fitted(fitted).sample(c, np.random.default_rng(0))
    assert drawn.shape == x.shape
    np.testing.assert_allclose(np.linalg.norm(drawn[:, 5:9], axis=1), 1.0)
    np.testing.assert_allclose(np.linalg.norm(drawn[:, 9:], axis=1), 1.0)
    assert (np.abs(drawn[:, :5].mean(0) - x[:, :5].mean(0)) < x[:, :5].std(0)).all()


def test_a_metric_makes_the_model_match_what_it_weighs() -> None:
    rng = np.random.default_rng(5)
    x, c = rng.standard_normal((2000, 2)) * [1.0, 0.01], np.zeros((2000, 1))
    spec = VaeSpec(1, (HeadSpec("gaussian", 2),), 1, (32,), 0.3)

    def errors(metric: np.ndarray) -> np.ndarray:
        fitted = fit(spec, replace(QUICK, metric_weight=1.0), x, c, np.tile(metric, (2000, 1, 1)))
        model = ConditionalVae(spec)
        model.load_state_dict({name: torch.from_numpy(array) for name, array in fitted.weights.items()})
        x_in = torch.from_numpy(fitted.standardisation.standardise_x(x))
        c_in = torch.from_numpy(fitted.standardisation.standardise_c(c))
        with torch.no_grad():
            x_hat = model.decode(model.encode(x_in, c_in).mean, c_in)
        return (x_hat - x_in).square().mean(0).numpy()

    first, second = errors(np.array([[10.0, 0.0]])), errors(np.array([[0.0, 1000.0]]))
    assert first[0] < 0.1 < 0.5 < first[1]
    assert second[1] < 0.1 < 0.5 < second[0]


def test_the_metric_term_is_the_squared_length_of_the_mapped_error() -> None:
    spec = VaeSpec(1, (HeadSpec("gaussian", 3), HeadSpec("gaussian", 2)), 2, (8,))
    model, x, c, metric = ConditionalVae(spec), torch.randn(4, 5), torch.randn(4, 1), torch.randn(4, 7, 3)
    losses = []
    for weight in (0.0, 2.0):
        torch.manual_seed(0)
        losses.append(model.loss(x, c, metric, weight))
    torch.manual_seed(0)
    q = model.encode(x, c)
    error = (model.decode(q.mean + torch.randn_like(q.mean) * (0.5 * q.log_variance).exp(), c) - x)[:, :3]
    expected = 2.0 * (metric @ error[..., None]).square().sum((1, 2)).mean()
    torch.testing.assert_close(losses[1].reconstruction - losses[0].reconstruction, expected, rtol=1e-4, atol=1e-5)


def test_a_metric_in_natural_units_acts_on_errors_in_natural_units() -> None:
    spec = VaeSpec(1, (HeadSpec("gaussian", 3), HeadSpec("gaussian", 2)), 2, (8,))
    model, x, c, metric = ConditionalVae(spec), torch.randn(4, 5), torch.randn(4, 1), torch.randn(4, 7, 3)
    unit = torch.tensor([0.1, 2.0, 5.0])
    torch.manual_seed(0)
    scaled_error = model.loss(x, c, metric, 2.0, unit=unit).total
    torch.manual_seed(0)
    scaled_metric = model.loss(x, c, metric * unit, 2.0).total
    torch.testing.assert_close(scaled_error, scaled_metric)


def test_the_same_seed_gives_the_same_weights_and_another_seed_others() -> None:
    x, c = pose_rows()
    training = replace(QUICK, epochs=3)
    torch.manual_seed(123)
    first = fit(POSE, training, x, c).weights
    torch.rand(7)
    before, threads = torch.random.get_rng_state(), torch.get_num_threads()
    again, other = fit(POSE, training, x, c).weights, fit(POSE, replace(training, seed=1), x, c).weights
    assert torch.equal(before, torch.random.get_rng_state())
    assert torch.get_num_threads() == threads
    assert all(np.array_equal(first[name], again[name]) for name in first)
    assert not np.array_equal(first["decoder.0.weight"], other["decoder.0.weight"])


def test_standardisation_is_undone_exactly_and_leaves_quaternions_alone() -> None:
    x, c = pose_rows()
    x[:, 1] = 0.25
    scaling = Standardisation.of(POSE, x, c)
    standard = scaling.standardise_x(x)
    np.testing.assert_array_equal(standard[:, 5:], x[:, 5:].astype(np.float32))
    np.testing.assert_allclose(standard[:, [0, 2, 3, 4]].std(0), 1.0, rtol=1e-5)
    np.testing.assert_allclose(scaling.restore_x(standard), x, atol=1e-6)
    np.testing.assert_allclose(scaling.standardise_c(c).mean(0), 0.0, atol=1e-5)


def test_a_constant_condition_does_not_swamp_the_others_when_it_changes() -> None:
    x, c = pose_rows()
    c[:, 0] = 1.0
    assert Standardisation.of(POSE, x, c).standardise_c(c + 1.0)[:, 0] == pytest.approx(1.0)


def test_progress_reports_every_epoch_and_history_keeps_it() -> None:
    x, c = pose_rows()
    seen: list[EpochRecord] = []
    fitted = fit(POSE, replace(QUICK, epochs=4), x, c, progress=seen.append)
    assert tuple(seen) == fitted.history
    assert [record.epoch for record in seen] == [1, 2, 3, 4]
    assert seen[-1].train_loss < seen[0].train_loss
    assert all(record.validation_loss is not None for record in seen)
    assert seen[-1].learning_rate == pytest.approx(QUICK.final_learning_rate)


@given(epochs=st.integers(1, 200), max_steps=st.integers(1, 10_000), batches=st.integers(1, 5_000))
def test_a_maximum_of_steps_leaves_the_most_whole_passes_that_fit(epochs: int, max_steps: int, batches: int) -> None:
    passes = TrainingSpec(epochs=epochs, max_steps=max_steps).epochs_of(batches)
    assert 1 <= passes <= epochs
    assert passes * batches <= max(max_steps, batches)
    assert passes == epochs or (passes + 1) * batches > max_steps
    assert TrainingSpec(epochs=epochs).epochs_of(batches) == epochs


def test_a_run_cut_to_a_maximum_of_steps_is_the_shorter_run() -> None:
    x, c = pose_rows()
    # 380 of the 400 rows are trained on, in batches of 64: five steps each pass.
    training = replace(QUICK, batch_size=64, epochs=3)
    short, cut = fit(POSE, training, x, c), fit(POSE, replace(training, epochs=50, max_steps=19), x, c)
    assert [record.epochs for record in cut.history] == [3, 3, 3]
    assert all(np.array_equal(array, cut.weights[name]) for name, array in short.weights.items())


@given(
    epochs=st.integers(1, 200),
    min_steps=st.integers(0, 5_000),
    more=st.integers(0, 5_000),
    batches=st.integers(1, 5_000),
)
def test_a_minimum_of_steps_asks_for_no_more_passes_than_it_needs(
    epochs: int, min_steps: int, more: int, batches: int
) -> None:
    passes = TrainingSpec(epochs=epochs, min_steps=min_steps).epochs_of(batches)
    assert passes * batches >= min_steps
    assert passes == epochs or (epochs < passes and (passes - 1) * batches < min_steps)
    capped = TrainingSpec(epochs=epochs, min_steps=min_steps, max_steps=min_steps + more)
    if min_steps + more:
        assert capped.epochs_of(batches) == min(passes, max(1, (min_steps + more) // batches))


def test_few_rows_get_a_minimum_of_steps() -> None:
    x, c = pose_rows()
    # 380 of the 400 rows are trained on, in batches of 256: one step each pass.
    training = replace(QUICK, batch_size=256, epochs=3, min_steps=7)
    assert [record.epochs for record in fit(POSE, training, x, c).history] == [7] * 7
    same = fit(POSE, replace(training, epochs=7, min_steps=0), x, c)
    assert all(np.array_equal(array, same.weights[name]) for name, array in fit(POSE, training, x, c).weights.items())


def test_a_maximum_of_steps_below_the_minimum_is_refused() -> None:
    with pytest.raises(InputError, match="max_steps must be at least min_steps, got 5 and 6"):
        TrainingSpec(min_steps=6, max_steps=5)


def test_without_held_out_rows_there_is_no_validation_loss() -> None:
    x, c = pose_rows()
    assert fit(POSE, replace(QUICK, epochs=1, validation_fraction=0.0), x, c).history[0].validation_loss is None


def test_rows_that_cannot_be_trained_on_are_refused() -> None:
    x, c = pose_rows()
    training = replace(QUICK, epochs=1, metric_weight=1.0)
    with pytest.raises(InputError, match=r"x must have shape \(n, 13\)"):
        fit(POSE, training, x[:, 1:], c)
    with pytest.raises(InputError, match="as many rows"):
        fit(POSE, training, x[1:], c)
    with pytest.raises(InputError, match="column 2 of c"):
        fit(POSE, training, x, np.where(np.arange(5) == 2, np.nan, c))
    with pytest.raises(InputError, match="5 to 8 of x must be unit quaternions"):
        fit(POSE, training, x * 2, c)
    with pytest.raises(InputError, match=r"metric needs .* \(400, k, 3\)"):
        fit(POSE, training, x, c, np.zeros((400, 2, 5)))


def test_specs_out_of_range_are_refused() -> None:
    with pytest.raises(InputError, match="Did you mean 'gaussian'"):
        HeadSpec("gausian", 3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="a vmf head has dim 4"):
        HeadSpec("vmf", 3)
    with pytest.raises(InputError, match="at least one head"):
        VaeSpec(3, ())
    with pytest.raises(InputError, match="learning_rate"):
        TrainingSpec(learning_rate=0.0)
    with pytest.raises(InputError, match="seed must be at most 18446744073709551615, got 1000000"):
        TrainingSpec(seed=10**22)
    with pytest.raises(InputError, match="seed must not be negative"):
        TrainingSpec(seed=-1)


# Chances


def test_a_chance_head_learns_the_rate_at_which_things_happen() -> None:
    rng = np.random.default_rng(4)
    n, spec = 20_000, VaeSpec(2, (HeadSpec("chance", 2),), 0, (32, 32))
    c = rng.uniform(-1.0, 1.0, (n, 2))
    rates = np.column_stack([1 / (1 + np.exp(-3 * c[:, 0])), np.full(n, 0.2)])
    decoder = NumpyDecoder.from_fitted(fit(spec, QUICK, (rng.uniform(size=(n, 2)) < rates).astype(float), c))
    asked = np.column_stack([np.linspace(-0.9, 0.9, 7), np.zeros(7)])
    said = decoder.sample(asked, np.random.default_rng(0))
    np.testing.assert_allclose(said[:, 0], 1 / (1 + np.exp(-3 * asked[:, 0])), atol=0.06)
    np.testing.assert_allclose(said[:, 1], 0.2, atol=0.05)
    np.testing.assert_array_equal(said, decoder.sample(asked, np.random.default_rng(1)))


def test_the_loss_of_a_chance_is_its_log_likelihood() -> None:
    model = ConditionalVae(VaeSpec(3, (HeadSpec("chance", 1, weight=2.0),), 0, (8,)))
    c, happened = torch.randn(16, 3), torch.randint(0, 2, (16, 1)).float()
    rate = torch.sigmoid(model.decode(torch.empty(16, 0), c))
    expected = -(happened * rate.log() + (1 - happened) * (1 - rate).log()).mean()
    losses = model.loss(happened, c)
    torch.testing.assert_close(losses.total, 2.0 * expected)
    assert float(losses.kl) == 0.0


def test_what_neither_happened_nor_did_not_is_refused() -> None:
    with pytest.raises(InputError, match="columns 0 to 0 of x must be 0 or 1"):
        fit(VaeSpec(1, (HeadSpec("chance", 1),), 0, (8,)), QUICK, np.full((50, 1), 0.5), np.zeros((50, 1)))
