"""Hand files: ``hand.yaml`` beside its MJCF, read into a `Hand` and checked against the model."""

from __future__ import annotations

import math
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from ..core.errors import FileFormatError, InputError, check_name, nearest, shortened, unknown
from ..core.poses import Pose, quat_to_matrix, rotate
from ..core.taxonomy import DIGITS
from ..core.yaml_files import YAML_SUFFIXES, load_yaml
from .hand import Actuator, ContactPlace, Coupling, Digit, Hand, digest
from .kinematics import IDENTITY, Kinematics, Link, Vector

HAND_FILE = "hand.yaml"
_MOST_REACH_M, _FURTHEST_POINT_M = 0.25, 0.1
_ROUNDING_RAD = 0.01
"""An open hand may stand so far beyond a limit that another model of it rounds otherwise."""


class _Record(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    pass


class _Frame(_Record, frozen=True):
    body: str
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


class _Point(_Record, frozen=True):
    body: str
    point_m: Vector


class _Place(_Point, frozen=True):
    normal: Vector


class _Digit(_Record, frozen=True):
    root: str
    tip: _Point


class _HandFile(_Record, frozen=True):
    """Contents of a hand file; docs/own_hand.md says what each entry means."""

    name: str
    mjcf: str
    frame: _Frame
    joints: list[str | list[str]]
    digits: dict[str, _Digit]
    places: dict[str, _Place]
    reach_m: float
    palm_bodies: list[str]
    wrist_joints: list[str] = []
    couplings: dict[str, list[str]] = {}
    surface_points: dict[str, _Point] = {}
    pregrasp_rad: dict[str, float] = {}
    prefix: str = ""

    @property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(name for part in self.joints for name in ([part] if isinstance(part, str) else part))

    @property
    def points(self) -> dict[str, _Point]:
        """Points on bodies by the entry that names them."""
        tips = {f"digits.{name}.tip": digit.tip for name, digit in self.digits.items()}
        own = {f"surface_points.{name}": point for name, point in self.surface_points.items()}
        return {f"places.{name}": place for name, place in self.places.items()} | own | tips

    @property
    def bodies(self) -> dict[str, str]:
        """Bodies below the palm that the file speaks of, each with an entry that names it."""
        roots = {digit.root: f"digits.{name}.root" for name, digit in self.digits.items()}
        return {point.body: entry for entry, point in self.points.items()} | roots


def shipped_hands() -> dict[str, Path]:
    """List the hand files that come with the package, by short name."""
    assets = Path(str(files("graspcascade.hands") / "assets"))
    return {folder.name: folder / HAND_FILE for folder in sorted(assets.iterdir()) if (folder / HAND_FILE).is_file()}


def load_hand(hand: Hand | Path | str = "shadow") -> Hand:
    """Read a hand: one as it is, a shipped one by name (``shadow``), or a hand file (.yaml) by path.

    Raises:
        InputError: no such hand or file, or a model that cannot be used; one line says what to do.
        FileFormatError: the file is no hand file.
    """
    if isinstance(hand, Hand):
        return hand
    text, shipped = str(hand), shipped_hands()
    if text in shipped:
        return _read_shipped(shipped[text])
    path = Path(text)
    if text and (path / HAND_FILE).is_file():
        path /= HAND_FILE
    if path.suffix.lower() in (".xml", ".mjcf", ".urdf"):
        raise InputError(f"{path.name} is a model; give the hand file (.yaml) that says what its parts are")
    if path.suffix.lower() in YAML_SUFFIXES or path.is_file():
        return read_hand_file(path)
    known = shipped_hand(text)
    if known is not None:
        return known
    named = [_read_shipped(file).name for file in shipped.values()]
    raise InputError(f"{unknown('hand', text, [*shipped, *named])} Or give the path of a hand file (.yaml).")


def shipped_hand(name: str) -> Hand | None:
    """Load the shipped hand that grasps and models name, such as ``shadow_hand_right``; None where there is none."""
    shipped = shipped_hands()
    # Hands that are likely not the one need not be read to know.
    likely_first = sorted(shipped, key=lambda short: not name.startswith(short))
    return next((hand for hand in (_read_shipped(shipped[short]) for short in likely_first) if hand.name == name), None)


def executing_hand(own: Hand | str, given: Hand | Path | str | None = None) -> Hand:
    """Load the hand to execute grasps with: the one given, else their own, or the shipped one that they name.

    Raises:
        InputError: their hand is not shipped and none is given, or as `load_hand`.
    """
    if given is not None:
        return load_hand(given)
    if isinstance(own, Hand) and own.mjcf is not None:
        return own
    name = own.name if isinstance(own, Hand) else own
    shipped = load_hand(name) if name in shipped_hands() else shipped_hand(name)
    if shipped is None:
        raise InputError(f"hand {shortened(name)!r} is not shipped; give its file (--hand FILE, hand=load_hand(FILE))")
    return shipped


def read_hand_file(path: Path) -> Hand:
    """Read a hand file and the MJCF it names; errors are those of `load_hand`.

    An entry ``base: shadow`` takes everything that the file does not say from a shipped hand.
    """
    try:
        raw, folder = _raw(path)
        record = msgspec.convert(raw, _HandFile)
    except (msgspec.ValidationError, FileFormatError) as error:
        raise FileFormatError(f"{path}: not a hand file: {str(error)[:1000]}") from error
    try:
        return _build(record, folder / record.mjcf)
    except InputError as error:
        raise InputError(f"{path}: {str(error)[:1000]}") from error


_read_shipped = lru_cache(maxsize=8)(read_hand_file)


def _raw(path: Path) -> tuple[dict[str, Any], Path]:
    """Read a hand file's entries, those of its base included, and the folder that its MJCF's path starts from."""
    raw = load_yaml(path)
    if not isinstance(raw, dict):
        raise FileFormatError("it is no mapping of entries")
    base = raw.pop("base", None)
    if base is None:
        return raw, path.parent
    if not isinstance(base, str) or base not in shipped_hands():
        raise FileFormatError(str(unknown("base hand", base, shipped_hands())))
    taken, folder = _raw(shipped_hands()[base])
    return taken | raw, path.parent if "mjcf" in raw else folder


def read_spec(hand: Hand) -> Any:
    """Read a hand's MJCF as an editable MuJoCo spec; an InputError says that there is none or it cannot be read."""
    if hand.mjcf is None:
        raise InputError(f"hand {hand.name} came with a trained model and has no MJCF; load it from its hand file")
    return _parse(hand.mjcf)


def _parse(mjcf: Path) -> Any:
    # The engine is heavy to load and geometry from stored constants does not need it.
    import mujoco

    try:
        spec = mujoco.MjSpec.from_file(str(mjcf))
    except (ValueError, OSError) as error:
        raise InputError(f"cannot read hand model {mjcf}: {' '.join(str(error).split())}") from error
    # Worlds have other joints and sensors of their own: what is of no effect here must not stand in their way.
    for part in [*spec.keys, *spec.sensors, *(tie for tie in spec.equalities if not tie.active)]:
        spec.delete(part)
    return spec


def _build(record: _HandFile, mjcf: Path) -> Hand:
    _check_record(record)
    reader = _ModelReader(record, mjcf)
    model, palm = reader.model, reader.palm
    data = reader.mujoco.MjData(model)
    reader.mujoco.mj_kinematics(model, data)
    base = int(model.body_rootid[palm])
    X_body_hand = Pose.of([0.0, 0.0, 0.0], record.frame.quat_wxyz)
    X_world_hand = Pose.of(data.xpos[palm], data.xquat[palm]) @ X_body_hand
    limits, digits = reader.limits(), record.digits
    hand = Hand(
        name=record.name,
        mjcf=mjcf,
        prefix=record.prefix,
        body=record.frame.body,
        X_body_hand=X_body_hand,
        X_base_hand=Pose.of(data.xpos[base], data.xquat[base]).inverse() @ X_world_hand,
        wrist_joints=tuple(record.wrist_joints),
        joint_names=record.joint_names,
        lower_rad=limits[:, 0],
        upper_rad=limits[:, 1],
        kinematics=Kinematics(reader.links(X_body_hand)),
        digits={d: Digit(digits[d].root, digits[d].tip.body, digits[d].tip.point_m) for d in DIGITS if d in digits},
        couplings=reader.couplings(),
        actuators=tuple(reader.actuator(number) for number in range(model.nu)),
        palm_bodies=tuple(record.palm_bodies),
        places={name: ContactPlace(p.body, p.point_m, p.normal) for name, p in record.places.items()},
        surface_points={name: (p.body, p.point_m) for name, p in record.surface_points.items()},
        pregrasp_rad=record.pregrasp_rad,
        reach_m=record.reach_m,
        source=digest(msgspec.to_builtins(record) | {"mjcf": ""}, mjcf.read_bytes()),
    )
    _check_driven(hand)
    _check_orientation(hand)
    return hand


def _check_record(record: _HandFile) -> None:
    digits, joints = record.digits, record.joint_names
    for name in digits:
        check_name("digit", name, DIGITS)
    if "thumb" not in digits or "index" not in digits:
        raise InputError(f"digits need a thumb and at least one finger, named index first; got {', '.join(digits)}")
    shared = _repeated([digit.root for digit in digits.values()])
    if shared:
        raise InputError(f"two digits have the same root {', '.join(shared)}; each needs a first body of its own")
    twice = _repeated([*joints, *record.wrist_joints])
    if twice or not joints:
        raise InputError(f"joints must name each joint once, got {', '.join(twice) or 'none'} more than once or none")
    stray = sorted(set(record.pregrasp_rad) - set(joints))
    if stray:
        raise InputError(f"pregrasp_rad names {', '.join(stray)}, which joints does not list")
    if not record.palm_bodies or _repeated(record.palm_bodies):
        raise InputError(f"palm_bodies must name one body or more, each once, got {record.palm_bodies}")
    if not 0 < len(record.name.strip()) <= 100 or not record.name.isprintable():
        raise InputError(f"name must be 1 to 100 printable characters, got {record.name[:100]!r}")
    if not 0.001 <= record.reach_m <= _MOST_REACH_M:
        raise InputError(f"reach_m must be 0.001 to {_MOST_REACH_M} m, got {record.reach_m:g}")
    for name, place in record.places.items():
        length = math.hypot(*place.normal)
        if not abs(length - 1.0) <= 1e-3:
            raise InputError(f"the normal of {name} has length {length:.3g}; it must be 1")
    for entry, point in record.points.items():
        far = math.hypot(*point.point_m)
        if not far <= _FURTHEST_POINT_M:
            hint = "; this looks like millimetres" if far > 1.0 else ""
            raise InputError(
                f"point_m of {entry} is {far:g} m from its body's origin, not within {_FURTHEST_POINT_M} m{hint}"
            )


def _repeated(names: list[str] | tuple[str, ...]) -> list[str]:
    return sorted({name for name in names if names.count(name) > 1})


class _ModelReader:
    """Reads a hand's compiled model, naming its parts without the prefix."""

    def __init__(self, record: _HandFile, mjcf: Path) -> None:
        import mujoco

        self.mujoco: Any = mujoco
        self.record = record
        spec = _parse(mjcf)
        try:
            self.model = model = spec.compile()
        except ValueError as error:
            raise InputError(f"cannot compile hand model {mjcf}: {' '.join(str(error).split())}") from error
        prefix, missing = record.prefix, []
        has = {kind: [part.name for part in getattr(spec, kind)] for kind in ("bodies", "geoms", "joints")}
        has["couplings"] = [part.name for part in [*spec.tendons, *spec.equalities]]
        named = dict.fromkeys(record.palm_bodies, "palm_bodies") | record.bodies | {record.frame.body: "frame.body"}
        needed = {
            "joints": dict.fromkeys(record.wrist_joints, "wrist_joints") | dict.fromkeys(record.joint_names, "joints"),
            "bodies": dict(sorted(named.items())),
            "couplings": dict.fromkeys(record.couplings, "couplings"),
        }
        for kind, entries in needed.items():
            for name, entry in entries.items():
                if prefix + name not in has[kind]:
                    near = nearest(prefix + name, has[kind])
                    missing.append(f"{name} (of {entry}{f'; did you mean {near!r}?' if near else ''})")
        if missing:
            more = f" and {len(missing) - 4} more" if len(missing) > 4 else ""
            raise InputError(f"hand model {mjcf.name} lacks {', '.join(missing[:4])}{more} (prefix {prefix!r})")
        taken = [kind for kind in ("bodies", "geoms", "joints") if "object" in has[kind]]
        if taken:
            raise InputError(
                f"hand model {mjcf.name} has {taken[0]} named 'object', as trials call theirs; rename them"
            )
        self.palm = int(model.body(prefix + record.frame.body).id)
        # Trials bring their own object and nothing else.
        root, loose = model.body_rootid[self.palm], (int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL))
        foreign = [model.body(b).name or f"body {b}" for b in range(1, model.nbody) if model.body_rootid[b] != root]
        foreign += [model.geom(g).name or "a geom of the world" for g in range(model.ngeom) if not model.geom_bodyid[g]]
        foreign += [model.joint(j).name or "a free joint" for j in range(model.njnt) if model.jnt_type[j] in loose]
        if foreign:
            scene = f"hand model {mjcf.name} is a scene: it also holds {', '.join(foreign[:4])}"
            raise InputError(f"{scene}; give the MJCF of the hand alone, fixed to the world")

    def name(self, kind: str, number: Any) -> str:
        return str(getattr(self.model, kind)(int(number)).name.removeprefix(self.record.prefix))

    def limits(self) -> NDArray[np.float64]:
        limits = []
        for name in self.record.joint_names:
            joint = self.model.joint(self.record.prefix + name)
            low, high = joint.range.tolist()
            if not self.model.jnt_limited[joint.id] or not low < high:
                raise InputError(f'joint {name} has no range; give it one in the MJCF (range="low high")')
            angle = self.record.pregrasp_rad.get(name)
            if angle is not None and not low - _ROUNDING_RAD <= angle <= high + _ROUNDING_RAD:
                hint = "; this looks like degrees" if abs(angle) > np.pi else ""
                raise InputError(
                    f"pregrasp_rad of {name} is {angle:g} rad, not within {low:.4g} to {high:.4g} rad{hint}"
                )
            limits.append((low, high))
        names = [self.name("joint", number) for number in range(self.model.njnt)]
        listed = (*self.record.joint_names, *self.record.wrist_joints)
        stray = ", ".join(name or "one without a name" for name in names if name not in listed)
        if stray:
            unlisted = f"the model has joints that neither joints nor wrist_joints lists: {stray}"
            raise InputError(f"{unlisted}; list them, or take them out of the MJCF")
        return np.array(limits)

    def links(self, X_body_hand: Pose) -> tuple[Link, ...]:
        record, palm = self.record, self.palm
        links, below = [Link(record.frame.body, None, (0.0, 0.0, 0.0), IDENTITY)], {palm}
        for body in range(palm + 1, self.model.nbody):
            if int(self.model.body_parentid[body]) in below:
                below.add(body)
                links.append(self._link(body, X_body_hand))
        tree = Kinematics(tuple(links))
        outside = sorted(record.bodies.keys() - {link.name for link in links})
        if outside:
            raise InputError(f"{', '.join(outside)} does not hang from the palm body {record.frame.body!r}")
        above = sorted(set(record.joint_names) - {link.joint for link in links})
        if above:
            raise InputError(f"{', '.join(above)} moves no part below the palm; list it under wrist_joints")
        lines = {name: tree.ancestry([digit.root]) for name, digit in record.digits.items()}
        shared = set.intersection(*lines.values())
        wrist = [
            link.joint
            for link in links[1:]
            if link.joint in record.wrist_joints or (link.joint and link.name in shared)
        ]
        if wrist:
            todo = "give as frame.body the last body that they move, and list them under wrist_joints"
            raise InputError(
                f"{', '.join(map(str, wrist))} moves the wrist below the palm body {record.frame.body!r}; {todo}"
            )
        for name, place in record.places.items():
            digit_root = record.digits[named].root if (named := name.partition("_")[0]) in record.digits else place.body
            if digit_root not in tree.ancestry([place.body]):
                raise InputError(f"{name} is on {place.body}, which does not hang from the {named}'s root {digit_root}")
            # Of a convex body every outward normal points away from the centre of mass.
            if np.dot(place.normal, place.point_m - self.model.body(record.prefix + place.body).ipos) < 0.0:
                raise InputError(f"the normal of {name} points into {place.body}; it must point out of the surface")
        for part in record.palm_bodies:
            of = [name for name, digit in record.digits.items() if digit.root in tree.ancestry([part])]
            if of or part == "world":
                raise InputError(f"palm_bodies names {part}, which is of {f'the {of[0]}' if of else 'no hand'}")
        for name, digit in record.digits.items():
            if digit.root not in tree.ancestry([digit.tip.body]):
                tip = f"the tip of the {name} is on {digit.tip.body}"
                raise InputError(f"{tip}, which does not hang from its root {digit.root}")
            for other, upper in record.digits.items():
                if other != name and upper.root in lines[name]:
                    below_other = f"the {name} hangs from the {other}"
                    raise InputError(f"{below_other}; each digit needs a root of its own at the palm")
        return tree.links

    def _link(self, body: int, X_body_hand: Pose) -> Link:
        model, name, parent = self.model, self.name("body", body), int(self.model.body_parentid[body])
        if model.body_jntnum[body] > 1:
            raise InputError(f"body {name} has {model.body_jntnum[body]} joints; one hinge at most is supported")
        flat = np.zeros(9)
        self.mujoco.mju_quat2Mat(flat, model.body_quat[body])
        matrix, position = flat.reshape(3, 3), model.body_pos[body]
        if parent == self.palm and abs(X_body_hand.quat_wxyz[0]) < 1.0:
            inverse = X_body_hand.inverse()
            matrix, position = quat_to_matrix(inverse.quat_wxyz) @ matrix, rotate(inverse.quat_wxyz, position)
        joint, axis = None, np.array([1.0, 0.0, 0.0])
        if model.body_jntnum[body]:
            index = model.body_jntadr[body]
            joint, axis = self.name("joint", index), model.jnt_axis[index]
            if model.jnt_type[index] != self.mujoco.mjtJoint.mjJNT_HINGE or np.abs(model.jnt_pos[index]).max() > 1e-9:
                raise InputError(f"joint {joint} is not a hinge at the origin of its body; nothing else is supported")
        rows = tuple(map(tuple, matrix.tolist()))
        return Link(name, self.name("body", parent), tuple(position.tolist()), rows, joint, tuple(axis.tolist()))

    def couplings(self) -> tuple[Coupling, ...]:
        """Read the couplings of posture joints, and check that they are those the file names."""
        model, joints, couplings = self.model, self.record.joint_names, []
        by_tendon = np.asarray(model.actuator_trntype) == int(self.mujoco.mjtTrn.mjTRN_TENDON)
        for tendon in sorted(set(model.actuator_trnid[by_tendon, 0].tolist())):
            weights = self._tendon_weights(tendon)
            if len(weights) > 1 and set(weights) <= set(joints):
                order = tuple(joint for joint in joints if joint in weights)
                factors = tuple(weights[joint] for joint in order)
                couplings.append(Coupling(self.name("tendon", tendon), "tendon", order, factors))
        for number in range(model.neq):
            name, ids = self.name("equality", number), (model.eq_obj1id[number], model.eq_obj2id[number])
            of_two = model.eq_type[number] == self.mujoco.mjtEq.mjEQ_JOINT and min(ids) >= 0
            pair = tuple(self.name("joint", joint) for joint in ids) if of_two else ()
            if not pair or not set(pair) <= set(joints):
                what = f"equality {name or number} does not tie one joint of a posture to another"
                raise InputError(f"{what}; nothing else is supported: take it out of the MJCF")
            polynomial = tuple(model.eq_data[number, :5].tolist())
            couplings.append(Coupling(name or "/".join(pair), "equality", pair, polynomial))
        tied = {coupling.name: set(coupling.joints) for coupling in couplings}
        for name, named in self.record.couplings.items():
            if tied.get(name) != set(named):
                has = ", ".join(sorted(tied.get(name, ()))) or "no actuator"
                raise InputError(
                    f"coupling {name} is of {', '.join(named)} in the hand file; in the model it has {has}"
                )
        return tuple(couplings)

    def _tendon_weights(self, tendon: int) -> dict[str, float]:
        model, first = self.model, int(self.model.tendon_adr[tendon])
        wraps = range(first, first + int(model.tendon_num[tendon]))
        if any(model.wrap_type[wrap] != self.mujoco.mjtWrap.mjWRAP_JOINT for wrap in wraps):
            name = self.name("tendon", tendon)
            raise InputError(f"tendon {name} runs through space; only fixed tendons over joints are supported")
        return {self.name("joint", model.wrap_objid[wrap]): float(model.wrap_prm[wrap]) for wrap in wraps}

    def actuator(self, number: int) -> Actuator:
        model, mujoco, name = self.model, self.mujoco, self.name("actuator", number)
        if not name or not model.actuator(number).name.startswith(self.record.prefix):
            begins = f" that begins with {self.record.prefix!r}" if self.record.prefix else ""
            raise InputError(f"actuator {name or f'number {number}'} of the MJCF needs a name{begins}")
        target, gear = int(model.actuator_trnid[number, 0]), float(model.actuator_gear[number, 0])
        kind = model.actuator_trntype[number]
        if kind == mujoco.mjtTrn.mjTRN_TENDON:
            weights = {joint: gear * weight for joint, weight in self._tendon_weights(target).items()}
        elif kind == mujoco.mjtTrn.mjTRN_JOINT:
            weights = {self.name("joint", target): gear}
        else:
            raise InputError(f"actuator {name} drives neither a joint nor a fixed tendon; nothing else is supported")
        if not all(weights.values()):
            still = ", ".join(joint for joint, weight in weights.items() if not weight)
            raise InputError(f"actuator {name} does not move {still}: its gear, or the tendon's coefficient, is 0")
        gain, bias = float(model.actuator_gainprm[number, 0]), float(model.actuator_biasprm[number, 1])
        fixed = model.actuator_gaintype[number] == mujoco.mjtGain.mjGAIN_FIXED
        affine = model.actuator_biastype[number] == mujoco.mjtBias.mjBIAS_AFFINE
        direct = model.actuator_dyntype[number] == mujoco.mjtDyn.mjDYN_NONE
        if not (fixed and affine and direct and gain > 0 and abs(bias + gain) <= 1e-6 * gain):
            kinds = "a motor, a velocity actuator, or one with a time constant"
            wrong = f"actuator {name} is no position servo ({kinds}); postures are joint targets"
            raise InputError(f"{wrong}: make it <position name={name!r} kp=... />")
        low, high = (
            model.actuator_ctrlrange[number].tolist() if model.actuator_ctrllimited[number] else (-np.inf, np.inf)
        )
        force = float(model.actuator_forcerange[number, 1]) if model.actuator_forcelimited[number] else np.inf
        return Actuator(name, weights, low, high, gain, force)


def _check_driven(hand: Hand) -> None:
    driven = [joint for actuator in hand.actuators for joint in actuator.weights]
    leader = {c.joints[0]: c.joints[1] for c in hand.couplings if c.kind == "equality"}
    idle = ", ".join(name for name in hand.joint_names if name not in driven and leader.get(name) not in driven)
    if idle:
        todo = "add <position joint=... /> to the MJCF, or couple them to a joint that has one"
        raise InputError(f"joints {idle} have no actuator; {todo}")
    for joint in leader.values():
        if joint in leader:
            raise InputError(f"joint {joint} follows another and is followed; tie both to the driven joint")
    twice = _repeated([*driven, *(c.joints[0] for c in hand.couplings if c.kind == "equality")])
    if twice:
        raise InputError(f"joint {twice[0]} is driven twice, by actuators or by following another; keep one of them")


def _check_orientation(hand: Hand) -> None:
    """Check that fingers point along z of the hand frame, pads face -y and the thumb is on the +x side."""
    straight = np.zeros((1, len(hand.joint_names)))
    frames, tips = hand.frames(straight), hand.tips(straight, list(hand.digits))
    roots = {name: frames[digit.root][1][0] for name, digit in hand.digits.items()}
    along = np.mean([tips[name][0] - roots[name] for name in hand.fingers], axis=0)
    if int(np.argmax(np.abs(along))) != 2 or along[2] <= 0:
        pointing = f"the straight fingers point along {np.round(along / np.linalg.norm(along), 2).tolist()}"
        todo = "give frame.quat_wxyz, the rotation of the hand frame in the palm body"
        raise InputError(f"{pointing} of the hand frame, not along z; {todo}")
    places = [name for name in hand.places if name.partition("_")[0] in hand.fingers]
    for name, place in hand.place_points(straight, places).items():
        if place.normal[0, 1] > (0.1 if name.endswith("_end") else -0.1):  # an end may face along the finger
            facing = f"the place {name} faces {np.round(place.normal[0], 2).tolist()} of the hand frame, not -y"
            raise InputError(f"{facing}; turn frame.quat_wxyz or correct its normal")
    if roots["thumb"][0] <= np.mean([roots[name][0] for name in hand.fingers]):
        wrong = "this is a left hand, or frame.quat_wxyz is wrong; only right hands are supported"
        raise InputError(f"the thumb is on the -x side of the hand frame: {wrong}")
