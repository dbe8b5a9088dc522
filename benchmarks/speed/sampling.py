"""How soon grasps are there: milliseconds for a thousand once loaded, seconds for the command from nothing."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from itertools import cycle, islice, product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import Spread
from graspcascade.core.machine import child_environment
from graspcascade.core.objects import CATALOGUE
from graspcascade.nets import NumpyDecoder
from graspcascade.proposals import Proposal
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.ranked import Ranked

GRASPS = 1000
"""Grasps of one call."""

_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def sampling(calls: int, seed: int, model: Path | None = None) -> dict[str, Any]:
    """Measure in a process of its own: how many threads products use is settled when numpy is loaded.

    Args:
        calls: timed calls, going round all types and objects.
        seed: seed of the first call; each has its own.
        model: folder of a cascade and a scorer, to be measured as drawn and ranked beside the paper's cascade.

    Raises:
        subprocess.CalledProcessError: the process failed; what it said is on standard error.
    """
    code = f"from {__name__} import serve; serve({calls}, {seed}, {None if model is None else str(model)!r})"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        env=child_environment(**_ONE_THREAD),
        stdout=subprocess.PIPE,
        check=True,
        start_new_session=True,  # an interrupt from the keyboard is for this process, which then ends that one
    )
    measured: dict[str, Any] = json.loads(done.stdout)
    return measured


def serve(calls: int, seed: int, model: str | None) -> None:
    """Measure in this process and print JSON, by the name of each part."""
    cascade = GraspSampler.pretrained("paper")
    measured = {"sampling": measure(cascade, cascade.decoders, calls, seed)}
    if model is not None:
        ranked, cascade = Ranked.load(model), GraspSampler.load(model)
        measured["sampling_raw"] = measure(cascade, cascade.decoders, calls, seed)
        decoders = {**cascade.decoders, "scorer": ranked.scorer.decoder}
        measured["sampling_ranked"] = measure(ranked, decoders, calls, seed)
    print(json.dumps(measured))


def measure(proposal: Proposal, decoders: Mapping[str, NumpyDecoder], calls: int, seed: int) -> dict[str, Any]:
    """Time calls for `GRASPS` grasps of one type and object each, and the yardstick after every one.

    Args:
        proposal: draws the grasps.
        decoders: its networks, by any name.
        calls: timed calls.
        seed: seed of the first.

    Returns:
        `ms` and `yardstick_ms` per call, and the ratio of their medians.
    """
    products = matrix_products(decoders, GRASPS)
    asked = list(islice(cycle(product([kind.name for kind in proposal.grasp_types], CATALOGUE)), calls))
    proposal.sample(*asked[0], None, GRASPS, seed)
    products()
    ms, yardstick = [], []
    for number, (kind, label) in enumerate(asked):
        begun = time.perf_counter()
        proposal.sample(kind, label, None, GRASPS, seed + number)
        sampled = time.perf_counter()
        products()
        ms.append(1e3 * (sampled - begun))
        yardstick.append(1e3 * (time.perf_counter() - sampled))
    return {
        "grasps": GRASPS,
        "calls": calls,
        "threads": 1,
        "ms": Spread.of(ms).to_json(),
        "yardstick": "matrix products of all layers of the networks on as many rows, one thread",
        "yardstick_ms": Spread.of(yardstick).to_json(),
        "ratio": statistics.median(ms) / statistics.median(yardstick),
    }


def matrix_products(decoders: Mapping[str, NumpyDecoder], rows: int) -> Callable[[], None]:
    """Prepare the products of every layer of every decoder with a matrix of so many rows, and nothing else."""
    rng = np.random.default_rng(0)
    layers = [layer.matrix for decoder in decoders.values() for layer in decoder.layers]
    inputs = [rng.standard_normal((rows, len(matrix)), dtype=np.float32) for matrix in layers]
    outputs = [np.empty((rows, matrix.shape[1]), dtype=np.float32) for matrix in layers]

    def run() -> None:
        for given, matrix, out in zip(inputs, layers, outputs, strict=True):
            np.matmul(given, matrix, out=out)

    return run


_COMMAND = ("sample", "tripod", "box_medium", "--side-cm", "3")
_YARDSTICK = "import numpy"


def cold_start(starts: int) -> dict[str, Any]:
    """Time the command and its yardstick in turn, each in a fresh process of this interpreter.

    One untimed start of each comes first, so that files are read from memory.

    Args:
        starts: timed starts of each.

    Returns:
        `s` and `yardstick_s` per start, and the ratio of their medians.

    Raises:
        subprocess.CalledProcessError: a process failed; what it said is on standard error.
    """
    pairs = [(_seconds("-m", "graspcascade", *_COMMAND), _seconds("-c", _YARDSTICK)) for _ in range(starts + 1)]
    seconds, yardstick = zip(*pairs[1:], strict=True)
    return {
        "command": " ".join(("graspcascade", *_COMMAND)),
        "starts": starts,
        "s": Spread.of(seconds).to_json(),
        "yardstick": f'python -c "{_YARDSTICK}"',
        "yardstick_s": Spread.of(yardstick).to_json(),
        "ratio": statistics.median(seconds) / statistics.median(yardstick),
    }


def _seconds(*arguments: str) -> float:
    command = [sys.executable, *arguments]
    begun = time.perf_counter()
    # In a session of its own: an interrupt from the keyboard is for this process, which then ends that one.
    subprocess.run(command, env=child_environment(), stdout=subprocess.DEVNULL, check=True, start_new_session=True)
    return time.perf_counter() - begun
