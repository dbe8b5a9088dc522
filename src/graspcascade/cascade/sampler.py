"""`GraspSampler`: grasps of an asked type, object and side from a trained cascade, with numpy alone."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..candidates import draw_sides
from ..errors import FileFormatError, InputError, unknown
from ..grasps import Grasps
from ..hands import HandModel, hand_from_json, hand_to_json
from ..hands.model import Closure
from ..nets import NumpyDecoder, load_decoders, save_decoders
from ..objects import grasp_object
from ..poses import Pose, canonical_quat
from ..taxonomy import grasp_type
from .encoding import Request, condition, encode_posture, encode_request, shared_quantities, split_targets
from .frames import in_hand
from .sizes import SizeMode, SizeRule, check_size_mode
from .stages import Factorization, Quantity, Target, factorization_from_json

Array = NDArray[np.float64]

WEIGHTS_FILE = "cascade.safetensors"
EVALUATION_FILE = "evaluation.json"
_KIND = "grasp cascade"


@dataclass(frozen=True, eq=False)
class GraspSampler:
    """Sample grasps stage by stage: posture, then position, then rotation.

    Attributes:
        name: the factorization's name.
        hand: geometry of the hand it was trained for.
        factorization: its stages.
        decoders: the trained decoder of each stage.
        sizes: which sizes to ask for.
        metadata: what it was trained on and how.
        size_mode: how sizes are chosen from `sizes`.
        measured: trials of its evaluation by "type/object": ``{"held", "n", "protocol"}``; empty before there is one.

    Raises:
        InputError: an unknown size mode.
    """

    name: str
    hand: HandModel
    factorization: Factorization
    decoders: Mapping[str, NumpyDecoder]
    sizes: SizeRule
    metadata: dict[str, Any]
    size_mode: SizeMode = "best"
    measured: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_size_mode(self.size_mode)

    @classmethod
    def pretrained(cls, name: str = "default") -> GraspSampler:
        """Load a cascade shipped with the package.

        Raises:
            InputError: no cascade of that name is shipped.
        """
        return cls.load(shipped_folder(name))

    @classmethod
    def load(cls, folder: Path | str) -> GraspSampler:
        """Load a trained cascade from its folder (or weights file).

        An `evaluation.json` beside the weights, as `graspcascade evaluate --out` writes it, comes along as `measured`.

        Raises:
            InputError: there is no such folder or file.
            FileFormatError: the file is truncated, foreign or not a grasp cascade, or the evaluation is of another.
        """
        path = Path(folder)
        if path.is_dir():
            path = path / WEIGHTS_FILE
        stored = load_decoders(path)
        about = dict(stored.metadata)
        if about.get("kind") != _KIND:
            raise FileFormatError(f"{path} holds no grasp cascade")
        try:
            factorization = factorization_from_json(about["factorization"])
            sizes = SizeRule(**about["sizes"])
            hand = hand_from_json(about["hand"])
            missing = [stage.name for stage in factorization.stages if stage.name not in stored.decoders]
        except (KeyError, TypeError) as error:
            raise FileFormatError(f"{path} lacks or garbles {error}") from error
        except InputError as error:
            raise FileFormatError(f"{path} cannot be read: {error}") from error
        if missing:
            raise FileFormatError(f"{path} lacks the weights of stage {', '.join(missing)}")
        sampler = cls(factorization.name, hand, factorization, stored.decoders, sizes, about["training"])
        return replace(sampler, measured=_measured(path.with_name(EVALUATION_FILE), sampler))

    def save(self, folder: Path | str) -> None:
        """Write one safetensors file whose header carries stages, hand geometry, sizes and training as JSON.

        Angles are radians and lengths metres; poses are of the object in the hand frame or, where the factorization
        says so, in the opposition frame; quaternions are wxyz.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        metadata = {
            "kind": _KIND,
            "factorization": asdict(self.factorization),
            "sizes": self.sizes.to_json(),
            "hand": hand_to_json(self.hand),
            "training": self.metadata,
        }
        save_decoders(folder / WEIGHTS_FILE, self.decoders, metadata)

    def fingerprint(self) -> str:
        """Give a short digest of the weights."""
        digest = hashlib.sha256()
        for name in sorted(self.decoders):
            digest.update(name.encode())
            self.decoders[name].digest_into(digest)
        return digest.hexdigest()[:16]

    def describe(self) -> dict[str, Any]:
        """Say what an evaluation must record of it: training, networks, how sizes are chosen, and which weights."""
        networks = {
            stage.name: {"latent_dim": stage.latent_dim, "hidden": list(stage.hidden), "kl_weight": stage.kl_weight}
            for stage in self.factorization.stages
        }
        about = {"networks": networks, "sizes": self.size_mode, "weights": self.fingerprint()}
        return self.metadata | about

    def origin(self, grasp_type_name: str, object_label: str) -> dict[str, Any]:
        """Say where samples come from, for a file: model, hand, and what was measured for type and object."""
        cell = f"{grasp_type(grasp_type_name).name}/{grasp_object(object_label).label}"
        measured = {cell: dict(self.measured[cell])} if cell in self.measured else {}
        return {"source": "cascade", "model": self.name, "hand": self.hand.description.name, "measured": measured}

    def sample(
        self, grasp_type_name: str, object_label: str, side_axis: str | None = None, n: int = 10, seed: int = 0
    ) -> Grasps:
        """Draw n grasps; the same arguments give the same grasps.

        Args:
            grasp_type_name: name of a grasp type.
            object_label: label of a catalogue object.
            side_axis: body axis to hold it by, or None to draw among the graspable sides.
            n: how many.
            seed: seed of all draws.

        Raises:
            InputError: an unknown name, a side that cannot be held, n < 1, a negative seed, or, unless sizes are the
                paper's, a type that was never seen in training.
        """
        kind, obj = grasp_type(grasp_type_name), grasp_object(object_label)
        if n < 1:
            raise InputError(f"n must be at least 1, got {n}")
        if seed < 0:
            raise InputError(f"seed must not be negative, got {seed}")
        rng = np.random.default_rng(seed)
        labels = np.full(n, obj.label)
        axes = draw_sides(labels, rng) if side_axis is None else np.full(n, obj.side_axis(side_axis))
        return self.sample_rows(np.full(n, kind.name), labels, axes, rng)

    def sample_rows(
        self, grasp_types: ArrayLike, object_labels: ArrayLike, side_axes: ArrayLike, rng: np.random.Generator
    ) -> Grasps:
        """Draw one grasp for each row; the same generator state gives the same grasps.

        Args:
            grasp_types: ``(n,)`` names.
            object_labels: ``(n,)`` labels of catalogue objects.
            side_axes: ``(n,)`` body axes to hold them by.
            rng: source of all draws.

        Raises:
            InputError: an unknown name, a side that cannot be held, lengths that differ, or, unless sizes are the
                paper's, a type that was never seen in training.
        """
        request = self._request(grasp_types, object_labels, side_axes, rng)
        quantities: dict[Quantity, Array] = dict(encode_request(request))
        shared = shared_quantities(request)
        found: dict[Target, Array] = {}
        for stage in self.factorization.stages:
            given = condition(stage, quantities, shared)
            decoder = self.decoders[stage.name].fixing(given.shared, given.shared_values)
            found |= split_targets(stage, decoder.sample(given.by_row, rng), len(self.hand.joint_names))
            if "posture" in stage.targets:
                posture = self.hand.executed(found["posture"])
                closure = self._closure(request, posture)
                quantities["posture"] = encode_posture(posture, closure.thumb_m, closure.other_m)
            if "position" in stage.targets:
                quantities["position"] = found["position"]
        pose = Pose(found["position"], canonical_quat(found["rotation"]))
        X_hand_object = in_hand(pose, closure.thumb_m, closure.other_m, self.factorization.frame)
        return self._grasps(request, posture, closure.grasp_size_m, X_hand_object)

    def _request(
        self, grasp_types: ArrayLike, object_labels: ArrayLike, side_axes: ArrayLike, rng: np.random.Generator
    ) -> Request:
        columns = [np.asarray(names, dtype=str) for names in (grasp_types, object_labels, side_axes)]
        shapes = [names.shape for names in columns]
        if len(set(shapes)) > 1 or len(shapes[0]) != 1:
            raise InputError(f"types, objects and side axes must be as many names each, got shapes {shapes}")
        request = Request(*columns, *np.empty((3, len(columns[0]))))
        cells = request.cells
        spelled, sides = _checked(cells.names)
        request.side_m[:] = sides[cells.of_row]
        if (spelled != cells.names).any():
            kinds, labels, axes = (names[cells.of_row] for names in spelled.T)
            request = replace(request, grasp_type=kinds, object_label=labels, side_axis=axes)
        request.grasp_size_m[:], request.object_size_m[:] = self.sizes.apply(request, self.size_mode, rng)
        return request

    def _closure(self, request: Request, posture: Array) -> Closure:
        cells = request.cells
        names = cells.names[:, 0].tolist()
        distinct = sorted(set(names))
        of_cell = np.array([distinct.index(name) for name in names], dtype=np.intp)
        return self.hand.closure(posture, [grasp_type(name) for name in distinct], of_cell[cells.of_row])

    def _grasps(self, request: Request, posture: Array, grasp_size_m: Array, X_hand_object: Pose) -> Grasps:
        return Grasps(
            joint_names=self.hand.joint_names,
            grasp_type=request.grasp_type,
            object_label=request.object_label,
            side_axis=request.side_axis,
            side_m=request.side_m,
            posture=posture,
            pregrasp=np.broadcast_to(self.hand.pregrasp, posture.shape).copy(),
            X_hand_object=X_hand_object,
            grasp_size_m=grasp_size_m,
            object_size_m=request.object_size_m,
            probability=np.full(len(posture), np.nan),
        )


DEFAULT = "paper"
"""The shipped cascade that `GraspSampler.pretrained()` loads."""


def shipped_folder(name: str = "default") -> Path:
    """Give the folder of a shipped cascade.

    Raises:
        InputError: no cascade of that name is shipped.
    """
    weights = Path(str(files("graspcascade.cascade") / "weights"))
    shipped = sorted(folder.name for folder in weights.iterdir() if folder.is_dir())
    chosen = DEFAULT if name == "default" else name
    if chosen not in shipped:
        raise unknown("model", name, ["default", *shipped])
    return weights / chosen


def _checked(cells: NDArray[np.str_]) -> tuple[NDArray[np.str_], Array]:
    """Spell types, objects and side axes ``(m, 3)`` as their tables do, and give the sides ``(m,)`` in metres.

    Raises:
        InputError: an unknown name, or a side that cannot be held.
    """
    spelled, sides = [], []
    for kind, label, axis in cells.tolist():
        obj = grasp_object(label)
        canonical = obj.side_axis(axis)
        spelled.append((grasp_type(kind).name, obj.label, canonical))
        sides.append(obj.sides_m[canonical])
    return np.array(spelled, dtype=str).reshape(-1, 3), np.array(sides)


def _measured(path: Path, sampler: GraspSampler) -> dict[str, dict[str, Any]]:
    """Read the counts of an evaluation file, nothing where there is none.

    Raises:
        FileFormatError: the file is no evaluation, or names other weights or another choice of sizes.
    """
    if not path.is_file():
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        about = found.get("model_metadata", {})
        weights, sizes = about.get("weights"), about.get("sizes", sampler.size_mode)
        rates = {
            f"{cell['grasp_type']}/{cell['object']}": {
                "held": int(cell["held"]),
                "n": int(cell["n"]),
                "protocol": str(found["protocol"]),
            }
            for cell in found["cells"]
        }
    except (ValueError, KeyError, TypeError, AttributeError, OSError) as error:
        raise FileFormatError(f"{path} is no evaluation of a cascade: {error}") from error
    if weights not in (None, sampler.fingerprint()):
        raise FileFormatError(
            f"{path} is of a cascade with weights {weights}, not of {sampler.fingerprint()} beside it"
        )
    if sizes != sampler.size_mode:
        raise FileFormatError(
            f"{path} is of grasps with sizes {sizes!r}, not {sampler.size_mode!r} as they are sampled"
        )
    return rates
