"""Stages and factorizations as data: what each conditional VAE generates, and from what.

The paper's models 1 to 3, its plain-network rotation head and its variants 1 to 7 (Tables I to III) are values here;
nothing else in the package tells them apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

from ..errors import check_name

Target = Literal["posture", "position", "rotation"]
Quantity = Literal["posture", "position", "grasp_type", "grasp_size", "object_type", "object_size"]
Frame = Literal["opposition", "hand"]
RotationHead = Literal["vmf", "vmf_mixture", "unit"]


@dataclass(frozen=True)
class Stage:
    """Describe one conditional VAE of a cascade.

    Attributes:
        name: names its tensors and its training curve.
        targets: what it generates, in the order of its outputs.
        given: the quantities it is conditioned on; earlier stages' targets by their names.
        rotation_head: "vmf" draws rotations from a von Mises-Fisher distribution, "vmf_mixture" from a mixture of some,
            "unit" normalises a plain output.
        latent_dim: length of the latent vector.
        hidden: widths of the hidden layers.
        kl_weight: weight of the divergence term.

    Raises:
        InputError: an unknown target, quantity or rotation head.
    """

    name: str
    targets: tuple[Target, ...]
    given: tuple[Quantity, ...]
    rotation_head: RotationHead = "vmf"
    latent_dim: int = 4
    hidden: tuple[int, ...] = (256, 256)
    kl_weight: float = 0.5

    def __post_init__(self) -> None:
        for kind, names, valid in (
            ("target", self.targets, Target),
            ("quantity", self.given, Quantity),
            ("rotation head", (self.rotation_head,), RotationHead),
        ):
            for name in names:
                check_name(kind, name, get_args(valid))


@dataclass(frozen=True)
class Factorization:
    """Describe how the distribution of grasps is divided into stages.

    Attributes:
        name: identifier on the command line and in files.
        stages: in sampling order.
        frame: poses are learned in the "hand" frame, or relative to the "opposition" frame, which forward kinematics
            gives for every posture.
        source: the table row of the paper it reproduces.

    Raises:
        InputError: an unknown frame.
    """

    name: str
    stages: tuple[Stage, ...]
    frame: Frame = "hand"
    source: str = ""

    def __post_init__(self) -> None:
        check_name("frame", self.frame, get_args(Frame))


_ALL: tuple[Quantity, ...] = ("grasp_type", "grasp_size", "object_type", "object_size")
_POSTURE = Stage("posture", ("posture",), ("grasp_type", "grasp_size", "object_type"), latent_dim=10)


def _three_stages(
    name: str,
    position: tuple[Quantity, ...],
    rotation: tuple[Quantity, ...],
    source: str,
    *,
    rotation_head: RotationHead = "vmf",
    frame: Frame = "hand",
) -> Factorization:
    return Factorization(
        name,
        (
            _POSTURE,
            Stage("position", ("position",), ("posture", *position), hidden=(128, 128)),
            Stage("rotation", ("rotation",), ("position", "posture", *rotation), rotation_head=rotation_head),
        ),
        frame,
        source,
    )


_VALUES = (
    Factorization(
        "model1", (Stage("grasp", ("posture", "position", "rotation"), _ALL, latent_dim=14),), source="Table I"
    ),
    Factorization(
        "model2",
        (_POSTURE, Stage("pose", ("position", "rotation"), ("posture", *_ALL), latent_dim=6)),
        source="Table I",
    ),
    _three_stages("model3", _ALL, _ALL, "Tables I and II, Table III variant 1"),
    _three_stages(
        "model3_opposition_frame", _ALL, _ALL, "model3 with poses learned in the opposition frame", frame="opposition"
    ),
    _three_stages("plain_rotation", _ALL, _ALL, "Table II", rotation_head="unit"),
    _three_stages("variant2", _ALL, ("grasp_type", "object_type", "object_size"), "Table III"),
    _three_stages(
        "variant3",
        ("grasp_type", "grasp_size", "object_type"),
        ("grasp_type", "object_type", "object_size"),
        "Table III",
    ),
    _three_stages(
        "variant4",
        ("grasp_type", "object_type", "object_size"),
        ("grasp_type", "object_type", "object_size"),
        "Table III",
    ),
    _three_stages("variant5", ("grasp_type", "object_type"), ("grasp_type", "object_type"), "Table III"),
    _three_stages(
        "variant6",
        ("grasp_size", "object_type", "object_size"),
        ("grasp_size", "object_type", "object_size"),
        "Table III",
    ),
    _three_stages(
        "variant7",
        ("grasp_type", "grasp_size", "object_size"),
        ("grasp_type", "grasp_size", "object_size"),
        "Table III",
    ),
)

FACTORIZATIONS: Mapping[str, Factorization] = {value.name: value for value in _VALUES}
"""Every factorization by name."""


def factorization(name: str) -> Factorization:
    """Look up a factorization.

    Raises:
        InputError: the name is not one of `FACTORIZATIONS`.
    """
    check_name("factorization", name, FACTORIZATIONS)
    return FACTORIZATIONS[name]


def factorization_from_json(data: dict[str, Any]) -> Factorization:
    """Rebuild a factorization from `dataclasses.asdict`, also after a way through JSON.

    Raises:
        KeyError, TypeError: a field is missing or unknown.
        InputError: a name is unknown.
    """

    def stage(fields: dict[str, Any]) -> Stage:
        named: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in fields.items()}
        return Stage(**named)

    stages = tuple(stage(fields) for fields in data["stages"])
    return Factorization(data["name"], stages, data["frame"], data["source"])
