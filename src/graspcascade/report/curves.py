"""Training curves as `graspcascade train` leaves them beside the weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from ..cascade import FACTORIZATIONS
from ..errors import FileFormatError
from ..files import read_json

_ALWAYS = ("epoch", "train_loss", "train_reconstruction", "train_kl")


@dataclass(frozen=True)
class StageCurves:
    """Hold one stage's curves, a value for each epoch.

    Attributes:
        epoch: counted from 1.
        train_loss, train_reconstruction, train_kl: means over the epoch's rows.
        validation_loss: of the held-out rows; None without any.
    """

    epoch: tuple[int, ...]
    train_loss: tuple[float, ...]
    train_reconstruction: tuple[float, ...]
    train_kl: tuple[float, ...]
    validation_loss: tuple[float | None, ...]


@dataclass(frozen=True)
class TrainingCurves:
    """Hold the curves of one trained cascade.

    Attributes:
        model: its factorization's name.
        seed: of its training.
        stages: by name, in sampling order.
    """

    model: str
    seed: int
    stages: Mapping[str, StageCurves]

    @classmethod
    def load(cls, path: Path | str) -> TrainingCurves:
        """Read a `training.json`.

        Raises:
            FileFormatError: the file is missing or holds no training curves.
        """
        data = read_json(Path(path))
        try:
            stages = {str(name): _stage(curves) for name, curves in data["stages"].items()}
            if not stages:
                raise ValueError("it has no stage")
            return cls(str(data["factorization"]), int(data["seed"]), stages)
        except KeyError as error:
            raise FileFormatError(f"{path} holds no training curves: it lacks {error.args[0]!r}") from error
        except (TypeError, ValueError, AttributeError) as error:
            raise FileFormatError(f"{path} holds no training curves: {error}") from error

    def panel(self, stage: str) -> str:
        """Say what a stage's losses may be compared with: the stage's name, and its rotation head if that is plain.

        A squared error and a log-likelihood are not on one scale.
        """
        known = FACTORIZATIONS.get(self.model)
        plain = known is not None and any(
            "rotation" in found.targets and found.rotation_head == "unit" and found.name == stage
            for found in known.stages
        )
        return f"{stage}, plain output" if plain else stage


def read_training(folder: Path | str) -> list[TrainingCurves]:
    """Read every file of training curves in a folder, those of one model by seed; none where there is no folder.

    Raises:
        FileFormatError: a file holds no training curves.
    """
    order = {name: number for number, name in enumerate(FACTORIZATIONS)}
    found = [TrainingCurves.load(path) for path in sorted(Path(folder).glob("*.json"))]
    return sorted(found, key=lambda curves: (order.get(curves.model, len(order)), curves.model, curves.seed))


def _stage(data: Mapping[str, Any]) -> StageCurves:
    epoch, *curves = (tuple(data[name]) for name in _ALWAYS)
    validation = tuple(data["validation_loss"])
    if not epoch or {len(epoch)} != {len(curve) for curve in (*curves, validation)}:
        raise ValueError("every curve needs one value for each epoch")
    train, reconstruction, kl = (tuple(map(float, curve)) for curve in curves)
    held_out = tuple(None if value is None else float(value) for value in validation)
    if not all(map(isfinite, (*train, *reconstruction, *kl, *(value for value in held_out if value is not None)))):
        raise ValueError("every value must be finite")
    return StageCurves(tuple(map(int, epoch)), train, reconstruction, kl, held_out)
