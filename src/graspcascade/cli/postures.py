"""``graspcascade seeds`` and ``graspcascade prior``: postures and what is learned from them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from ..errors import InputError
from ..hands import shadow_hand
from ..nets import EpochRecord, TrainingSpec
from ..postures import (
    PRIOR_TRAINING,
    LabelledPostures,
    Likeness,
    SeedSpec,
    export_postures,
    fit_prior,
    human_likeness,
    import_postures,
    make_seeds,
)
from ..taxonomy import GRASP_TYPES
from .console import bar, percent, print_json, print_table
from .needs import need


@dataclass(frozen=True)
class Seeds:
    """Make labelled seed postures and print how human they are."""

    spec: SeedSpec = field(default_factory=SeedSpec)
    """Inverse kinematics."""
    out: Path | None = None
    """File to write, .csv, as `graspcascade prior --postures` reads it."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        """Make the seeds, write them, print the table."""
        if self.out is not None:
            _check_file(self.out, ".csv")
        seeds = _make_seeds(self.spec)
        if self.out is not None:
            export_postures(self.out, seeds)
        found = human_likeness(seeds)
        # One tendon moves both outer joints of a finger, so what the hand does of a seed differs from it.
        moved = human_likeness(replace(seeds, posture=shadow_hand().executed(seeds.posture)))
        if self.json:
            print_json({"n": len(seeds), "types": [_facts(*pair) for pair in zip(found, moved, strict=True)]})
            return
        print("joints of the digits that hold the object whose mean is within one human standard deviation:")
        print_table(
            ["type", "seeds", "human\ngrasps", "joints", "within", "within as\nexecuted", "outside\n(human sd)"],
            [_row(*pair) for pair in zip(found, moved, strict=True)],
            left=(0, 6),
        )
        print(f"{len(seeds)} seed postures" + (f" written to {self.out}" if self.out is not None else ""))


@dataclass(frozen=True)
class Prior:
    """Train the posture prior on seed postures, or on your own recordings."""

    postures: Path | None = None
    """Recorded postures (.csv): a grasp_type column, and joints as <JOINT>_deg or <JOINT>_rad. Seeds without it."""
    out: Path = Path("prior.safetensors")
    """File to write, .safetensors."""
    training: TrainingSpec = PRIOR_TRAINING
    """Training loop."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        """Train and write."""
        need("torch")
        _check_file(self.out, ".safetensors")
        hand = shadow_hand()
        seeds = _make_seeds(SeedSpec()) if self.postures is None else import_postures(self.postures, hand)
        absent = [name for name in GRASP_TYPES if name not in seeds.grasp_type]
        with bar("training", self.training.epochs) as progress:

            def report(record: EpochRecord) -> None:
                progress.show(record.epoch, note=f"loss {record.train_loss:.3f}")

            prior = fit_prior(hand, seeds, self.training, report)
        prior.save(self.out)
        if self.json:
            counts = {name: int((seeds.grasp_type == name).sum()) for name in GRASP_TYPES}
            facts = {"out": str(self.out), "n": len(seeds), "n_clipped": seeds.n_clipped, "per_type": counts}
            print_json(facts | {"fingerprint": prior.fingerprint()})
            return
        angles = f"{seeds.n_clipped} of {seeds.posture.size} angles were beyond limits and clipped"
        print(f"prior of {len(seeds)} postures written to {self.out}; {angles}")
        if absent:
            print(f"no postures of {', '.join(absent)}: do not ask this prior for them")


def _facts(seeds: Likeness, moved: Likeness) -> dict[str, object]:
    own = {"share_within": seeds.share_within, "outliers": seeds.outliers}
    return vars(seeds) | own | {"share_within_executed": moved.share_within, "outliers_executed": moved.outliers}


def _row(seeds: Likeness, moved: Likeness) -> list[str]:
    counts = [str(seeds.n_postures), str(seeds.n_human), str(len(seeds.deviation_sd))]
    outside = ", ".join(f"{name} {value:+.1f}" for name, value in seeds.outliers.items()) or "none"
    return [seeds.grasp_type, *counts, percent(seeds.share_within), percent(moved.share_within), outside]


def _make_seeds(spec: SeedSpec) -> LabelledPostures:
    with bar("seed postures", spec.per_type * len(GRASP_TYPES)) as progress:
        return make_seeds(shadow_hand(), spec, progress.advance)


def _check_file(path: Path, suffix: str) -> None:
    """Refuse a bad name before the work rather than after it."""
    if path.suffix.lower() != suffix:
        raise InputError(f"the file to write must end in {suffix}, got {path.name!r}")
    if path.is_dir() or not path.parent.is_dir():
        raise InputError(f"{path} is a folder, or the folder {path.parent} does not exist")
