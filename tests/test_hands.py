"""The hand: kinematics and actuation against the reference, contact places on the surface, other models of it."""

import csv
import json
import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from graspcascade.errors import InputError
from graspcascade.hands import SHADOW_HAND, HandModel, Kinematics, load_hand, load_spec, shadow_hand
from graspcascade.hands.kinematics import Link
from graspcascade.poses import quat_to_matrix
from graspcascade.taxonomy import DIGITS, GRASP_TYPES

DATA = Path(__file__).parent / "data"
JOINTS = SHADOW_HAND.joint_names
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
    return load_spec(SHADOW_HAND).compile()


def engine_frames(model: Any, angles: dict[str, np.ndarray], prefix: str = "") -> dict[str, tuple[np.ndarray, ...]]:
    """Compute link frames in the palm frame with the physics engine."""
    data = mujoco.MjData(model)
    n = len(next(iter(angles.values())))
    found = {name: (np.zeros((n, 3, 3)), np.zeros((n, 3))) for name in LINKS}
    for row in range(n):
        for name, values in angles.items():
            data.joint(prefix + name).qpos[0] = values[row]
        mujoco.mj_kinematics(model, data)
        palm = data.body(prefix + "palm")
        turn, origin = palm.xmat.reshape(3, 3), palm.xpos
        for name, (rotation, position) in found.items():
            body = data.body(prefix + name)
            rotation[row] = turn.T @ body.xmat.reshape(3, 3)
            position[row] = turn.T @ (body.xpos - origin)
    return found


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
    hand: HandModel, reference: dict[str, np.ndarray], reference_posture: np.ndarray
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


def test_numpy_kinematics_equal_the_engine(hand: HandModel, model: Any, reference_posture: np.ndarray) -> None:
    theirs = engine_frames(model, dict(zip(JOINTS, reference_posture.T, strict=True)))
    ours = hand.frames(reference_posture)
    for link in LINKS:
        for mine, other in zip(ours[link], theirs[link], strict=True):
            np.testing.assert_allclose(mine, other, rtol=0, atol=1e-10)


@given(posture=postures)
def test_frames_are_rigid_and_a_batch_equals_its_rows(posture: np.ndarray) -> None:
    hand = shadow_hand()
    both = hand.frames(np.stack([posture, 0 * posture]))
    for link, (rotation, origin) in hand.frames(posture).items():
        np.testing.assert_allclose(rotation[0] @ rotation[0].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation[0]) == pytest.approx(1)
        np.testing.assert_array_equal(both[link][0][0], rotation[0])
        np.testing.assert_array_equal(both[link][1][0], origin[0])


def test_frames_of_some_bodies_equal_those_of_all(hand: HandModel, reference_posture: np.ndarray) -> None:
    everything = hand.frames(reference_posture[:3])
    some = hand.frames(reference_posture[:3], ["thdistal"])
    assert set(some) == {"palm", "thbase", "thproximal", "thhub", "thmiddle", "thdistal"}
    for name, (rotation, origin) in some.items():
        np.testing.assert_array_equal(rotation, everything[name][0])
        np.testing.assert_array_equal(origin, everything[name][1])


def test_kinematics_survive_json(hand: HandModel, reference_posture: np.ndarray) -> None:
    text = json.dumps(hand.kinematics.to_json(), allow_nan=False)
    again = Kinematics.from_json(json.loads(text))
    assert again == hand.kinematics
    angles = dict(zip(JOINTS, reference_posture.T, strict=True))
    for name, (rotation, origin) in again.frames(angles).items():
        np.testing.assert_array_equal(rotation, hand.frames(reference_posture)[name][0])
        np.testing.assert_array_equal(origin, hand.frames(reference_posture)[name][1])


def test_the_forearm_is_a_wrist_below_the_palm(hand: HandModel) -> None:
    np.testing.assert_allclose(hand.X_forearm_hand.position_m, [0.0, -0.01, 0.24701], atol=1e-9)
    np.testing.assert_allclose(hand.X_forearm_hand.quat_wxyz, [1, 0, 0, 0], atol=1e-12)


def test_a_posture_of_another_width_is_refused(hand: HandModel) -> None:
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


def test_twenty_four_joints_hang_on_twenty_actuators(model: Any, hand: HandModel) -> None:
    rows = read_rows("shadow_hand_joints.csv")
    assert model.nq == model.nv == len(rows) == 24
    assert model.nu == len({row["actuator"] for row in rows}) == 20
    assert {row["joint"] for row in rows} == {*JOINTS, *SHADOW_HAND.wrist_joints}
    for actuator, pair in SHADOW_HAND.coupled.items():
        assert pair == tuple(row["joint"] for row in rows if row["actuator"] == actuator)


def test_limits_are_the_reference_limits_in_joint_order(hand: HandModel) -> None:
    table = {row["joint"]: row for row in read_rows("shadow_hand_joints.csv")}
    np.testing.assert_allclose(np.degrees(hand.lower_rad), [float(table[n]["lower_deg"]) for n in JOINTS], atol=1e-9)
    np.testing.assert_allclose(np.degrees(hand.upper_rad), [float(table[n]["upper_deg"]) for n in JOINTS], atol=1e-9)


def test_the_pregrasp_is_flat_open_with_the_thumb_out_of_the_way(hand: HandModel) -> None:
    opened = dict(zip(JOINTS, hand.pregrasp, strict=True))
    assert {name for name, angle in opened.items() if angle} == {"THJ4"}
    np.testing.assert_array_equal(hand.clip(hand.pregrasp), hand.pregrasp)
    assert hand.grasp_size(hand.pregrasp)[0] > 0.08


# What a tendon does to a command


@given(posture=postures)
def test_sharing_keeps_each_tendons_sum_and_every_other_joint(posture: np.ndarray) -> None:
    shared = shadow_hand().share(posture)
    pairs = [[JOINTS.index(name) for name in pair] for pair in SHADOW_HAND.coupled.values()]
    for pair in pairs:
        assert shared[pair].sum() == pytest.approx(posture[pair].sum(), abs=1e-12)
        assert shared[pair[0]] == shared[pair[1]]
    free = [i for i in range(len(JOINTS)) if i not in np.ravel(pairs)]
    np.testing.assert_array_equal(shared[free], posture[free])


@given(posture=postures)
def test_an_executed_posture_is_within_limits_and_executes_as_itself(posture: np.ndarray) -> None:
    hand = shadow_hand()
    executed = hand.executed(posture)
    assert (hand.lower_rad <= executed).all()
    assert (executed <= hand.upper_rad).all()
    np.testing.assert_array_equal(hand.executed(executed), executed)


@given(posture=postures)
def test_executing_leaves_its_argument_alone(posture: np.ndarray) -> None:
    before = posture.copy()
    shadow_hand().executed(posture)
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
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            local = local - [0, 0, np.clip(local[2], -half, half)]
        else:
            assert kind == mujoco.mjtGeom.mjGEOM_SPHERE
        nearest = min(nearest, float(np.linalg.norm(local)) - radius)
    return nearest


@pytest.mark.parametrize("name", SHADOW_HAND.places)
def test_contact_places_lie_on_the_surface_with_outward_unit_normals(model: Any, name: str) -> None:
    place = SHADOW_HAND.places[name]
    point, normal = np.array(place.point_m), np.array(place.normal)
    assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-4)
    assert abs(signed_distance(model, place.body, point)) < 0.001
    outward = signed_distance(model, place.body, point + 0.002 * normal)
    inward = signed_distance(model, place.body, point - 0.002 * normal)
    assert inward < -0.0005 < 0.0005 < outward


@pytest.mark.parametrize("digit", DIGITS)
def test_grasp_size_is_measured_between_points_inside_the_rounded_tips(model: Any, digit: str) -> None:
    body, point = SHADOW_HAND.tips[digit]
    assert body == SHADOW_HAND.places[f"{digit}_pad"].body
    assert -0.012 < signed_distance(model, body, np.array(point)) < 0


def test_every_contact_place_a_type_speaks_of_exists() -> None:
    for kind in GRASP_TYPES.values():
        assert {*kind.opposition, *kind.support} <= set(SHADOW_HAND.places)
    assert set(SHADOW_HAND.digit_roots) == set(SHADOW_HAND.tips) == set(DIGITS)


def test_pads_of_the_straight_hand_face_the_palms_side(hand: HandModel) -> None:
    names = ["index_pad", "middle_pad", "ring_pad", "little_pad"]
    for places in hand.places(np.zeros(len(JOINTS)), names).values():
        assert places.normal[0, 1] < -0.9
        np.testing.assert_allclose(np.linalg.norm(places.normal, axis=1), 1, atol=1e-4)


@settings(max_examples=20)
@given(posture=postures)
def test_places_and_tips_ride_on_their_bodies(posture: np.ndarray) -> None:
    hand = shadow_hand()
    frames = hand.frames(posture)
    for name, places in hand.places(posture, list(SHADOW_HAND.places)).items():
        place = SHADOW_HAND.places[name]
        rotation, origin = (part[0] for part in frames[place.body])
        np.testing.assert_allclose(rotation.T @ (places.point_m[0] - origin), place.point_m, atol=1e-12)
        np.testing.assert_allclose(rotation.T @ places.normal[0], place.normal, atol=1e-12)
    tips = hand.tips(posture, ["thumb", "index"])
    assert hand.tip_distance(posture)[0] == pytest.approx(np.linalg.norm(tips["thumb"] - tips["index"]))


@settings(max_examples=20)
@given(posture=postures)
def test_opposition_and_grasp_size_are_those_of_the_executed_posture(posture: np.ndarray) -> None:
    hand = shadow_hand()
    executed = hand.executed(posture)
    assert hand.grasp_size(posture)[0] == hand.tip_distance(executed)[0]
    for kind in GRASP_TYPES.values():
        thumb, other = hand.opposition(posture, kind)
        places = hand.places(executed, list(kind.opposition))
        np.testing.assert_array_equal(thumb, places[kind.opposition[0]].point_m)
        np.testing.assert_array_equal(other, places[kind.opposition[1]].point_m)


# Another model of the same hand

_NAMING = re.compile(r'\b(name|joint|joint1|tendon|body1|body2)="([A-Za-z]\w*)"')


@pytest.fixture
def prefixed_mjcf(tmp_path: Path) -> Path:
    text = SHADOW_HAND.mjcf.read_text()
    path = tmp_path / "prefixed.xml"
    path.write_text(_NAMING.sub(r'\1="rh_\2"', text))
    return path


def test_the_same_hand_under_prefixed_names_has_the_same_kinematics(prefixed_mjcf: Path, hand: HandModel) -> None:
    other = load_hand(SHADOW_HAND.with_model(prefixed_mjcf, "prefixed", "rh_"))
    assert other.description.name == "prefixed"
    assert other.joint_names == hand.joint_names
    assert other.kinematics == hand.kinematics
    np.testing.assert_array_equal(other.lower_rad, hand.lower_rad)
    np.testing.assert_array_equal(other.upper_rad, hand.upper_rad)
    np.testing.assert_array_equal(other.X_forearm_hand.position_m, hand.X_forearm_hand.position_m)


def test_a_model_without_the_described_parts_is_refused_by_their_names(tmp_path: Path) -> None:
    path = tmp_path / "other.xml"
    path.write_text(SHADOW_HAND.mjcf.read_text().replace("FFJ3", "KNUCKLE").replace("thhub", "ball"))
    with pytest.raises(InputError, match=r"other\.xml lacks FFJ3") as caught:
        load_hand(SHADOW_HAND.with_model(path, "other", ""))
    assert "thhub" not in str(caught.value), "a body that the description does not speak of may have any name"
    path.write_text(SHADOW_HAND.mjcf.read_text().replace('"thdistal"', '"tip"').replace('"lfmetacarpal"', '"meta"'))
    with pytest.raises(InputError, match=r"lacks lfmetacarpal, thdistal"):
        load_hand(SHADOW_HAND.with_model(path, "other", ""))


def test_a_model_under_another_prefix_is_refused_with_the_prefix() -> None:
    with pytest.raises(InputError, match=r"lacks .*FFJ4.*\(prefix 'rh_'\)"):
        load_hand(replace(SHADOW_HAND, prefix="rh_"))


def test_a_file_that_is_absent_or_no_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read hand model"):
        load_hand(SHADOW_HAND.with_model(tmp_path / "absent.xml", "absent", ""))
    (tmp_path / "text.xml").write_text("not a model")
    with pytest.raises(InputError, match="cannot read hand model") as caught:
        load_hand(SHADOW_HAND.with_model(tmp_path / "text.xml", "text", ""))
    assert "\n" not in str(caught.value)


def test_a_model_whose_meshes_are_absent_is_refused(tmp_path: Path) -> None:
    mesh = '<asset><mesh name="m" file="absent.stl"/></asset><worldbody>'
    text = SHADOW_HAND.mjcf.read_text().replace("<worldbody>", mesh)
    text = text.replace('<body name="forearm">', '<body name="forearm"><geom type="mesh" mesh="m" class="look"/>')
    path = tmp_path / "meshes.xml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"hand model .*meshes\.xml"):
        load_hand(SHADOW_HAND.with_model(path, "meshes", ""))


def test_a_sliding_finger_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "slide.xml"
    path.write_text(SHADOW_HAND.mjcf.read_text().replace('<joint name="FFJ3"', '<joint name="FFJ3" type="slide"'))
    with pytest.raises(InputError, match="FFJ3 is not a hinge"):
        load_hand(SHADOW_HAND.with_model(path, "slide", ""))


# The mesh model of the same hand, where the user has it


@pytest.fixture(scope="module")
def mesh_hand() -> HandModel:
    assert MESH_HAND is not None
    return load_hand(SHADOW_HAND.with_model(MESH_HAND, "meshes", os.environ.get("GRASPCASCADE_MESH_PREFIX", "rh_")))


def mesh_triangles(model: Any, body: str) -> np.ndarray:
    """Give the triangles ``(n, 3, 3)`` of a body's meshes in the body's frame."""
    found = []
    for geom in range(model.ngeom):
        if model.body(model.geom_bodyid[geom]).name != body or model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
            continue
        mesh = model.geom_dataid[geom]
        vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
        faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
        found.append((vertices @ quat_to_matrix(model.geom_quat[geom]).T + model.geom_pos[geom])[faces])
    return np.concatenate(found)


def distance_to_triangles(point: np.ndarray, triangles: np.ndarray) -> float:
    """Measure the distance of a point from a surface, sampled finely on each triangle near it."""
    near = triangles[np.linalg.norm(triangles.mean(axis=1) - point, axis=1).argsort()[:200]]
    grid = np.linspace(0, 1, 41)
    u, v = (a[np.add.outer(grid, grid) <= 1 + 1e-9] for a in np.meshgrid(grid, grid, indexing="ij"))
    points = np.einsum("ks,nsd->nkd", np.stack([1 - u - v, u, v], axis=1), near)
    return float(np.linalg.norm(points - point, axis=-1).min())


@with_mesh_hand
def test_the_mesh_hand_has_the_same_kinematics(mesh_hand: HandModel, reference: dict[str, np.ndarray]) -> None:
    posture = np.stack([reference[f"{name}_rad"] for name in JOINTS], axis=1)
    assert_matches_reference(mesh_hand.frames(posture), reference)


@with_mesh_hand
@pytest.mark.parametrize("name", SHADOW_HAND.places)
def test_contact_places_lie_on_the_meshes(mesh_hand: HandModel, name: str) -> None:
    place = SHADOW_HAND.places[name]
    meshes = load_spec(mesh_hand.description).compile()
    triangles = mesh_triangles(meshes, mesh_hand.description.prefix + place.body)
    assert distance_to_triangles(np.array(place.point_m), triangles) < 0.001


@with_mesh_hand
@pytest.mark.parametrize("digit", DIGITS)
def test_rounded_tips_end_where_the_meshes_end(mesh_hand: HandModel, model: Any, digit: str) -> None:
    body, centre = SHADOW_HAND.tips[digit]
    meshes = load_spec(mesh_hand.description).compile()
    triangles = mesh_triangles(meshes, mesh_hand.description.prefix + body)
    for tilt in np.radians([0, 20, 40]):
        outward = np.array([0.0, -np.sin(tilt), np.cos(tilt)])
        reach = np.linspace(0, 0.02, 2001)
        outside = [signed_distance(model, body, np.array(centre) + r * outward) > 0 for r in reach]
        surface = np.array(centre) + reach[int(np.argmax(outside))] * outward
        assert distance_to_triangles(surface, triangles) < 0.001, np.degrees(tilt)


def test_a_closure_is_the_opposition_and_the_grasp_size_of_each_row(
    hand: HandModel, reference_posture: np.ndarray
) -> None:
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
    found, origin = tree.frames({"hinge": angles})["link"]
    expected = np.eye(3)[[1, 2, 0]] @ quat_to_matrix(
        np.concatenate([np.cos(angles / 2)[:, None], np.sin(angles / 2)[:, None] * axis], axis=1)
    )
    np.testing.assert_allclose(found, expected, atol=1e-15)
    np.testing.assert_array_equal(origin, np.tile([0.1, 0.0, 0.2], (3, 1)))
    point = tree.points({"hinge": angles}, {"tip": ("link", (0.0, 0.3, -0.1))})["tip"]
    np.testing.assert_allclose(point, origin + expected @ [0.0, 0.3, -0.1], atol=1e-15)


def test_a_fingerprint_names_what_a_hand_is_and_not_where_it_lies(tmp_path: Path) -> None:
    copy = tmp_path / "copy.xml"
    copy.write_bytes(SHADOW_HAND.mjcf.read_bytes())
    assert replace(SHADOW_HAND, mjcf=copy).fingerprint() == SHADOW_HAND.fingerprint()
    assert replace(SHADOW_HAND, pregrasp_rad={}).fingerprint() != SHADOW_HAND.fingerprint()
    copy.write_bytes(copy.read_bytes() + b"<!-- heavier -->")
    assert replace(SHADOW_HAND, mjcf=copy).fingerprint() != SHADOW_HAND.fingerprint()
