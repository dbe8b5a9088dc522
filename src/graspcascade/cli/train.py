"""``graspcascade train``: fit a cascade to a dataset."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ..cascade import CascadeTraining, factorization, fit_cascade
from ..dataset import load_dataset
from ..errors import InputError
from ..hands import shadow_hand
from ..nets import EpochRecord
from .console import bar, print_json
from .needs import need


@dataclass(frozen=True)
class Train:
    """Train a cascade on the successes of a dataset."""

    data: Path
    """Folder of the dataset."""
    out: Path
    """Folder for the trained cascade; new or empty."""
    factorization: str = "model3"
    """Which stages: model1, model2, model3, plain_rotation or variant2 to variant7 of the paper."""
    training: CascadeTraining = field(default_factory=CascadeTraining)
    """What to learn from and how long."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        """Train and write."""
        need("pyarrow")
        need("torch")
        chosen = factorization(self.factorization)
        if self.out.exists() and (not self.out.is_dir() or any(self.out.iterdir())):
            raise InputError(f"{self.out} is not empty; give a new or empty folder")
        dataset = load_dataset(self.data)
        with bar("training", len(chosen.stages)) as progress:

            def report(stage: str, record: EpochRecord) -> None:
                loss = record.train_loss if record.validation_loss is None else record.validation_loss
                progress.show(record.epoch, record.epochs, f"loss {loss:.3f}", f"training {stage}")

            fitted = fit_cascade(shadow_hand(), dataset, chosen, self.training, report)
        fitted.save(self.out)
        losses = {name: records[-1].train_loss for name, records in fitted.history.items()}
        if self.json:
            print_json({"out": str(self.out), "factorization": chosen.name, "final_loss": losses})
        else:
            stages = ", ".join(f"{name} {loss:.3f}" for name, loss in losses.items())
            print(f"{chosen.name} trained on {self.data}, written to {self.out}; final loss: {stages}")
