"""`GraspSampler`: grasps of an asked type, object and side from a trained cascade, with numpy alone."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from ...core.errors import FileFormatError, InputError, check_name, unknown
from ...core.files import read_json
from ...core.grasps import Grasps
from ...core.objects import GraspObject
from ...core.poses import Pose, canonical_quat, quat_conjugate, quat_multiply
from ...core.tasks import Task, Tasks
from ...core.taxonomy import TAXONOMIES, GraspType
from ...hands.hand import Hand
from ...nets import NumpyDecoder, load_decoders, save_decoders
from .. import Proposal, as_proposed, check_reach
from .encoding import (
    Request,
    Vocabulary,
    condition,
    encode_posture,
    encode_request,
    in_hand,
    shared_quantities,
    site_frames,
    split_targets,
)
from .sizes import SizeMode, SizeRule
from .stages import Factorization, Target

Array = NDArray[np.float64]

WEIGHTS_FILE = "cascade.safetensors"
EVALUATION_FILE = "evaluation.json"
_KIND = "grasp cascade"


@dataclass(frozen=True, eq=False, repr=False)
class GraspSampler(Proposal):
    """Sample grasps stage by stage: posture, then position, then rotation.

    Attributes:
        name: the factorization's name.
        hand: geometry of the hand it was trained for.
        factorization: its stages.
        vocabulary: the types and objects that it was taught.
        metadata: what it was trained on and how.
        size_mode: how sizes are chosen from `sizes`.
        measured: trials of its evaluation by "type/object": ``{"held", "n", "protocol"}``; empty before there is one.

    Raises:
        InputError: an unknown size mode.

    Examples:
        >>> sampler = GraspSampler.pretrained()
        >>> sampler
        <GraspSampler model3 for shadow_hand_right>
        >>> sampler.sample("tip_pinch", "sphere_small", n=5, seed=1)
        <Grasps: 5 tip_pinch of sphere_small, 22 joints of shadow_hand_right>
    """

    source = "cascade"
    name: str
    hand: Hand
    factorization: Factorization
    vocabulary: Vocabulary
    decoders: Mapping[str, NumpyDecoder]
    sizes: SizeRule
    metadata: dict[str, Any]
    size_mode: SizeMode = "best"
    measured: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_name("size mode", self.size_mode, get_args(SizeMode))

    def __repr__(self) -> str:
        """Word the sampler in one line."""
        return f"<GraspSampler {self.name} for {self.hand.name}>"

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
            factorization = msgspec.convert(about["factorization"], Factorization)
            vocabulary = Vocabulary.from_json(about["vocabulary"])
            sizes = msgspec.convert(about["sizes"], SizeRule)
            hand = Hand.from_json(about["hand"])
            training = msgspec.convert(about["training"], dict[str, Any])
            missing = [stage.name for stage in factorization.stages if stage.name not in stored.decoders]
        except (KeyError, TypeError) as error:
            raise FileFormatError(f"{path} lacks or garbles {error}") from error
        except (InputError, msgspec.ValidationError) as error:
            raise FileFormatError(f"{path} cannot be read: {error}") from error
        if missing:
            raise FileFormatError(f"{path} lacks the weights of stage {', '.join(missing)}")
        sampler = cls(factorization.name, hand, factorization, vocabulary, stored.decoders, sizes, training)
        sampler._check_parts(path)
        return replace(sampler, measured=_measured(path.with_name(EVALUATION_FILE), sampler))

    def _check_parts(self, path: Path) -> None:
        """Check that stages, weights and hand fit together, by a draw of every type: a file can be edited."""
        hand = self.hand
        anything = replace(self, hand=replace(hand, reach_m=np.inf), size_mode="paper")
        try:
            obj = self.objects[0]
            tasks = Tasks.of(Task.of(kind, obj, next(iter(obj.sides_m))) for kind in self.grasp_types)
            # Limits that are no numbers compare as false.
            if len(set(hand.joint_names)) < len(hand.joint_names) or not np.all(hand.lower_rad <= hand.upper_rad):
                raise InputError("the hand's joints need names of their own and a lower and an upper limit each")
            drawn = anything.propose(tasks, np.random.default_rng(0)).columns()
            if not all(np.isfinite(drawn[name]).all() for name in ("posture", "pregrasp", "position_m", "quat_wxyz")):
                raise InputError("a grasp drawn from it is not finite")
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            said = error if isinstance(error, InputError) else repr(error)
            raise FileFormatError(f"{path}: its stages, weights and hand do not fit together ({said})") from error

    def save(self, folder: Path | str) -> None:
        """Write one safetensors file whose header carries stages, hand geometry, sizes and training as JSON.

        Angles are radians and lengths metres; poses are of the object in the hand frame or, where the factorization
        says so, in the opposition frame; quaternions are wxyz.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        learned = {"factorization": asdict(self.factorization), "sizes": asdict(self.sizes)}
        learned["vocabulary"] = self.vocabulary.to_json()
        about = {"kind": _KIND, **learned, "hand": self.hand.to_json(), "training": self.metadata}
        save_decoders(folder / WEIGHTS_FILE, self.decoders, about)

    @property
    def grasp_types(self) -> tuple[GraspType, ...]:
        """Grasp types that the hand can make and that were seen in training."""
        possible = self.hand.possible(TAXONOMIES[self.vocabulary.taxonomy].values())
        return tuple(kind for kind in possible if kind.name in self.vocabulary.grasp_types)

    @property
    def objects(self) -> tuple[GraspObject, ...]:
        """Objects that it knows, where it tells them by name, otherwise those of the catalogue."""
        return self.vocabulary.objects if self.factorization.object_code == "label" else super().objects

    @property
    def takes_any_size(self) -> bool:
        """Whether objects of any size can be asked for: it does not tell objects by name."""
        return self.factorization.object_code != "label"

    def fingerprint(self) -> str:
        """Compute a short digest of the weights."""
        digest = hashlib.sha256()
        for name, decoder in sorted(self.decoders.items()):
            digest.update(name.encode())
            decoder.digest_into(digest)
        return digest.hexdigest()[:16]

    def describe(self) -> dict[str, Any]:
        """Say what an evaluation must record of it: training, networks, how sizes are chosen, and which weights."""
        networks = {
            stage.name: {"latent_dim": stage.latent_dim, "hidden": list(stage.hidden), "kl_weight": stage.kl_weight}
            for stage in self.factorization.stages
        }
        return self.metadata | {"networks": networks, "sizes": self.size_mode, "weights": self.fingerprint()}

    def origin(self, kind: GraspType, obj: GraspObject) -> dict[str, Any]:
        """Say for a file where grasps come from, and what was measured of the type and object (`Proposal.origin`)."""
        names = (obj.name, (self.vocabulary.known(obj) or obj).name)
        cell = next((cell for name in names if (cell := f"{kind.name}/{name}") in self.measured), None)
        measured = {} if cell is None else {cell: dict(self.measured[cell])}
        return super().origin(kind, obj) | {"measured": measured}

    def propose(self, tasks: Tasks, rng: np.random.Generator) -> Grasps:
        """Draw one grasp for each task; the same generator state gives the same grasps.

        Raises:
            InputError: a side beyond the hand's reach, or what the model does not know (`Vocabulary.check`).
        """
        check_reach(self.hand, tasks)
        self.check_types(task.grasp_type for task in tasks.distinct)
        for task in tasks.distinct:
            self.vocabulary.check(task, self.factorization.object_code)
        blank, known = np.full(len(tasks), np.nan), self.vocabulary.renamed(tasks)
        request = Request(known, blank, blank)
        if self.factorization.asks_sizes:
            request = Request(known, *self.sizes.apply(request, self.size_mode, rng))
        quantities = encode_request(request, self.vocabulary, self.factorization.object_code)
        shared = shared_quantities(request, self.factorization.object_code)
        values: dict[Target, Array] = {}
        kinds = list(dict.fromkeys(task.grasp_type for task in tasks.table))
        of_task = np.array([kinds.index(task.grasp_type) for task in tasks.table], dtype=np.intp)
        for stage in self.factorization.stages:
            given = condition(stage, quantities, shared)
            decoder = self.decoders[stage.name].fixing(given.shared, given.shared_values)
            values |= split_targets(stage, decoder.sample(given.by_row, rng), len(self.hand.joint_names))
            if "posture" in stage.targets:
                posture = self.hand.executed(values["posture"])
                closure = self.hand.closure(posture, kinds, of_task[tasks.row])
                quantities["posture"] = encode_posture(posture, closure.thumb_m, closure.other_m)
            if "position" in stage.targets:
                quantities["position"] = values["position"]
        rotation = values["rotation"]
        if self.factorization.object_code == "site":
            rotation = quat_multiply(rotation, quat_conjugate(site_frames(tasks)))
        pose = Pose(values["position"], canonical_quat(rotation))
        X_hand_object = in_hand(pose, closure.thumb_m, closure.other_m, self.factorization.frame)
        return as_proposed(self.hand, tasks, posture, X_hand_object, closure.grasp_size_m, request.object_size_m)


DEFAULT = "paper"
"""The shipped cascade that `GraspSampler.pretrained()` loads."""


def shipped_folder(name: str = "default") -> Path:
    """Locate the folder of a shipped cascade.

    Raises:
        InputError: no cascade of that name is shipped.
    """
    shipped = shipped_folders()
    if name not in shipped:
        raise unknown("model", name, shipped)
    return shipped[name]


def shipped_folders() -> dict[str, Path]:
    """List the folders of the shipped cascades by name, "default" first."""
    weights = Path(str(files("graspcascade.proposals.cascade") / "weights"))
    shipped = {folder.name: folder for folder in sorted(weights.iterdir()) if folder.is_dir()}
    return {"default": shipped[DEFAULT], **shipped}


def _measured(path: Path, sampler: GraspSampler) -> dict[str, dict[str, Any]]:
    """Read the counts of an evaluation file, nothing where there is none or its grasps were ranked.

    Raises:
        FileFormatError: the file is no evaluation, or names other weights or another choice of sizes.
    """
    if not path.is_file():
        return {}
    try:
        data = read_json(path)
        about = data.get("model_metadata", {})
        if "ranking" in about:
            # Rates of grasps that a scorer chose say nothing of the others.
            return {}
        weights, sizes = about.get("weights"), about.get("sizes", sampler.size_mode)
        protocol, rates = str(data["protocol"]), {}
        for cell in data["cells"]:
            counts = {"held": int(cell["held"]), "n": int(cell["n"]), "protocol": protocol}
            rates[f"{cell['grasp_type']}/{cell['object']}"] = counts
    except (ValueError, KeyError, TypeError, AttributeError, OSError) as error:
        raise FileFormatError(f"{path} is no evaluation of a cascade: {error}") from error
    if weights not in (None, sampler.fingerprint()):
        raise FileFormatError(f"{path} is of a cascade with weights {weights}, not {sampler.fingerprint()} beside it")
    if sizes != sampler.size_mode:
        raise FileFormatError(f"{path} is of grasps with sizes {sizes!r}, not {sampler.size_mode!r} as sampled here")
    return rates
