"""The posture prior: a conditional VAE that knows the grasp type alone, the source of the heuristic's postures."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import FileFormatError, InputError
from ..hands import HandModel
from ..nets import HeadSpec, NumpyDecoder, TrainingSpec, VaeSpec, load_decoders, save_decoders
from ..taxonomy import GRASP_TYPES, grasp_type
from .labelled import LabelledPostures
from .metric import contact_metric

if TYPE_CHECKING:
    from ..nets import EpochRecord

_STAGE = "prior"

PRIOR_TRAINING = TrainingSpec(
    epochs=600, batch_size=256, learning_rate=2e-3, metric_weight=1.0 / 0.002**2, validation_fraction=0.0
)
"""How the prior is trained unless told otherwise; a fingertip error of 2 mm counts as much as one standard deviation of
a joint."""


@dataclass(frozen=True)
class PosturePrior:
    """Draw postures of a grasp type.

    Attributes:
        joint_names: names of the posture's columns.
        decoder: the trained decoder.
        metadata: what it was trained on and how.
    """

    joint_names: tuple[str, ...]
    decoder: NumpyDecoder
    metadata: dict[str, Any]

    def sample(self, grasp_types: ArrayLike, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw one posture ``(n, J)`` in radians for each type name; not clipped to limits."""
        return self.decoder.sample(type_codes(grasp_types), rng)

    def check_hand(self, hand: HandModel) -> None:
        """Check that this prior's postures are of a hand's joints, in the hand's order.

        Raises:
            InputError: they are of other joints, or in another order.
        """
        if self.joint_names != hand.joint_names:
            raise InputError(
                f"the prior's postures are of the joints {', '.join(self.joint_names)}, but those of "
                f"{hand.description.name} are, in order, {', '.join(hand.joint_names)}; train the prior for this hand"
            )

    def fingerprint(self) -> str:
        """Give a short digest of the weights, by which a dataset names its prior."""
        digest = hashlib.sha256()
        self.decoder.digest_into(digest)
        return digest.hexdigest()[:16]

    def save(self, path: Path) -> None:
        """Write the prior, its metadata inside, to one safetensors file."""
        save_decoders(path, {_STAGE: self.decoder}, {"joint_names": list(self.joint_names), **self.metadata})

    @classmethod
    def load(cls, path: Path | str) -> PosturePrior:
        """Read a prior.

        Raises:
            InputError: there is no such file.
            FileFormatError: the file is truncated, foreign or not a prior.
        """
        stored = load_decoders(Path(path))
        if _STAGE not in stored.decoders:
            raise FileFormatError(f"{path} holds {', '.join(stored.decoders)}, not a posture prior")
        metadata = dict(stored.metadata)
        if "joint_names" not in metadata:
            raise FileFormatError(f"{path} does not name its joints and is not a posture prior")
        return cls(tuple(metadata.pop("joint_names")), stored.decoders[_STAGE], metadata)

    @classmethod
    def pretrained(cls) -> PosturePrior:
        """Read the prior shipped with the package."""
        return cls.load(str(files("graspcascade.postures") / "prior.safetensors"))


def type_codes(grasp_types: ArrayLike) -> NDArray[np.float32]:
    """Encode type names ``(n,)`` as one-hot rows ``(n, 6)``."""
    names = np.asarray(grasp_types, dtype=str)
    order = list(GRASP_TYPES)
    return np.eye(len(order), dtype=np.float32)[[order.index(grasp_type(str(name)).name) for name in names]]


def fit_prior(
    hand: HandModel,
    seeds: LabelledPostures,
    training: TrainingSpec = PRIOR_TRAINING,
    progress: Callable[[EpochRecord], None] | None = None,
) -> PosturePrior:
    """Train the prior on labelled postures (needs torch, the `train` extra).

    Raises:
        InputError: the postures are of other joints than the hand, or in another order, or none are left to train on.
        FloatingPointError: the loss stopped being finite.
    """
    if seeds.joint_names != hand.joint_names:
        raise InputError(
            f"the labelled postures are of the joints {', '.join(seeds.joint_names)}, but those of "
            f"{hand.description.name} are, in order, {', '.join(hand.joint_names)}"
        )
    # torch is an optional extra: only fitting needs it.
    from ..nets.training import fit

    spec = VaeSpec(
        condition_dim=len(GRASP_TYPES),
        heads=(HeadSpec("gaussian", len(hand.joint_names), weight=4.0),),
        latent_dim=10,
        hidden=(128, 128),
        kl_weight=0.5,
    )
    postures = hand.executed(seeds.posture)
    metric = contact_metric(hand, postures, seeds.grasp_type)
    fitted = fit(
        spec, training, postures.astype(np.float32), type_codes(seeds.grasp_type), metric=metric, progress=progress
    )
    metadata = {
        "kind": "posture prior",
        "hand": hand.description.name,
        "n_postures": len(seeds),
        "training": asdict(training),
    }
    return PosturePrior(hand.joint_names, NumpyDecoder.from_fitted(fitted), metadata)
