"""The hand: kinematics and actuation against the reference, contact places on the surface, other models of it."""

import csv
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from graspcascade.core.distances import signed_distances
from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.objects import Box, as_object
from graspcascade.core.poses import canonical_quat, quat_conjugate, quat_multiply, quat_to_matrix, rotate
from graspcascade.core.protocols import PAPER
from graspcascade.core.taxonomy import AREAS, DIGITS, FEIX_TYPES, GRASP_TYPES
from graspcascade.hands import Hand, Kinematics, load_hand, read_spec
from graspcascade.hands.kinematics import Link
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.worlds.world import build_world
from hand_files import SHADOW_FILE, SHADOW_MJCF, actuator_line, edited, shadow_entries, write_hand

DATA = Path(__file__).parent / "data"
HAND = load_hand("shadow")
JOINTS = HAND.joint_names
LINKS = tuple(f"{f}{part}" for f in ("ff", "mf", "rf", "lf") for part in ("knuckle", "proximal", "middle", "distal"))
LINKS += ("lfmetacarpal", "thbase", "thproximal", "thhub", "thmiddle", "thdistal")
postures = hnp.arrays(float, (len(JOINTS),), elements=st.floats(-2.0, 2.0))

MESH_HAND = os.environ.get("GRASPCASCADE_MESH_HAND")
with_mesh_hand = pytest.mark.skipif(MESH_HAND is None, reason="GRASPCASCADE_MESH_HAND names no MJCF of the mesh hand")


def read_rows(name: str) -> list[dict[str, str]]:
    with (DATA / name).open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def reference() -> dict[str, np.ndarray]:
    rows = read_rows("shadow_hand_fk.csv")
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


@pytest.fixture(scope="module")
def reference_posture(reference: dict[str, np.ndarray]) -> np.ndarray:
    return np.stack([reference[f"{name}_rad"] for name in JOINTS], axis=1)


@pytest.fixture(scope="module")
def model() -> Any:
    return read_spec(HAND).compile()


def engine_frames(model: Any, angles: dict[str, np.ndarray], prefix: str = "") -> dict[str, tuple[np.ndarray, ...]]:
    """Compute link frames in the palm frame with the physics engine."""
    data = mujoco.MjData(model)
    n = len(next(iter(angles.values())))
    frames = {name: (np.zeros((n, 3, 3)), np.zeros((n, 3))) for name in LINKS}
    for row in range(n):
        for name, values in angles.items():
            data.joint(prefix + name).qpos[0] = values[row]
        mujoco.mj_kinematics(model, data)
        palm = data.body(prefix + "palm")
        turn, origin = palm.xmat.reshape(3, 3), palm.xpos
        for name, (rotation, position) in frames.items():
            body = data.body(prefix + name)
            rotation[row] = turn.T @ body.xmat.reshape(3, 3)
            position[row] = turn.T @ (body.xpos - origin)
    return frames


def assert_matches_reference(frames: dict[str, tuple[np.ndarray, ...]], reference: dict[str, np.ndarray]) -> None:
    for link in LINKS:
        rotation, origin = frames[link]
        expected_mm = np.stack([reference[f"{link}_{axis}_mm"] for axis in "xyz"], axis=1)
        expected_turn = quat_to_matrix(np.stack([reference[f"{link}_q{c}"] for c in "wxyz"], axis=1))
        assert np.linalg.norm(origin * 1000 - expected_mm, axis=1).max() < 0.05, link
        difference = np.swapaxes(expected_turn, 1, 2) @ rotation
        skew = difference - np.swapaxes(difference, 1, 2)
        sine = np.linalg.norm(np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1), axis=1) / 2
        cosine = (np.trace(difference, axis1=1, axis2=2) - 1) / 2
        assert np.degrees(np.arctan2(sine, cosine)).max() < 0.01, link


# Kinematics


def test_numpy_kinematics_match_the_reference_hand_on_every_row(
    hand: Hand, reference: dict[str, np.ndarray], reference_posture: np.ndarray
) -> None:
    assert len(reference_posture) == 200
    assert_matches_reference(hand.frames(reference_posture), reference)


def test_the_engine_matches_the_reference_hand_on_every_row_whatever_the_wrist_does(
    model: Any, reference: dict[str, np.ndarray]
) -> None:
    angles = {name.removesuffix("_rad"): values for name, values in reference.items() if name.endswith("_rad")}
    assert "WRJ1" in angles
    assert np.abs(angles["WRJ1"]).max() > 0.1
    assert_matches_reference(engine_frames(model, angles), reference)


def test_numpy_kinematics_equal_the_engine(hand: Hand, model: Any, reference_posture: np.ndarray) -> None:
    theirs = engine_frames(model, dict(zip(JOINTS, reference_posture.T, strict=True)))
    ours = hand.frames(reference_posture)
    for link in LINKS:
        for mine, other in zip(ours[link], theirs[link], strict=True):
            np.testing.assert_allclose(mine, other, rtol=0, atol=1e-10)


@given(posture=postures)
def test_frames_are_rigid_and_a_batch_equals_its_rows(posture: np.ndarray) -> None:
    both = HAND.frames(np.stack([posture, 0 * posture]))
    for link, (rotation, origin) in HAND.frames(posture).items():
        np.testing.assert_allclose(rotation[0] @ rotation[0].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation[0]) == pytest.approx(1)
        np.testing.assert_array_equal(both[link][0][0], rotation[0])
        np.testing.assert_array_equal(both[link][1][0], origin[0])


def test_frames_of_some_bodies_equal_those_of_all(hand: Hand, reference_posture: np.ndarray) -> None:
    everything = hand.frames(reference_posture[:3])
    some = hand.frames(reference_posture[:3], ["thdistal"])
    assert set(some) == {"palm", "thbase", "thproximal", "thhub", "thmiddle", "thdistal"}
    for name, (rotation, origin) in some.items():
        np.testing.assert_array_equal(rotation, everything[name][0])
        np.testing.assert_array_equal(origin, everything[name][1])


def test_kinematics_survive_json(hand: Hand, reference_posture: np.ndarray) -> None:
    text = json.dumps(hand.kinematics.to_json(), allow_nan=False)
    again = Kinematics.from_json(json.loads(text))
    assert again == hand.kinematics
    angles = dict(zip(JOINTS, reference_posture.T, strict=True))
    for name, (rotation, origin) in again.frames(angles).items():
        np.testing.assert_array_equal(rotation, hand.frames(reference_posture)[name][0])
        np.testing.assert_array_equal(origin, hand.frames(reference_posture)[name][1])


def test_the_forearm_is_a_wrist_below_the_palm(hand: Hand) -> None:
    np.testing.assert_allclose(hand.X_base_hand.position_m, [0.0, -0.01, 0.24701], atol=1e-9)
    np.testing.assert_allclose(hand.X_base_hand.quat_wxyz, [1, 0, 0, 0], atol=1e-12)


def test_a_posture_of_another_width_is_refused(hand: Hand) -> None:
    with pytest.raises(InputError, match="22 joints, got 24"):
        hand.frames(np.zeros((1, 24)))


# Joints and actuators against the reference table


@pytest.mark.parametrize("row", read_rows("shadow_hand_joints.csv"), ids=lambda row: row["joint"])
def test_joint_and_actuator_follow_the_reference_table(model: Any, row: dict[str, str]) -> None:
    joint, actuator = model.joint(row["joint"]), model.actuator(row["actuator"])
    limits = [float(row["lower_deg"]), float(row["upper_deg"])]
    np.testing.assert_allclose(np.degrees(joint.range), limits, atol=1e-9)
    assert joint.limited[0]
    dof = joint.dofadr[0]
    assert model.dof_damping[dof] == pytest.approx(float(row["damping"]))
    assert model.dof_armature[dof] == pytest.approx(float(row["armature"]))
    assert model.dof_frictionloss[dof] == 0
    gain, force = float(row["position_gain_Nm_per_rad"]), float(row["force_limit_Nm"])
    assert actuator.gainprm[0] == pytest.approx(gain)
    assert actuator.biasprm[1] == pytest.approx(-gain)
    np.testing.assert_allclose(actuator.forcerange, [-force, force])
    coupled = row["joint"] != row["actuator"]
    sum_limits = np.degrees(actuator.ctrlrange)
    np.testing.assert_allclose(sum_limits, [2 * limit for limit in limits] if coupled else limits, atol=1e-9)


def test_twenty_four_joints_hang_on_twenty_actuators(model: Any, hand: Hand) -> None:
    rows = read_rows("shadow_hand_joints.csv")
    assert model.nq == model.nv == len(rows) == 24
    assert model.nu == len({row["actuator"] for row in rows}) == 20
    assert {row["joint"] for row in rows} == {*JOINTS, *HAND.wrist_joints}
    for coupling in HAND.couplings:
        assert coupling.kind == "tendon"
        assert coupling.coefficients == (1.0, 1.0)
        assert coupling.joints == tuple(row["joint"] for row in rows if row["actuator"] == coupling.name)


def test_limits_are_the_reference_limits_in_joint_order(hand: Hand) -> None:
    table = {row["joint"]: row for row in read_rows("shadow_hand_joints.csv")}
    np.testing.assert_allclose(np.degrees(hand.lower_rad), [float(table[n]["lower_deg"]) for n in JOINTS], atol=1e-9)
    np.testing.assert_allclose(np.degrees(hand.upper_rad), [float(table[n]["upper_deg"]) for n in JOINTS], atol=1e-9)


def test_the_pregrasp_is_flat_open_with_the_thumb_out_of_the_way(hand: Hand) -> None:
    opened = dict(zip(JOINTS, hand.pregrasp, strict=True))
    assert {name for name, angle in opened.items() if angle} == {"THJ4"}
    np.testing.assert_array_equal(hand.clip(hand.pregrasp), hand.pregrasp)
    assert hand.grasp_size(hand.pregrasp)[0] > 0.08


# What a tendon does to a command


@given(posture=postures)
def test_sharing_keeps_each_tendons_sum_and_every_other_joint(posture: np.ndarray) -> None:
    shared = HAND.share(posture)
    pairs = [[JOINTS.index(name) for name in pair] for pair in (coupling.joints for coupling in HAND.couplings)]
    for pair in pairs:
        assert shared[pair].sum() == pytest.approx(posture[pair].sum(), abs=1e-12)
        assert shared[pair[0]] == shared[pair[1]]
    free = [i for i in range(len(JOINTS)) if i not in np.ravel(pairs)]
    np.testing.assert_array_equal(shared[free], posture[free])


@given(posture=postures)
def test_an_executed_posture_is_within_limits_and_executes_as_itself(posture: np.ndarray) -> None:
    executed = HAND.executed(posture)
    assert (HAND.lower_rad <= executed).all()
    assert (executed <= HAND.upper_rad).all()
    np.testing.assert_array_equal(HAND.executed(executed), executed)


@given(posture=postures)
def test_executing_leaves_its_argument_alone(posture: np.ndarray) -> None:
    before = posture.copy()
    HAND.executed(posture)
    np.testing.assert_array_equal(posture, before)


# Contact places and fingertips


def signed_distance(model: Any, body: str, point: np.ndarray) -> float:
    """Measure how far a point of a body's frame is outside the union of the body's primitives."""
    nearest = np.inf
    for geom in range(model.ngeom):
        if model.body(model.geom_bodyid[geom]).name != body or not model.geom_contype[geom]:
            continue
        turn = quat_to_matrix(model.geom_quat[geom])
        local = turn.T @ (point - model.geom_pos[geom])
        radius, half, _ = model.geom_size[geom]
        kind = model.geom_type[geom]
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            box = Box(*(2 * model.geom_size[geom]))
            measured = signed_distances([box], np.zeros(1, dtype=np.intp), local[None, None])
            nearest = min(nearest, float(measured.distance_m[0, 0]))
            continue
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            local = local - [0, 0, np.clip(local[2], -half, half)]
        else:
            assert kind == mujoco.mjtGeom.mjGEOM_SPHERE
        nearest = min(nearest, float(np.linalg.norm(local)) - radius)
    return nearest


@pytest.mark.parametrize("name", HAND.places)
def test_contact_places_lie_on_the_surface_with_outward_unit_normals(model: Any, name: str) -> None:
    place = HAND.places[name]
    point, normal = np.array(place.point_m), np.array(place.normal)
    assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-4)
    assert abs(signed_distance(model, place.body, point)) < 0.001
    outward = signed_distance(model, place.body, point + 0.002 * normal)
    inward = signed_distance(model, place.body, point - 0.002 * normal)
    assert inward < -0.0005 < 0.0005 < outward


@pytest.mark.parametrize("name", HAND.surface_points)
def test_surface_points_lie_on_the_surface(model: Any, name: str) -> None:
    body, point = HAND.surface_points[name]
    assert abs(signed_distance(model, body, np.array(point))) < 0.0005


@pytest.mark.parametrize("digit", DIGITS)
def test_grasp_size_is_measured_between_points_inside_the_rounded_tips(model: Any, digit: str) -> None:
    body, point = HAND.digits[digit].tip_body, HAND.digits[digit].tip_m
    assert body == HAND.places[f"{digit}_pad"].body
    assert -0.012 < signed_distance(model, body, np.array(point)) < 0


def test_every_contact_place_a_type_speaks_of_exists() -> None:
    for kind in (*GRASP_TYPES.values(), *FEIX_TYPES.values()):
        assert {*kind.opposition, *kind.support} <= set(HAND.places)
    assert tuple(HAND.digits) == DIGITS
    assert HAND.grasp_types == tuple(GRASP_TYPES.values())


# Areas of digits


def areas_of(hand: Hand, body: str, normal: Any) -> set[str]:
    """Name the areas of a body's digit that one contact marks; other digits have none."""
    normal = np.array(normal, dtype=float)
    masks = hand.area_masks([body], [normal / np.linalg.norm(normal)])
    (column,) = np.flatnonzero(masks)
    root = list(hand.digits.values())[column].root
    assert root in hand.kinematics.ancestry([body])
    return {area for bit, area in enumerate(AREAS) if masks[column] >> bit & 1}


# In these frames z is along the digit and -y palmar; the thumb's inner links are turned by 90 degrees, -x palmar.
FACING = {"pad": [0, -1, 0], "radial": [1, 0, 0], "ulnar": [-1, 0, 0], "back": [0, 1, 0]}
THUMB_FACING = {"pad": [-1, 0, 0], "radial": [0, -1, 0], "ulnar": [0, 1, 0], "back": [1, 0, 0]}


@pytest.mark.parametrize("side", FACING)
def test_a_contact_is_on_the_area_that_faces_as_its_normal(side: str) -> None:
    for finger in ("ff", "mf", "rf", "lf"):
        for link, part in {
            "distal": "distal",
            "middle": "middle",
            "proximal": "proximal",
            "knuckle": "proximal",
        }.items():
            assert areas_of(HAND, f"{finger}{link}", FACING[side]) == {f"{part}_{side}"}
    assert areas_of(HAND, "thdistal", FACING[side]) == {f"distal_{side}"}
    for link, part in {"middle": "middle", "hub": "proximal", "proximal": "proximal", "base": "proximal"}.items():
        assert areas_of(HAND, f"th{link}", THUMB_FACING[side]) == {f"{part}_{side}"}


@pytest.mark.parametrize(
    ("normal", "area"),
    [
        ([0, -1, 0.15], "distal_pad"),
        ([0, -0.87, 0.5], "distal_end"),
        ([0, 0, 1], "distal_end"),
        ([0.6, -1, 0], "distal_pad"),
        ([1, -0.6, 0], "distal_radial"),
        ([-1, -0.6, 0], "distal_ulnar"),
        ([-1, 0.9, 0], "distal_ulnar"),
        ([0.5, 1, -0.2], "distal_back"),
    ],
)
def test_a_normal_between_two_areas_belongs_to_the_nearer(normal: list[float], area: str) -> None:
    assert areas_of(HAND, "mfdistal", normal) == {area}


def test_contacts_of_all_digits_are_collected_in_one_mask_a_digit(hand: Hand) -> None:
    bodies = ["ffdistal", "thdistal", "ffmiddle", "ffdistal"]
    masks = hand.area_masks(bodies, [[0, -1, 0], [1, 0, 0], [0, -1, 0], [0, -1, 0.1]])
    named = [{area for bit, area in enumerate(AREAS) if mask >> bit & 1} for mask in masks]
    assert named == [{"distal_radial"}, {"distal_pad", "middle_pad"}, set(), set(), set()]
    assert hand.area_masks([], []).tolist() == [0] * 5


@pytest.mark.parametrize("name", HAND.places)
def test_every_contact_place_is_in_an_area_of_its_name(name: str) -> None:
    place, (digit, _, spot) = HAND.places[name], name.partition("_")
    area = {"phalanx": "middle_pad", "side": "distal_radial"}.get(spot, f"distal_{spot}")
    assert areas_of(HAND, place.body, place.normal) == {area}
    assert HAND.area_masks([place.body], [place.normal])[DIGITS.index(digit)]


def test_the_side_of_the_middle_finger_is_on_its_surface_beside_the_pad(model: Any) -> None:
    side, pad = HAND.places["middle_side"], HAND.places["middle_pad"]
    assert abs(signed_distance(model, side.body, np.array(side.point_m))) < 0.0002
    assert (side.body, side.point_m[2]) == (pad.body, pad.point_m[2])
    towards = np.degrees(np.arctan2(side.normal[0], -side.normal[1]))
    assert towards == pytest.approx(60, abs=0.1), "from palmar towards the thumb"


def test_a_body_that_no_joint_moves_is_a_part_of_the_link_it_is_on(tmp_path: Path) -> None:
    place = shadow_entries()["places"]["index_pad"] | {"body": "fftip"}
    tip = '<body name="fftip" quat="0 0 0 1"><geom type="sphere" size="0.001"/><inertial pos="0 0 0" mass="0.001" '
    tip += 'diaginertia="1e-8 1e-8 1e-8"/></body>'
    joint = '<joint name="FFJ1" class="curl"/>'
    digits = shadow_entries()["digits"]
    digits["index"]["tip"]["body"] = "fftip"
    turned = {"index_pad": place | {"point_m": [0, 0.00663, 0.019], "normal": [0, 0.98928, 0.14604]}}
    path = write_hand(
        tmp_path,
        edited((joint, joint + tip)),
        name="tipped",
        digits=digits,
        places=shadow_entries()["places"] | turned,
    )
    hand = load_hand(path)
    assert areas_of(hand, "fftip", [0, 1, 0]) == {"distal_pad"}
    assert areas_of(hand, "fftip", [1, 0, 0]) == {"distal_ulnar"}
    assert areas_of(hand, "ffdistal", [1, 0, 0]) == {"distal_radial"}
    assert areas_of(hand, "ffmiddle", [0, -1, 0]) == {"middle_pad"}


def test_a_digit_without_contact_places_has_areas_by_the_hands_palm(tmp_path: Path) -> None:
    places = {name: place for name, place in shadow_entries()["places"].items() if not name.startswith("ring")}
    hand = load_hand(write_hand(tmp_path, places=places))
    assert areas_of(hand, "rfdistal", [0, -1, 0]) == {"distal_pad"}
    assert areas_of(hand, "rfdistal", [0, 0, 1]) == {"distal_end"}
    assert areas_of(hand, "rfmiddle", [1, 0, 0]) == {"middle_radial"}


def test_pads_of_the_straight_hand_face_the_palms_side(hand: Hand) -> None:
    names = ["index_pad", "middle_pad", "ring_pad", "little_pad"]
    for places in hand.place_points(np.zeros(len(JOINTS)), names).values():
        assert places.normal[0, 1] < -0.9
        np.testing.assert_allclose(np.linalg.norm(places.normal, axis=1), 1, atol=1e-4)


@settings(max_examples=20)
@given(posture=postures)
def test_places_and_tips_ride_on_their_bodies(posture: np.ndarray) -> None:
    frames = HAND.frames(posture)
    for name, places in HAND.place_points(posture, list(HAND.places)).items():
        place = HAND.places[name]
        rotation, origin = (part[0] for part in frames[place.body])
        np.testing.assert_allclose(rotation.T @ (places.point_m[0] - origin), place.point_m, atol=1e-12)
        np.testing.assert_allclose(rotation.T @ places.normal[0], place.normal, atol=1e-12)
    tips = HAND.tips(posture, ["thumb", "index"])
    assert HAND.tip_distance(posture)[0] == pytest.approx(np.linalg.norm(tips["thumb"] - tips["index"]))


@settings(max_examples=20)
@given(posture=postures)
def test_opposition_and_grasp_size_are_those_of_the_executed_posture(posture: np.ndarray) -> None:
    executed = HAND.executed(posture)
    assert HAND.grasp_size(posture)[0] == HAND.tip_distance(executed)[0]
    for kind in GRASP_TYPES.values():
        thumb, other = HAND.opposition(posture, kind)
        places = HAND.place_points(executed, list(kind.opposition))
        np.testing.assert_array_equal(thumb, places[kind.opposition[0]].point_m)
        np.testing.assert_array_equal(other, places[kind.opposition[1]].point_m)


# Hands by name and file


def test_a_hand_is_read_by_its_short_name_its_full_name_its_file_or_itself(hand: Hand) -> None:
    assert load_hand() is load_hand("shadow") is load_hand("shadow_hand_right") is load_hand(hand) is hand
    for place in (SHADOW_FILE, str(SHADOW_FILE), SHADOW_FILE.parent):
        assert load_hand(place) == hand
        assert hash(load_hand(place)) == hash(hand)
    assert repr(hand) == "<Hand shadow_hand_right: 22 joints, thumb index middle ring little>"


def test_an_unknown_hand_is_refused_and_the_nearest_one_named() -> None:
    with pytest.raises(InputError, match=r"unknown hand 'shadwo'\. Did you mean 'shadow'\? .* hand file"):
        load_hand("shadwo")


@pytest.mark.parametrize("given", ["", ".", "a_folder"])
def test_what_names_no_hand_is_answered_with_what_does(
    given: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a_folder").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"unknown hand .* Valid: shadow, .* the path of a hand file"):
        load_hand(given)


def test_an_empty_name_is_no_hand_even_beside_a_hand_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_hand(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert load_hand(".").name == "shadow_hand_right"
    with pytest.raises(InputError, match="unknown hand ''"):
        load_hand("")


@pytest.mark.parametrize("name", ["right_hand.xml", "hand.urdf", "hand.MJCF"])
def test_a_model_in_place_of_a_hand_file_is_answered_with_what_is_needed(tmp_path: Path, name: str) -> None:
    for path in (tmp_path / name, SHADOW_MJCF):
        with pytest.raises(InputError, match=r"is a model; give the hand file \(\.yaml\)"):
            load_hand(path)


def test_a_hand_file_that_is_absent_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no file"):
        load_hand(tmp_path / "absent.yaml")


def test_a_file_based_on_a_shipped_hand_changes_what_it_says_and_nothing_else(tmp_path: Path, hand: Hand) -> None:
    other = load_hand(write_hand(tmp_path, name="short_reach", reach_m=0.05, pregrasp_rad={}))
    assert (other.name, other.reach_m, other.pregrasp.any()) == ("short_reach", 0.05, False)
    assert other.mjcf == hand.mjcf
    assert other.kinematics == hand.kinematics
    assert other.places == hand.places
    assert other != hand


def test_a_hand_file_needs_no_base(tmp_path: Path, hand: Hand) -> None:
    path = tmp_path / "whole.yaml"
    path.write_text(json.dumps(shadow_entries() | {"mjcf": str(SHADOW_MJCF)}))
    assert load_hand(path).fingerprint() == hand.fingerprint()


LEFT_OUT = object()
TWO_ON_ONE_ROOT = shadow_entries()["digits"]
TWO_ON_ONE_ROOT["ring"] = TWO_ON_ONE_ROOT["middle"]
BELOW_ANOTHER = shadow_entries()["digits"]
BELOW_ANOTHER["ring"] = {"root": "mfmiddle", "tip": BELOW_ANOTHER["middle"]["tip"]}
TIP_ELSEWHERE = shadow_entries()["digits"]
TIP_ELSEWHERE["ring"]["tip"]["body"] = "mfdistal"
PLACES = shadow_entries()["places"]
MIDDLE_LESS = {name: place for name, place in PLACES.items() if not name.startswith("ring")}


def with_place(name: str, **changes: Any) -> dict[str, Any]:
    """Change a contact place, or add one that is otherwise like the index finger's pad."""
    return {"places": PLACES | {name: PLACES.get(name, PLACES["index_pad"]) | changes}}


def with_tip(**changes: Any) -> dict[str, Any]:
    digits = shadow_entries()["digits"]
    digits["index"]["tip"] |= changes
    return {"digits": digits}


NAN = float("nan")


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        ({"digits": LEFT_OUT}, "missing required field `digits`"),
        ({"name": LEFT_OUT}, "missing required field `name`"),
        ({"finger_count": 5}, "unknown field `finger_count`"),
        ({"frame": {"body": "palm", "quat": [1, 0, 0, 0]}}, "unknown field `quat`"),
        ({"reach_m": "wide"}, r"Expected `float`, got `str` - at `\$.reach_m`"),
        ({"joints": "FFJ4"}, "Expected `array`, got `str`"),
        ({"frame": {"body": "palm", "quat_wxyz": [1, 0, 0]}}, r"at `\$.frame.quat_wxyz`"),
        ({"base": "shadwo"}, "unknown base hand 'shadwo'. Did you mean 'shadow'"),
        ({"base": ["shadow"]}, "unknown base hand"),
        ({"digits": TWO_ON_ONE_ROOT}, "two digits have the same root mfknuckle"),
        ({"digits": BELOW_ANOTHER, "places": MIDDLE_LESS}, "the ring hangs from the middle"),
        ({"digits": TIP_ELSEWHERE}, "the tip of the ring is on mfdistal, which does not hang from its root rfknuckle"),
        ({"digits": shadow_entries()["digits"] | {"pinky": {}}}, "missing required field `root`"),
        (
            {"digits": shadow_entries()["digits"] | {"litle": shadow_entries()["digits"]["little"]}},
            "unknown digit 'litle'. Did you mean 'little'",
        ),
        ({"digits": {"index": shadow_entries()["digits"]["index"]}}, "need a thumb and at least one finger"),
        ({"digits": {}}, "need a thumb and at least one finger"),
        (with_place("thumb_pad", normal=[0, -2, 0]), "the normal of thumb_pad has length 2; it must be 1"),
        (with_place("thumb_pad", normal=[0, NAN, 0]), "the normal of thumb_pad has length nan; it must be 1"),
        (with_place("thumb_pad", normal=[0, 1, 0]), "the normal of thumb_pad points into thdistal"),
        (with_place("index_pad", normal=[0, 1, 0]), "the normal of index_pad points into ffdistal"),
        (with_place("index_side", point_m=[0, 0.007, 0.019], normal=[0, 1, 0]), r"the place index_side faces .*not -y"),
        (with_place("index_pad", point_m=[0, -6.63, 19.0]), r"point_m of places.index_pad is 20.* millimetres"),
        (with_place("index_pad", point_m=[0, NAN, 0.019]), r"point_m of places.index_pad is nan m .* within 0.1 m"),
        (with_tip(point_m=[0, 0, 26]), r"point_m of digits.index.tip is 26 m .*this looks like millimetres"),
        (with_tip(point_m=[0, 0, 0.26]), r"point_m of digits.index.tip is 0.26 m .* not within 0.1 m$"),
        ({"surface_points": {"nail": {"body": "ffdistal", "point_m": [0, 0, 26]}}}, "of surface_points.nail is 26 m"),
        (
            with_place("index_pad", body="thdistal"),
            "index_pad is on thdistal, which does not hang from the index's root",
        ),
        (with_place("index_pad", body="palm"), "index_pad is on palm, which does not hang from the index's root"),
        (with_place("thumb_pad", body="forearm"), "forearm does not hang from the palm body 'palm'"),
        (with_place("thumb_pad", body="thdistl"), r"lacks thdistl \(of places.thumb_pad; did you mean 'thdistal'\?\)"),
        ({"palm_bodies": []}, "palm_bodies must name one body or more, each once"),
        ({"palm_bodies": ["palm", "palm"]}, "palm_bodies must name one body or more, each once"),
        ({"palm_bodies": ["palm", "ffdistal"]}, "palm_bodies names ffdistal, which is of the index"),
        ({"palm_bodies": ["world"]}, "palm_bodies names world, which is of no hand"),
        (
            {"frame": {"body": "forearm"}},
            "WRJ2, WRJ1 moves the wrist below the palm body 'forearm'; give as frame.body",
        ),
        (
            {"frame": {"body": "forearm"}, "wrist_joints": [], "joints": [*shadow_entries()["joints"], "WRJ2", "WRJ1"]},
            "WRJ2, WRJ1 moves the wrist below the palm body 'forearm'",
        ),
        *(({"name": name}, "name must be 1 to 100 printable") for name in ("", " ", "a\nb", "\u202e", "x" * 101)),
        ({"pregrasp_rad": {"THJ4": 70.0}}, "pregrasp_rad of THJ4 is 70 rad, not within .*this looks like degrees"),
        ({"pregrasp_rad": {"THJ4": -3.0}}, r"pregrasp_rad of THJ4 is -3 rad, not within 0 to 1.222 rad$"),
        ({"pregrasp_rad": {"THJ4": NAN}}, "pregrasp_rad of THJ4 is nan rad"),
        ({"wrist_joints": ["WRJ2", "WRJ1", "WRJ1"]}, "joints must name each joint once, got WRJ1"),
        ({"pregrasp_rad": {"THJ9": 1.0}}, "pregrasp_rad names THJ9, which joints does not list"),
        *(({"reach_m": wrong}, "reach_m must be 0.001 to 0.25 m, got ") for wrong in (-0.065, 65.0, 0.65)),
        ({"reach_m": NAN}, "reach_m must be 0.001 to 0.25 m, got "),
        ({"joints": []}, "joints must name each joint once"),
        ({"joints": [*shadow_entries()["joints"], "FFJ4"]}, "joints must name each joint once, got FFJ4"),
        ({"joints": [*shadow_entries()["joints"], "WRJ1"]}, "got WRJ1"),
        (
            {"joints": [*shadow_entries()["joints"], "WRJ1"], "wrist_joints": ["WRJ2"]},
            "WRJ1 moves no part below the palm",
        ),
        ({"joints": shadow_entries()["joints"][1:]}, "joints that neither joints nor wrist_joints lists: FFJ4, FFJ3"),
        ({"wrist_joints": []}, "joints that neither joints nor wrist_joints lists: WRJ2, WRJ1"),
        ({"couplings": {"FFJ0": ["FFJ2", "FFJ3"]}}, "coupling FFJ0 is of FFJ2, FFJ3 in the hand file; in the model it"),
        ({"couplings": {"FFJ9": ["FFJ2", "FFJ1"]}}, "lacks FFJ9"),
        ({"frame": {"body": "lfmetacarpal"}}, "does not hang from the palm body 'lfmetacarpal'"),
        ({"frame": {"body": "palm", "quat_wxyz": [1, 1, 0, 0]}}, "must have norm 1"),
        ({"mjcf": "absent.xml"}, "cannot read hand model"),
    ],
)
def test_a_hand_file_that_cannot_be_is_refused_in_one_line_that_names_it(
    tmp_path: Path, entries: dict, says: str
) -> None:
    path = tmp_path / "hand.yaml"
    every = shadow_entries() | {"mjcf": str(SHADOW_MJCF)} | entries
    text = json.dumps({name: entry for name, entry in every.items() if entry is not LEFT_OUT})
    path.write_text(text.replace("NaN", ".nan"))  # as YAML spells it
    with pytest.raises(InputError, match=says) as caught:
        load_hand(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    assert len(message) < 500


@pytest.mark.parametrize("text", ["", "- palm\n", "shadow\n", "name: &x a\nbase: *x\n", "name: [\n"])
def test_what_is_no_mapping_of_entries_is_no_hand_file(tmp_path: Path, text: str) -> None:
    path = tmp_path / "hand.yaml"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=r"hand\.yaml: "):
        load_hand(path)


# Models that can be used, and others


def test_a_model_without_the_described_parts_is_refused_by_their_names(tmp_path: Path) -> None:
    without = edited(("FFJ3", "KNUCKLE"), ("thhub", "ball"))
    with pytest.raises(InputError, match=r"model\.xml lacks FFJ3") as caught:
        load_hand(write_hand(tmp_path, without))
    assert "thhub" not in str(caught.value), "a body that the hand file does not speak of may have any name"
    without = edited(('"thdistal"', '"tip"'), ('"lfmetacarpal"', '"meta"'))
    with pytest.raises(InputError, match=r"lacks lfmetacarpal \(of palm_bodies.*, thdistal \(of digits.thumb.tip"):
        load_hand(write_hand(tmp_path, without))


TENDON = '<fixed name="FFJ0"><joint joint="FFJ2" coef="1"/><joint joint="FFJ1" coef="1"/></fixed>'
PAIR = '<fixed name="FFJ0"><joint joint="FFJ2" coef="{}"/><joint joint="FFJ1" coef="{}"/></fixed>'
BENDER = '<position name="FFJ3" joint="FFJ3" '
INDEX_TIP = '<joint name="FFJ1" class="curl"/>'
THUMB_TIP = '<joint name="THJ1" range="-0.2617993877991494 1.5707963267948966"/>'
FLOOR = '<worldbody><geom name="floor" type="plane" size="1 1 0.1"/>'
MUG = '<worldbody><body name="mug"><freejoint/><geom type="sphere" size="0.02"/></body>'


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ([(actuator_line("THJ1"), "")], "joints THJ1 have no actuator; add <position joint=... /> to the MJCF"),
        (
            [(actuator_line("THJ1"), '<motor name="THJ1" joint="THJ1" ctrlrange="-1 1"/>')],
            "actuator THJ1 is no position servo",
        ),
        (
            [(actuator_line("THJ1"), '<velocity name="THJ1" joint="THJ1" ctrlrange="-1 1"/>')],
            "actuator THJ1 is no position servo",
        ),
        ([(TENDON, ""), (actuator_line("FFJ0"), "")], "lacks FFJ0"),
        ([(actuator_line("FFJ0"), "")], "coupling FFJ0 is of FFJ2, FFJ1 in the hand file; in the model it has no act"),
        (
            [
                (THUMB_TIP, '<joint name="THJ1"/>'),
                (actuator_line("THJ1"), '<position name="THJ1" joint="THJ1" kp="1"/>'),
            ],
            "joint THJ1 has no range",
        ),
        (
            [(actuator_line("FFJ3"), '<intvelocity name="FFJ3" joint="FFJ3" kp="1" actrange="-1 1"/>')],
            "actuator FFJ3 is no position servo",
        ),
        ([(BENDER, BENDER + 'timeconst="2" ')], "actuator FFJ3 is no position servo .* time constant"),
        ([(BENDER, BENDER + 'gear="0" ')], "actuator FFJ3 does not move FFJ3: its gear, or the tendon's coeff"),
        ([(TENDON, PAIR.format(0, 0))], "actuator FFJ0 does not move FFJ2, FFJ1: its gear"),
        ([(TENDON, PAIR.format(1, 0))], "actuator FFJ0 does not move FFJ1: its gear"),
        ([("</actuator>", '<position name="more" joint="FFJ3" kp="1"/></actuator>')], "joint FFJ3 is driven twice"),
        ([("</tendon>", '</tendon><equality><joint joint1="MFJ3" joint2="FFJ3"/></equality>')], "MFJ3 is driven twice"),
        ([(BENDER, '<position joint="FFJ3" ')], "actuator number 3 of the MJCF needs a name$"),
        (
            [("</tendon>", '</tendon><equality><joint name="lock" joint1="FFJ3"/></equality>')],
            "equality lock does not tie",
        ),
        (
            [("</tendon>", '</tendon><equality><joint name="tie" joint1="LFJ5" joint2="WRJ1"/></equality>')],
            "equality tie does not tie one joint of a posture to another",
        ),
        (
            [("</tendon>", '</tendon><equality><weld body1="ffdistal" body2="thdistal"/></equality>')],
            "equality 0 does not tie one joint of a posture to another; nothing else is supported",
        ),
        ([("thhub", "object")], "has bodies named 'object', as trials call theirs"),
        (
            [
                (
                    '<body name="ffmiddle"',
                    '<body name="more" pos="0 0 0.01"><joint/>'
                    '<geom type="sphere" size="0.005"/></body><body name="ffmiddle"',
                )
            ],
            "lists: one without a name",
        ),
        ([('<joint name="FFJ3"', '<joint name="FFJ3" type="slide"')], "FFJ3 is not a hinge"),
        ([('<joint name="FFJ3"', '<joint name="FFJ3" pos="0 0 0.01"')], "FFJ3 is not a hinge at the origin"),
        ([("<worldbody>", FLOOR)], "model.xml is a scene: it also holds floor"),
        ([("<worldbody>", MUG)], "model.xml is a scene: it also holds mug"),
        ([('<body name="forearm">', '<body name="forearm"><freejoint/>')], "is a scene: it also holds a free joint"),
        ([("<mujoco", "<mojuco"), ("</mujoco", "</mojuco")], "cannot read hand model"),
        ([('<body name="ffknuckle"', '<body name="mfknuckle"')], "cannot .* hand model"),
    ],
)
def test_a_model_that_trials_cannot_use_is_refused_with_what_to_do(
    tmp_path: Path, changes: list[tuple[str, str]], says: str
) -> None:
    with pytest.raises(InputError, match=says) as caught:
        load_hand(write_hand(tmp_path, edited(*changes)))
    assert "\n" not in str(caught.value)


def test_what_has_no_effect_on_trials_does_not_stand_in_their_way(tmp_path: Path, hand: Hand) -> None:
    keys = f'<keyframe><key name="open" qpos="{"0 " * 24}" ctrl="{"0 " * 20}"/></keyframe>'
    sensors = '<sensor><jointpos name="touch_index" joint="FFJ3"/></sensor>'
    tie = '<equality><joint joint1="MFJ3" joint2="WRJ1" active="false"/></equality>'
    other = load_hand(write_hand(tmp_path, edited(("</mujoco>", keys + sensors + tie + "</mujoco>"))))
    assert other.couplings == hand.couplings
    ours, theirs = (build_world(each, as_object("box_small"), PAPER.physics).model for each in (hand, other))
    assert (theirs.nsensor, theirs.nkey, theirs.neq, theirs.nq) == (ours.nsensor, 0, 0, ours.nq)


def test_a_file_that_is_no_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read hand model") as caught:
        load_hand(write_hand(tmp_path, "not a model"))
    assert "\n" not in str(caught.value)


def test_a_model_whose_meshes_are_absent_is_refused(tmp_path: Path) -> None:
    mesh = '<asset><mesh name="m" file="absent.stl"/></asset><worldbody>'
    looks = '<body name="forearm"><geom type="mesh" mesh="m" class="look"/>'
    with pytest.raises(InputError, match=r"hand model .*model\.xml"):
        load_hand(write_hand(tmp_path, edited(("<worldbody>", mesh), ('<body name="forearm">', looks))))


_NAMING = re.compile(r'\b(name|joint|joint1|tendon|body1|body2)="([A-Za-z]\w*)"')


def test_the_same_hand_under_prefixed_names_has_the_same_kinematics(tmp_path: Path, hand: Hand) -> None:
    prefixed = _NAMING.sub(r'\1="rh_\2"', SHADOW_MJCF.read_text())
    other = load_hand(write_hand(tmp_path, prefixed, name="prefixed", prefix="rh_"))
    assert other.name == "prefixed"
    assert other.joint_names == hand.joint_names
    assert other.kinematics == hand.kinematics
    assert [actuator.name for actuator in other.actuators] == [actuator.name for actuator in hand.actuators]
    np.testing.assert_array_equal(other.lower_rad, hand.lower_rad)
    np.testing.assert_array_equal(other.upper_rad, hand.upper_rad)
    np.testing.assert_array_equal(other.X_base_hand.position_m, hand.X_base_hand.position_m)
    flat = dict.fromkeys(hand.joint_names, np.zeros(1))
    assert set(other.controls(flat)) == {f"rh_{name}" for name in hand.controls(flat)}
    with pytest.raises(InputError, match=r"lacks .*FFJ4.*\(prefix 'lh_'\)"):
        load_hand(write_hand(tmp_path, prefixed, prefix="lh_"))


def test_an_actuator_without_a_range_takes_any_target(tmp_path: Path) -> None:
    line = actuator_line("FFJ3")
    assert 'inheritrange="1"' in line
    free = load_hand(write_hand(tmp_path, edited((line, line.replace('inheritrange="1"', "")))))
    targets = dict.fromkeys(free.joint_names, np.array([0.7, -4.0, 4.0]))
    assert free.controls(targets)["FFJ3"].tolist() == [0.7, -4.0, 4.0]
    assert free.controls(targets)["MFJ3"].tolist() == pytest.approx([0.7, np.radians(-15), np.pi / 2])


def test_commands_need_all_joints_of_the_hand(hand: Hand) -> None:
    with pytest.raises(InputError, match="the grasps lack joints of shadow_hand_right: THJ1"):
        hand.controls({name: np.zeros(2) for name in hand.joint_names if name != "THJ1"})


# Which way the hand faces


def mirrored(text: str) -> str:
    """Mirror a model in the plane x = 0: a left hand."""
    signs = {"pos": (-1, 1, 1), "fromto": (-1, 1, 1, -1, 1, 1), "quat": (1, 1, -1, -1), "axis": (1, -1, -1)}
    tree = ElementTree.fromstring(text)
    for element in tree.iter():
        for name, sign in signs.items():
            if name in element.attrib:
                values = np.array(element.attrib[name].split(), dtype=float) * sign
                element.set(name, " ".join(map(repr, values.tolist())))
    return ElementTree.tostring(tree, encoding="unicode")


def turned_palm(text: str, quat_wxyz: np.ndarray) -> str:
    """Turn the frame of the palm body and leave the hand as it is."""
    tree = ElementTree.fromstring(text)
    palm = next(body for body in tree.iter("body") if body.get("name") == "palm")
    back = quat_conjugate(quat_wxyz)
    for child in palm:
        for name in {"pos", "fromto", "axis"} & set(child.attrib):
            vectors = rotate(back, np.array(child.attrib[name].split(), dtype=float).reshape(-1, 3))
            child.set(name, " ".join(map(repr, vectors.reshape(-1).tolist())))
        if child.tag in ("body", "inertial") or child.get("type") == "box":
            own = np.array(child.get("quat", "1 0 0 0").split(), dtype=float)
            child.set("quat", " ".join(map(repr, quat_multiply(back, own).tolist())))
    palm.set("quat", " ".join(map(repr, quat_wxyz.tolist())))
    return ElementTree.tostring(tree, encoding="unicode")


def test_a_left_hand_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the thumb is on the -x side of the hand frame: this is a left hand"):
        load_hand(write_hand(tmp_path, mirrored(SHADOW_MJCF.read_text())))


def test_a_palm_frame_that_points_elsewhere_is_refused_until_the_hand_frame_is_given(
    tmp_path: Path, hand: Hand, reference_posture: np.ndarray
) -> None:
    turn = canonical_quat([1.0, 1.0, 0.0, 0.0])
    text = turned_palm(SHADOW_MJCF.read_text(), turn)
    with pytest.raises(InputError, match=r"point along \[.*1.0, .*\] of the hand frame, not along z; give frame"):
        load_hand(write_hand(tmp_path, text))
    frame = {"body": "palm", "quat_wxyz": quat_conjugate(turn).tolist()}
    other = load_hand(write_hand(tmp_path, text, frame=frame))
    theirs, ours = other.frames(reference_posture), hand.frames(reference_posture)
    for link in LINKS:
        for mine, other_part in zip(ours[link], theirs[link], strict=True):
            np.testing.assert_allclose(other_part, mine, rtol=0, atol=1e-9)
    np.testing.assert_allclose(other.X_base_hand.position_m, hand.X_base_hand.position_m, atol=1e-9)
    np.testing.assert_allclose(other.X_base_hand.quat_wxyz, hand.X_base_hand.quat_wxyz, atol=1e-9)
    places = other.place_points(reference_posture, list(hand.places))
    for name, points in hand.place_points(reference_posture, list(hand.places)).items():
        np.testing.assert_allclose(places[name].point_m, points.point_m, rtol=0, atol=1e-9)


def test_a_hand_frame_whose_palm_faces_the_wrong_way_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"the place index_pad faces .* of the hand frame, not -y"):
        load_hand(write_hand(tmp_path, frame={"body": "palm", "quat_wxyz": [0, 0, 0, 1]}))


# Joints that are not free of each other

FOLLOWING = (
    "</tendon>",
    '</tendon><equality><joint name="bend" joint1="FFJ1" joint2="FFJ2" polycoef="0.1 0.5 0.2 0 0"/></equality>',
)
FOLLOWED_ALONE = [
    (TENDON, ""),
    (actuator_line("FFJ0"), '<position name="FFJ2" joint="FFJ2" kp="1" inheritrange="1"/>'),
    FOLLOWING,
]
COUPLINGS = {name: pair for name, pair in shadow_entries()["couplings"].items() if name != "FFJ0"}


def test_a_joint_tied_to_another_follows_it(tmp_path: Path) -> None:
    tied = load_hand(
        write_hand(tmp_path, edited(*FOLLOWED_ALONE), name="tied", couplings=COUPLINGS | {"bend": ["FFJ1", "FFJ2"]})
    )
    follower, leader = tied.joint_names.index("FFJ1"), tied.joint_names.index("FFJ2")
    angles = np.zeros((3, 22))
    angles[:, leader], angles[:, follower] = [0.0, 0.5, 1.0], 0.7
    executed = tied.executed(angles)
    np.testing.assert_allclose(executed[:, leader], angles[:, leader])
    np.testing.assert_allclose(executed[:, follower], [0.1, 0.1 + 0.25 + 0.05, 0.1 + 0.5 + 0.2])
    np.testing.assert_allclose(tied.executed(executed), executed)
    controls = tied.controls(dict(zip(tied.joint_names, executed.T, strict=True)))
    assert controls["FFJ2"].tolist() == [0.0, 0.5, 1.0]
    assert "FFJ1" not in controls


def test_a_tie_of_joints_needs_no_name_and_is_taken_from_the_model(tmp_path: Path) -> None:
    unnamed = [*FOLLOWED_ALONE[:2], (FOLLOWING[0], FOLLOWING[1].replace('name="bend" ', ""))]
    tied = load_hand(write_hand(tmp_path, edited(*unnamed), couplings=COUPLINGS))
    assert ("equality", ("FFJ1", "FFJ2")) in [(coupling.kind, coupling.joints) for coupling in tied.couplings]


def test_a_joint_that_follows_a_follower_is_refused(tmp_path: Path) -> None:
    chained = FOLLOWING[1].replace(
        "</equality>", '<joint name="bend_more" joint1="FFJ3" joint2="FFJ1" polycoef="0 1 0 0 0"/></equality>'
    )
    text = edited(*FOLLOWED_ALONE[:2], (FOLLOWING[0], chained))
    with pytest.raises(InputError, match="joint FFJ1 follows another and is followed; tie both to the driven joint"):
        load_hand(write_hand(tmp_path, text, couplings=COUPLINGS))


def test_joints_of_a_tendon_share_its_sum_in_proportion_to_their_weights(tmp_path: Path) -> None:
    weighted = load_hand(write_hand(tmp_path, edited(('"FFJ1" coef="1"', '"FFJ1" coef="0.5"'))))
    inner, outer = (weighted.joint_names.index(name) for name in ("FFJ2", "FFJ1"))
    angles = np.zeros((2, 22))
    angles[:, inner], angles[:, outer] = [0.5, 1.0], [0.5, 0.2]
    total = angles[:, inner] + 0.5 * angles[:, outer]
    executed = weighted.executed(angles)
    np.testing.assert_allclose(executed[:, inner] + 0.5 * executed[:, outer], total)
    np.testing.assert_allclose(executed[:, outer], 0.5 * executed[:, inner])
    for posture in (angles, executed):
        controls = weighted.controls(dict(zip(weighted.joint_names, posture.T, strict=True)))
        np.testing.assert_allclose(controls["FFJ0"], total)


# The mesh model of the same hand, where the user has it


@pytest.fixture(scope="module")
def mesh_hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    assert MESH_HAND is not None
    prefix = os.environ.get("GRASPCASCADE_MESH_PREFIX", "rh_")
    return load_hand(write_hand(tmp_path_factory.mktemp("meshes"), name="meshes", mjcf=MESH_HAND, prefix=prefix))


def mesh_triangles(model: Any, body: str) -> np.ndarray:
    """List the triangles ``(n, 3, 3)`` of a body's meshes in the body's frame."""
    triangles = []
    for geom in range(model.ngeom):
        if model.body(model.geom_bodyid[geom]).name != body or model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
            continue
        mesh = model.geom_dataid[geom]
        vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
        faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
        triangles.append((vertices @ quat_to_matrix(model.geom_quat[geom]).T + model.geom_pos[geom])[faces])
    return np.concatenate(triangles)


def distance_to_triangles(point: np.ndarray, triangles: np.ndarray) -> float:
    """Measure the distance of a point from a surface, sampled finely on each triangle near it."""
    near = triangles[np.linalg.norm(triangles.mean(axis=1) - point, axis=1).argsort()[:200]]
    grid = np.linspace(0, 1, 41)
    u, v = (a[np.add.outer(grid, grid) <= 1 + 1e-9] for a in np.meshgrid(grid, grid, indexing="ij"))
    points = np.einsum("ks,nsd->nkd", np.stack([1 - u - v, u, v], axis=1), near)
    return float(np.linalg.norm(points - point, axis=-1).min())


@with_mesh_hand
def test_the_mesh_hand_has_the_same_kinematics(mesh_hand: Hand, reference: dict[str, np.ndarray]) -> None:
    posture = np.stack([reference[f"{name}_rad"] for name in JOINTS], axis=1)
    assert_matches_reference(mesh_hand.frames(posture), reference)


@with_mesh_hand
@pytest.mark.parametrize("name", HAND.places)
def test_contact_places_lie_on_the_meshes(mesh_hand: Hand, name: str) -> None:
    place = HAND.places[name]
    meshes = read_spec(mesh_hand).compile()
    triangles = mesh_triangles(meshes, mesh_hand.prefix + place.body)
    assert distance_to_triangles(np.array(place.point_m), triangles) < 0.001


@with_mesh_hand
@pytest.mark.parametrize("digit", DIGITS)
def test_rounded_tips_end_where_the_meshes_end(mesh_hand: Hand, model: Any, digit: str) -> None:
    body, centre = HAND.digits[digit].tip_body, HAND.digits[digit].tip_m
    meshes = read_spec(mesh_hand).compile()
    triangles = mesh_triangles(meshes, mesh_hand.prefix + body)
    for tilt in np.radians([0, 20, 40]):
        outward = np.array([0.0, -np.sin(tilt), np.cos(tilt)])
        reach = np.linspace(0, 0.02, 2001)
        outside = [signed_distance(model, body, np.array(centre) + r * outward) > 0 for r in reach]
        surface = np.array(centre) + reach[int(np.argmax(outside))] * outward
        assert distance_to_triangles(surface, triangles) < 0.001, np.degrees(tilt)


def test_a_closure_is_the_opposition_and_the_grasp_size_of_each_row(hand: Hand, reference_posture: np.ndarray) -> None:
    executed, kinds = hand.executed(reference_posture), list(GRASP_TYPES.values())
    of_row = np.arange(len(executed)) % len(kinds)
    closure = hand.closure(executed, kinds, of_row)
    np.testing.assert_allclose(closure.grasp_size_m, hand.grasp_size(executed), rtol=0, atol=1e-15)
    for number, kind in enumerate(kinds):
        rows = of_row == number
        thumb, other = hand.opposition(executed[rows], kind)
        np.testing.assert_allclose(closure.thumb_m[rows], thumb, rtol=0, atol=1e-15)
        np.testing.assert_allclose(closure.other_m[rows], other, rtol=0, atol=1e-15)


def test_a_hinge_about_a_slanted_axis_turns_as_rodrigues_says() -> None:
    axis = np.array([2.0, -3.0, 6.0]) / 7
    slanted = Link("link", "root", (0.1, 0.0, 0.2), tuple(map(tuple, np.eye(3)[[1, 2, 0]])), "hinge", tuple(axis))
    tree = Kinematics((Link("root", None, (0.0, 0.0, 0.0), tuple(map(tuple, np.eye(3)))), slanted))
    angles = np.array([-2.0, 0.0, 0.7])
    turned, origin = tree.frames({"hinge": angles})["link"]
    expected = np.eye(3)[[1, 2, 0]] @ quat_to_matrix(
        np.concatenate([np.cos(angles / 2)[:, None], np.sin(angles / 2)[:, None] * axis], axis=1)
    )
    np.testing.assert_allclose(turned, expected, atol=1e-15)
    np.testing.assert_array_equal(origin, np.tile([0.1, 0.0, 0.2], (3, 1)))
    (point,) = tree.points({"hinge": angles}, [("link", (0.0, 0.3, -0.1))])
    np.testing.assert_allclose(point.T, origin + expected @ [0.0, 0.3, -0.1], atol=1e-15)


def test_a_fingerprint_names_what_a_hand_is_and_not_where_it_lies(tmp_path: Path, hand: Hand) -> None:
    text = SHADOW_MJCF.read_text()
    assert load_hand(write_hand(tmp_path, text)).fingerprint() == hand.fingerprint()
    assert load_hand(write_hand(tmp_path, text, pregrasp_rad={})).fingerprint() != hand.fingerprint()
    assert load_hand(write_hand(tmp_path, text + "<!-- heavier -->")).fingerprint() != hand.fingerprint()


# The hand that comes with a trained model


def test_a_hand_without_a_model_says_so_in_one_line(hand: Hand) -> None:
    bare = GraspSampler.pretrained().hand
    assert (bare.name, bare.joint_names) == (hand.name, hand.joint_names)
    refused = {
        "no files to compute a fingerprint of": bare.fingerprint,
        "names no actuators": lambda: bare.controls(dict.fromkeys(bare.joint_names, np.zeros(1))),
        "has no MJCF": lambda: read_spec(bare),
    }
    for says, ask in refused.items():
        with pytest.raises(InputError, match=says) as caught:
            ask()
        assert "load it from its hand file" in str(caught.value)


def test_a_hand_survives_json_but_for_its_model(hand: Hand, reference_posture: np.ndarray) -> None:
    again = Hand.from_json(json.loads(json.dumps(hand.to_json(), allow_nan=False)))
    assert again.digits == hand.digits
    assert again.couplings == hand.couplings
    assert again.places == hand.places
    np.testing.assert_array_equal(again.executed(reference_posture), hand.executed(reference_posture))
    np.testing.assert_array_equal(again.grasp_size(reference_posture), hand.grasp_size(reference_posture))


@pytest.mark.parametrize("change", [{"kinematics": 3}, {"lower_rad": "low"}, {"X_forearm_hand": []}, {"places": None}])
def test_garbled_geometry_is_refused(hand: Hand, change: dict) -> None:
    with pytest.raises(FileFormatError, match="stored hand geometry"):
        Hand.from_json(hand.to_json() | change)


def test_a_hand_names_the_types_it_can_make_and_refuses_others(cut_hands: Mapping[int, Hand]) -> None:
    assert [kind.name for kind in cut_hands[2].grasp_types] == ["palmar_pinch", "tip_pinch"]
    for n in (3, 4):
        assert cut_hands[n].grasp_types == tuple(GRASP_TYPES.values())
    for name, lacks in (("tripod", "middle"), ("parallel_extension", "middle or ring or little")):
        with pytest.raises(InputError) as caught:
            cut_hands[2].check_type(GRASP_TYPES[name])
        assert str(caught.value) == (
            f"hand hand_of_2 cannot make a {name}: it has no {lacks}. Possible types: palmar_pinch, tip_pinch."
        )
    with pytest.raises(
        InputError, match=r"cannot make a parallel_extension: it has no middle_pad, middle\. Possible types: palmar_"
    ):
        cut_hands[2].check_type(FEIX_TYPES["parallel_extension"])
    for n in (3, 4):
        assert cut_hands[n].possible(FEIX_TYPES.values()) == tuple(FEIX_TYPES.values())


def test_a_contact_place_that_a_hand_lacks_is_refused_with_those_it_has(cut_hands: Mapping[int, Hand]) -> None:
    with pytest.raises(InputError, match=r"no contact place 'middle_pad', needed by tripod, .*; it has: thumb_pad, "):
        cut_hands[2].place_points(cut_hands[2].pregrasp, ["middle_pad"])
