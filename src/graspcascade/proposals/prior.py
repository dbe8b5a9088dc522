"""The posture prior: a conditional VAE given the grasp type alone, from which the heuristic draws its postures."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.errors import FileFormatError, InputError
from ..core.records import taxonomy_to_json, types_from_json
from ..core.taxonomy import TAXONOMIES, GraspType, as_type
from ..hands.hand import Hand
from ..nets import NumpyDecoder, load_decoders, save_decoders

_DECODER = "prior"
"""Name of the decoder in a stored prior."""


@dataclass(frozen=True, eq=False, repr=False)
class PosturePrior:
    """Draw random postures of a grasp type.

    Attributes:
        joint_names: names of the posture's columns.
        grasp_types: names of the types that it was trained on, in the order of its inputs.
        decoder: the trained decoder.
        metadata: what it was trained on and how.
        taxonomy: whose types they are (see `core.taxonomy.TAXONOMIES`).

    Examples:
        >>> import numpy as np
        >>> prior = PosturePrior.pretrained()
        >>> prior
        <PosturePrior of 22 joints>
        >>> prior.sample(["tripod", "tip_pinch"], np.random.default_rng(0)).shape
        (2, 22)
    """

    joint_names: tuple[str, ...]
    grasp_types: tuple[str, ...]
    decoder: NumpyDecoder
    metadata: dict[str, Any]
    taxonomy: str = "paper"

    def __repr__(self) -> str:
        """Word the prior in one line."""
        return f"<PosturePrior of {len(self.joint_names)} joints>"

    @property
    def types(self) -> Mapping[str, GraspType]:
        """Types of its taxonomy by name, those that it was not trained on included."""
        return TAXONOMIES[self.taxonomy]

    def sample(self, grasp_types: ArrayLike, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw one posture ``(n, J)`` in radians for each type name, not clipped to limits.

        Raises:
            InputError: an unknown type, or one that the prior was not trained on.
        """
        return self.decoder.sample(type_codes(grasp_types, self.grasp_types), rng)

    def columns_of(self, hand: Hand) -> NDArray[np.intp]:
        """Locate a hand's joints ``(J,)`` among the columns of this prior's postures.

        A hand that has some of the joints, such as the same hand without a finger, can be given this prior's postures.

        Raises:
            InputError: the hand has other joints.
        """
        absent = [name for name in hand.joint_names if name not in self.joint_names]
        if absent:
            raise InputError(
                f"the prior's postures are of the joints {', '.join(self.joint_names)} and lack {', '.join(absent)} of "
                f"{hand.name}; train the prior for this hand"
            )
        return np.array([self.joint_names.index(name) for name in hand.joint_names], dtype=np.intp)

    def fingerprint(self) -> str:
        """Digest the weights to 16 hexadecimal digits; a dataset records those of its prior."""
        digest = hashlib.sha256()
        self.decoder.digest_into(digest)
        return digest.hexdigest()[:16]

    def save(self, path: Path) -> None:
        """Write the prior, its metadata inside, to one safetensors file."""
        names = {"joint_names": list(self.joint_names), "grasp_types": list(self.grasp_types)}
        save_decoders(path, {_DECODER: self.decoder}, names | taxonomy_to_json(self.taxonomy) | self.metadata)

    @classmethod
    def load(cls, path: Path | str) -> PosturePrior:
        """Read a prior.

        Raises:
            InputError: there is no such file.
            FileFormatError: the file is truncated, foreign or not a prior.
        """
        stored = load_decoders(Path(path))
        if _DECODER not in stored.decoders:
            raise FileFormatError(f"{path} holds {', '.join(stored.decoders)}, not a posture prior")
        metadata = dict(stored.metadata)
        decoder = stored.decoders[_DECODER]
        try:
            names, kinds = (
                msgspec.convert(metadata.pop(key, None), tuple[str, ...]) for key in ("joint_names", "grasp_types")
            )
            types = types_from_json(metadata)
            for name in kinds:
                as_type(name, types)
        except (InputError, msgspec.ValidationError) as error:
            raise FileFormatError(f"{path} does not name joints and types as a posture prior does: {error}") from error
        widths = (decoder.spec.target_dim, decoder.spec.condition_dim)
        if widths != (len(names), len(kinds)) or len(set(names + kinds)) < len(names + kinds):
            raise FileFormatError(
                f"{path} names {len(names)} joints and {len(kinds)} types, but has weights for {widths[0]} and "
                f"{widths[1]}, or names one twice"
            )
        return cls(names, kinds, decoder, metadata, metadata.pop("taxonomy", "paper"))

    @classmethod
    def pretrained(cls) -> PosturePrior:
        """Read the prior shipped with the package."""
        return cls.load(str(files("graspcascade.proposals") / "prior.safetensors"))


def type_codes(grasp_types: ArrayLike, known: Sequence[str]) -> NDArray[np.float32]:
    """Encode type names ``(n,)`` as one-hot rows ``(n, K)`` in the order of K known ones; others are an InputError."""
    names = [as_type(str(name)).name for name in np.asarray(grasp_types, dtype=str)]
    if foreign := [name for name in dict.fromkeys(names) if name not in known]:
        raise InputError(f"the prior has seen no postures of {', '.join(foreign)}; it knows {', '.join(known)}")
    return np.eye(len(known), dtype=np.float32)[[known.index(name) for name in names]]
