"""Sampling without torch, and the file decoders are kept in."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import save_file

from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.nets import HeadSpec, NumpyDecoder, Standardisation, VaeSpec, inference, load_decoders, save_decoders
from graspcascade.nets.specs import concentration
from graspcascade.nets.vae import ConditionalVae
from graspcascade.nets.vae import concentration as torch_concentration

SPEC = VaeSpec(6, (HeadSpec("gaussian", 3, 2.0), HeadSpec("vmf", 4), HeadSpec("unit", 4)), 4, (32, 16), 0.1)


def make_model() -> tuple[ConditionalVae, NumpyDecoder]:
    rng = np.random.default_rng(0)
    torch.manual_seed(0)
    model = ConditionalVae(SPEC)
    scaling = Standardisation.of(SPEC, rng.standard_normal((50, 11)), rng.standard_normal((50, 6)) * 3 + 1)
    weights = {name: tensor.numpy() for name, tensor in model.state_dict().items()}
    return model, NumpyDecoder.from_arrays(SPEC, scaling, weights)


def test_inference_does_not_import_torch() -> None:
    code = "import sys, graspcascade.nets.inference; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_numpy_decoder_agrees_with_torch() -> None:
    model, decoder = make_model()
    rng = np.random.default_rng(1)
    z, c = rng.standard_normal((100, 4)).astype(np.float32), rng.standard_normal((100, 6))
    with torch.no_grad():
        expected = model.decode(torch.from_numpy(z), torch.from_numpy(decoder.standardisation.standardise_c(c)))
    np.testing.assert_allclose(decoder.decode(z, c), expected.numpy(), atol=1e-5)


def test_concentration_agrees_with_torch_grows_and_stays_in_bounds() -> None:
    raw = np.linspace(-1000, 1000, 2001)
    kappa = concentration(raw)
    np.testing.assert_allclose(kappa, torch_concentration(torch.from_numpy(raw)).numpy(), rtol=1e-12)
    assert (np.diff(kappa) >= 0).all()
    assert kappa[0] > 0
    assert kappa[-1] < 1.001e4


def test_a_batch_of_any_length_decodes_as_its_rows() -> None:
    _, decoder = make_model()
    rng = np.random.default_rng(2)
    z, c = rng.standard_normal((1300, 4)).astype(np.float32), rng.standard_normal((1300, 6))
    rows = np.concatenate([decoder.decode(z[i : i + 50], c[i : i + 50]) for i in range(0, 1300, 50)])
    np.testing.assert_allclose(decoder.decode(z, c), rows, atol=1e-5)


@given(st.lists(st.booleans(), min_size=6, max_size=6))
def test_fixing_conditions_is_the_same_as_repeating_them(flags: list[bool]) -> None:
    _, decoder = make_model()
    rng, fixed = np.random.default_rng(4), np.array(flags)
    z, c = rng.standard_normal((30, 4)).astype(np.float32), rng.standard_normal((30, 6)) * 3
    c[:, fixed] = c[0, fixed]
    rest = decoder.fixing(fixed, c[0, fixed])
    assert rest.spec.condition_dim == 6 - sum(flags)
    np.testing.assert_allclose(rest.decode(z, c[:, ~fixed]), decoder.decode(z, c), atol=1e-5)


def test_conditions_that_do_not_fit_cannot_be_fixed() -> None:
    decoder = make_model()[1]
    with pytest.raises(InputError, match=r"\(6,\) flags"):
        decoder.fixing(np.ones(5, dtype=bool), np.ones(5))
    with pytest.raises(InputError, match=r"values \(3,\)"):
        decoder.fixing(np.arange(6) < 2, np.ones(3))


def test_samples_repeat_with_the_generator_and_mean_mode_draws_no_rotation() -> None:
    _, decoder = make_model()
    c = np.ones((20, 6))
    first, again = (decoder.sample(c, np.random.default_rng(3)) for _ in range(2))
    mean = decoder.sample(c, np.random.default_rng(3), mode="mean")
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first[:, [0, 1, 2, 7, 8, 9, 10]], mean[:, [0, 1, 2, 7, 8, 9, 10]])
    assert np.abs(first[:, 3:7] - mean[:, 3:7]).max() > 1e-3
    centre = decoder.sample(c, np.random.default_rng(3), mode="mean", temperature=0.0)
    np.testing.assert_allclose(centre, np.tile(centre[0], (20, 1)), atol=1e-6)


def test_no_conditions_give_no_samples() -> None:
    assert make_model()[1].sample(np.empty((0, 6)), np.random.default_rng(0)).shape == (0, 11)


def test_unusable_sampling_requests_are_refused() -> None:
    decoder, rng = make_model()[1], np.random.default_rng(0)
    with pytest.raises(InputError, match=r"c must have shape \(2, 6\), got \(2, 5\)"):
        decoder.sample(np.ones((2, 5)), rng)
    with pytest.raises(InputError, match="c must have shape"):
        decoder.sample(np.ones(6), rng)
    with pytest.raises(InputError, match="Did you mean 'mean'"):
        decoder.sample(np.ones((2, 6)), rng, mode="means")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="temperature"):
        decoder.sample(np.ones((2, 6)), rng, temperature=-1.0)


def test_stored_decoders_come_back_bit_for_bit(tmp_path: Path) -> None:
    _, decoder = make_model()
    path = tmp_path / "cascade.safetensors"
    save_decoders(path, {"posture": decoder, "rotation": decoder}, {"joints": ["a", "b"], "rate": 0.1})
    stored = load_decoders(path)
    assert list(stored.decoders) == ["posture", "rotation"]
    assert stored.metadata == {"joints": ["a", "b"], "rate": 0.1}
    back = stored.decoders["rotation"]
    assert back.spec == SPEC
    for name, array in decoder.arrays().items():
        np.testing.assert_array_equal(back.arrays()[name], array)
    c = np.ones((5, 6))
    np.testing.assert_array_equal(back.sample(c, np.random.default_rng(0)), decoder.sample(c, np.random.default_rng(0)))
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_the_same_decoders_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        save_decoders(tmp_path / name, {"posture": make_model()[1]}, {"x": 1, "y": 2})
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_failed_save_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "net"
    path.write_text("old")
    with pytest.raises(InputError, match="JSON"):
        save_decoders(path, {"posture": make_model()[1]}, {"bad": object()})
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["net"]


@pytest.mark.parametrize("keep", [0, 5, 8, 200, -1])
def test_truncated_files_are_refused_by_name(tmp_path: Path, keep: int) -> None:
    path = tmp_path / "cut.safetensors"
    save_decoders(path, {"posture": make_model()[1]})
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(FileFormatError, match=r"cut\.safetensors.*not a complete safetensors file"):
        load_decoders(path)


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    text, other = tmp_path / "text", tmp_path / "other"
    text.write_text("hello, this is not a network\n" * 10)
    save_file({"a": np.zeros(3)}, other)
    with pytest.raises(FileFormatError, match="text: not a complete safetensors file"):
        load_decoders(text)
    with pytest.raises(FileFormatError, match="other: a safetensors file, but not one of graspcascade's"):
        load_decoders(other)
    with pytest.raises(InputError, match="there is no file"):
        load_decoders(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("header", "complaint"),
    [
        ("{", "not JSON"),
        ("[]", "schema version None"),
        ('{"schema_version": 99}', "schema version 99, this package reads 1"),
        ('{"schema_version": 1}', "damaged"),
        (
            '{"schema_version": 1, "stages": [{"name": "p", "spec": {"heads": [{"kind": "x"}]}}], "metadata": {}}',
            "damaged",
        ),
    ],
)
def test_wrong_headers_are_refused(tmp_path: Path, header: str, complaint: str) -> None:
    save_file({"a": np.zeros(3)}, tmp_path / "net", {inference.HEADER_KEY: header})
    with pytest.raises(FileFormatError, match=complaint):
        load_decoders(tmp_path / "net")


def test_a_file_without_one_of_its_arrays_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, decoder = make_model()
    arrays = decoder.arrays()
    arrays.pop("decoder.2.bias")
    monkeypatch.setattr(NumpyDecoder, "arrays", lambda self: arrays)
    save_decoders(tmp_path / "net", {"posture": decoder})
    with pytest.raises(FileFormatError, match=r"net: stage 'posture': the array 'decoder\.2\.bias' is missing"):
        load_decoders(tmp_path / "net")
