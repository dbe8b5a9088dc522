"""Stages and factorizations as data: what each conditional VAE generates, and from what.

The paper's models 1 to 3, its plain-network rotation head and its variants 1 to 7 (Tables I to III) are values here;
nothing else in the package tells them apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

from ...core.errors import check_name

Target = Literal["posture", "position", "rotation"]
Quantity = Literal["posture", "position", "grasp_type", "grasp_size", "object_type", "object_size"]
Frame = Literal["opposition", "hand"]
ObjectCode = Literal["label", "site"]
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

    Examples:
        >>> Stage("rotation", ("rotation",), ("position", "posture", "grasp_type"), rotation_head="vmf_mixture").hidden
        (256, 256)
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
        object_code: how objects are told apart: by "label", one of the catalogue's nine as in the paper, or by "site",
            what any primitive is where it is held: kind, width, and extents across. Rotations are then those of the
            site (see `encoding.site_frame`).

    Raises:
        InputError: an unknown frame or object code.

    Examples:
        >>> [stage.name for stage in FACTORIZATIONS["any_size"].stages]
        ['posture', 'position', 'rotation']
    """

    name: str
    stages: tuple[Stage, ...]
    frame: Frame = "hand"
    source: str = ""
    object_code: ObjectCode = "label"

    def __post_init__(self) -> None:
        check_name("frame", self.frame, get_args(Frame))
        check_name("object code", self.object_code, get_args(ObjectCode))

    @property
    def asks_sizes(self) -> bool:
        """Whether a grasp size or object size must be chosen for every request."""
        return any(name in ("grasp_size", "object_size") for stage in self.stages for name in stage.given)


_ALL: tuple[Quantity, ...] = ("grasp_type", "grasp_size", "object_type", "object_size")
_TYPE_AND_OBJECT: tuple[Quantity, ...] = ("grasp_type", "object_type")
_ALL_BUT_GRASP_SIZE: tuple[Quantity, ...] = ("grasp_type", "object_type", "object_size")
_POSTURE = Stage("posture", ("posture",), ("grasp_type", "grasp_size", "object_type"), latent_dim=10)


def _three_stages(
    name: str,
    position: tuple[Quantity, ...],
    rotation: tuple[Quantity, ...],
    source: str,
    *,
    head: RotationHead = "vmf",
    frame: Frame = "hand",
    code: ObjectCode = "label",
    posture: Stage = _POSTURE,
    rotation_hidden: tuple[int, ...] = (256, 256),
) -> Factorization:
    given: tuple[Quantity, ...] = ("position", "posture", *rotation)
    stages = (
        posture,
        Stage("position", ("position",), ("posture", *position), hidden=(128, 128)),
        Stage("rotation", ("rotation",), given, rotation_head=head, hidden=rotation_hidden),
    )
    return Factorization(name, stages, frame, source, code)


_ONE = Stage("grasp", ("posture", "position", "rotation"), _ALL, latent_dim=14)
_POSE = Stage("pose", ("position", "rotation"), ("posture", *_ALL), latent_dim=6)
_IN_OPPOSITION_FRAME = "model3 with poses learned in the opposition frame"
_BY_SITE = "model3 with objects told apart by what they are where they are held"
_POSTURE_BY_SITE = replace(_POSTURE, given=_TYPE_AND_OBJECT, hidden=(256, 128))
_ALL_BUT_TYPE: tuple[Quantity, ...] = ("grasp_size", "object_type", "object_size")
_ALL_BUT_OBJECT: tuple[Quantity, ...] = ("grasp_type", "grasp_size", "object_size")
_VALUES = (
    Factorization("model1", (_ONE,), source="Table I"),
    Factorization("model2", (_POSTURE, _POSE), source="Table I"),
    _three_stages("model3", _ALL, _ALL, "Tables I and II, Table III variant 1"),
    _three_stages("model3_opposition_frame", _ALL, _ALL, _IN_OPPOSITION_FRAME, frame="opposition"),
    _three_stages(
        "any_size",
        _TYPE_AND_OBJECT,
        _TYPE_AND_OBJECT,
        _BY_SITE,
        frame="opposition",
        code="site",
        posture=_POSTURE_BY_SITE,
        rotation_hidden=(192, 128),
    ),
    _three_stages("plain_rotation", _ALL, _ALL, "Table II", head="unit"),
    _three_stages("variant2", _ALL, _ALL_BUT_GRASP_SIZE, "Table III"),
    _three_stages("variant3", ("grasp_type", "grasp_size", "object_type"), _ALL_BUT_GRASP_SIZE, "Table III"),
    _three_stages("variant4", _ALL_BUT_GRASP_SIZE, _ALL_BUT_GRASP_SIZE, "Table III"),
    _three_stages("variant5", _TYPE_AND_OBJECT, _TYPE_AND_OBJECT, "Table III"),
    _three_stages("variant6", _ALL_BUT_TYPE, _ALL_BUT_TYPE, "Table III"),
    _three_stages("variant7", _ALL_BUT_OBJECT, _ALL_BUT_OBJECT, "Table III"),
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
