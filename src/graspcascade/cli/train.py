"""``graspcascade train``: fit a cascade to a dataset."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

from ..cascade import CascadeTraining, factorization, fit_cascade
from ..dataset import load_dataset
from ..errors import InputError
from ..files import write_folder_staged
from ..hands import shadow_hand
from ..nets import EpochRecord
from .console import Bar, at_least, bar, print_json
from .needs import need


@dataclass(frozen=True)
class Train:
    """Train a cascade on the successes of a dataset."""

    data: Path
    """Folder of the dataset."""
    out: Path
    """Folder for the trained cascade and its training curves; new or empty."""
    factorization: str = "model3"
    """Which stages: model1, model2, model3, plain_rotation or variant2 to variant7 of the paper."""
    training: CascadeTraining = field(default_factory=CascadeTraining)
    """What to learn from and how long."""
    workers: int = 0
    """Processes to train stages side by side in, 0 for as many as processors; the weights are the same."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        """Train and write."""
        need("pyarrow")
        need("torch")
        at_least("workers", self.workers, 0)
        chosen = factorization(self.factorization)
        out = _replaceable(self.out)
        dataset = load_dataset(self.data)
        out.parent.mkdir(parents=True, exist_ok=True)
        with bar("training") as progress:
            epochs = Epochs(progress, len(chosen.stages))
            fitted = fit_cascade(shadow_hand(), dataset, chosen, self.training, epochs.show, self.workers)
        write_folder_staged(out, fitted.save)
        losses = {name: records[-1].train_loss for name, records in fitted.history.items()}
        if self.json:
            print_json({"out": str(self.out), "factorization": chosen.name, "final_loss": losses})
        else:
            stages = ", ".join(f"{name} {loss:.3f}" for name, loss in losses.items())
            print(f"{chosen.name} trained on {self.data}, written to {self.out}; final loss: {stages}")


class Epochs:
    """Show the epochs of stages that are trained side by side as one bar, with the loss of those under way."""

    def __init__(self, progress: Bar, n_stages: int) -> None:
        self._progress, self._n_stages = progress, n_stages
        self._latest: dict[str, EpochRecord] = {}

    def show(self, stage: str, record: EpochRecord) -> None:
        """Take one epoch of one stage into account; all stages have as many epochs."""
        self._latest[stage] = record
        done = sum(latest.epoch for latest in self._latest.values())
        # The stage just heard of stays, so that something is shown when it ends.
        going = [name for name, latest in self._latest.items() if name == stage or latest.epoch < latest.epochs]
        losses = ", ".join(f"{name} {_loss(self._latest[name]):.3f}" for name in going)
        self._progress.show(done, self._n_stages * record.epochs, f"loss: {losses}")


def _replaceable(folder: Path) -> Path:
    """Resolve the folder to write, which is moved into place when it is done: what would not go is refused before.

    Raises:
        InputError: it holds something, or cannot be put in place of what is there.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} is not empty; give a new or empty folder")
    folder = folder.resolve()
    stays = folder.is_dir() and (folder.is_mount() or folder.samefile(Path.cwd()))
    if stays or (folder.parent.is_dir() and not os.access(folder.parent, os.W_OK)):
        raise InputError(
            f"{folder} cannot be put in place when it is done, being the working directory, a mount point or in a "
            "folder that is read-only; give a folder inside it or elsewhere"
        )
    return folder


def _loss(record: EpochRecord) -> float:
    return record.train_loss if record.validation_loss is None else record.validation_loss
