"""The compiled world: frames, physics options, controls and sensors, and objects of other sizes in it."""

from collections.abc import Mapping

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from graspcascade.core.objects import CATALOGUE, DENSITY_KG_M3, Box, Cylinder, GraspObject, Sphere, as_object
from graspcascade.core.protocols import PAPER, Physics
from graspcascade.hands import Hand, load_hand, read_spec
from graspcascade.worlds.world import OBJECT_FIELDS, World, build_world, object_fields, object_rows

HAND = load_hand("shadow")
JOINTS = HAND.joint_names
COUPLED = {coupling.name: coupling.joints for coupling in HAND.couplings}


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(HAND, as_object("box_medium"), PAPER.physics)


@pytest.fixture(scope="module")
def whole() -> World:
    return build_world(HAND, as_object("box_medium"), PAPER.physics, reduced=False)


@pytest.mark.parametrize("reduced", [True, False])
def test_the_palm_frame_is_the_world_frame_and_the_fingers_point_up(reduced: bool) -> None:
    model = build_world(HAND, as_object("sphere_small"), PAPER.physics, reduced=reduced).model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body("palm").xpos, 0, atol=1e-12)
    np.testing.assert_allclose(data.body("palm").xmat.reshape(3, 3), np.eye(3), atol=1e-12)
    assert data.body("forearm").xpos[2] < -0.2
    assert data.body("mfdistal").xpos[2] > 0.15


def test_the_physics_is_the_protocols(world: World) -> None:
    option = world.model.opt
    assert option.timestep == 0.004
    assert option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert option.impratio == 10
    assert option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert not option.gravity.any()
    np.testing.assert_allclose(world.model.geom_friction[:, :2], [[0.8, 0.005]] * world.model.ngeom)
    assert (world.model.geom_condim == 4).all()
    assert not world.model.dof_frictionloss.any()


def test_gains_are_a_multiple_of_the_hands_own_and_force_limits_stay(world: World) -> None:
    own = read_spec(HAND).compile()
    assert world.model.nu == 18
    for i in range(world.model.nu):
        ours, reference = world.model.actuator(i), own.actuator(world.model.actuator(i).name)
        assert ours.gainprm[0] == pytest.approx(3 * reference.gainprm[0])
        assert ours.biasprm[1] == pytest.approx(-3 * reference.gainprm[0])
        np.testing.assert_array_equal(ours.forcerange, reference.forcerange)


def test_a_protocols_numbers_reach_the_world() -> None:
    varied = Physics(friction=0.6, gain_factor=1.0, density_factor=2.0, time_step_s=0.002, impratio=5.0)
    model = build_world(HAND, as_object("sphere_large"), varied).model
    assert (model.geom_friction[:, 0] == 0.6).all()
    assert model.opt.timestep == 0.002
    assert model.opt.impratio == 5.0
    assert model.actuator("FFJ3").gainprm[0] == pytest.approx(1.0)
    assert model.body("object").mass[0] == pytest.approx(2 * DENSITY_KG_M3 * as_object("sphere_large").shape.volume_m3)


@pytest.mark.parametrize("name", CATALOGUE)
def test_the_object_has_its_size_and_mass(name: str) -> None:
    obj = as_object(name)
    model = build_world(HAND, obj, PAPER.physics).model
    assert model.body("object").mass[0] == pytest.approx(DENSITY_KG_M3 * obj.shape.volume_m3)
    x, y, z = np.array(obj.extents_m) / 2
    expected = {"box": [x, y, z], "cylinder": [x, z], "sphere": [x]}[obj.shape.kind]
    np.testing.assert_allclose(model.geom("object").size[: len(expected)], expected)
    np.testing.assert_allclose(model.body("object").ipos, 0, atol=1e-12)


def test_only_the_reduced_world_lacks_the_wrist(world: World, whole: World) -> None:
    n_object = 7
    assert world.model.nq == len(JOINTS) + n_object
    assert whole.model.nq == len(JOINTS) + len(HAND.wrist_joints) + n_object
    for one in (world, whole):
        names = [one.model.joint(int(j)).name for j in range(one.model.njnt)]
        addresses = [one.model.joint(name).qposadr[0] for name in JOINTS]
        np.testing.assert_array_equal(one.joint_qpos, addresses)
        assert one.object_qpos == one.model.joint("object").qposadr[0]
        assert set(JOINTS) <= set(names)


@given(posture=hnp.arrays(float, (len(JOINTS),), elements=st.floats(-1.5, 1.5)))
def test_a_tendon_takes_the_sum_of_its_joints_and_a_motor_its_joint(
    world: World, whole: World, posture: np.ndarray
) -> None:
    angle = dict(zip(JOINTS, posture, strict=True))
    for one in (world, whole):
        control = posture @ one.control_map
        for i in range(one.model.nu):
            name = one.model.actuator(i).name
            # The wrist, which a posture does not name, is held at zero.
            joints = COUPLED.get(name, (name,))
            assert control[i] == pytest.approx(sum(angle.get(joint, 0.0) for joint in joints), abs=1e-12), name


def test_reduced_collisions_keep_the_object_with_the_hand_the_thumb_with_fingers_and_neighbours(world: World) -> None:
    model = world.model

    tested = {
        frozenset((int(model.geom_bodyid[a]), int(model.geom_bodyid[b])))
        for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)
    }
    assert not (model.geom_contype | model.geom_conaffinity).any()

    def collide(a: str, b: str) -> bool:
        return frozenset((int(model.body(a).id), int(model.body(b).id))) in tested

    digits = {"thumb": "thdistal", "index": "ffdistal", "middle": "mfdistal", "ring": "rfdistal", "little": "lfdistal"}
    for body in (*digits.values(), "thbase"):
        assert collide("object", body), body
    for body in ("ffdistal", "mfdistal", "rfdistal", "lfdistal"):
        assert collide("thdistal", body)
    assert collide("ffdistal", "mfdistal")
    assert collide("mfdistal", "rfdistal")
    assert collide("rfdistal", "lfdistal")
    assert not collide("ffdistal", "rfdistal")
    assert not collide("mfdistal", "lfdistal")
    assert model.body("palm").geomnum[0] > 1
    assert collide("object", "palm")
    assert collide("object", "lfmetacarpal")
    assert not collide("palm", "thdistal")


@pytest.mark.parametrize(
    ("body", "column"),
    [
        ("ffdistal", "index"),
        ("mfmiddle", "middle"),
        ("rfproximal", "ring"),
        ("lfdistal", "little"),
        ("thdistal", "thumb"),
        ("palm", "palm"),
        ("lfmetacarpal", "palm"),
    ],
)
def test_touch_sensors_name_the_part_that_touches(body: str, column: str) -> None:
    world = build_world(HAND, as_object("sphere_small"), PAPER.physics)
    data = mujoco.MjData(world.model)
    data.qpos[world.joint_qpos[JOINTS.index("THJ4")]] = 1.22
    mujoco.mj_kinematics(world.model, data)
    geom = world.model.body(body).geomadr[0]
    # The sphere reaches into the part from the palm's side.
    data.qpos[world.object_qpos :][:3] = data.geom_xpos[geom] - [0, 0.02, 0]
    mujoco.mj_forward(world.model, data)
    touching = {
        name: any(data.sensordata[list(places)] > 0)
        for name, places in zip((*HAND.digits, "palm"), world.touch_sensors, strict=True)
    }
    assert touching[column], touching
    assert data.sensordata[world.overlap_sensor] > 0
    assert data.sensordata[world.overlap_sensor + 1] < 0


def test_nothing_touches_a_distant_object(world: World) -> None:
    data = mujoco.MjData(world.model)
    data.qpos[world.object_qpos :][:3] = [0, -0.5, 0]
    mujoco.mj_forward(world.model, data)
    assert not data.sensordata[[place for places in world.touch_sensors for place in places]].any()
    assert data.sensordata[world.overlap_sensor] == 0


# -- objects of any size in one world

PRIMITIVES = [
    *CATALOGUE.values(),
    GraspObject("block", Box(0.015, 0.2, 0.061), 1200.0),
    GraspObject("rod", Cylinder(0.012, 0.31)),
    GraspObject("disc", Cylinder(0.14, 0.008), 90.0),
    GraspObject("ball", Sphere(0.101)),
]


def fields_of(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """List every array of numbers of a compiled model, but for its name."""
    named = ((name, getattr(model, name)) for name in dir(model) if not name.startswith("_"))
    return {
        name: np.atleast_1d(np.asarray(value)).copy()
        for name, value in named
        if isinstance(value, np.ndarray | int | float) and name != "signature"
    }


@pytest.mark.parametrize("reduced", [True, False])
@pytest.mark.parametrize("other", PRIMITIVES[1:], ids=lambda obj: obj.name)
def test_worlds_of_two_objects_differ_in_the_objects_fields_alone_and_these_can_be_computed(
    other: GraspObject, reduced: bool
) -> None:
    first, second = (build_world(HAND, obj, PAPER.physics, reduced=reduced).model for obj in (PRIMITIVES[0], other))
    ours, theirs = fields_of(first), fields_of(second)
    assert set(OBJECT_FIELDS) <= set(ours)
    rows = object_rows(first)
    for name, values in object_fields(other, 1.0).items():
        ours[name][rows[name]] = values
    # The world's own row of the subtree masses counts the object; no step of the physics reads it.
    ours["body_subtreemass"][0] = theirs["body_subtreemass"][0]
    for name, values in theirs.items():
        np.testing.assert_array_equal(ours[name], values, err_msg=name)


@given(factor=st.floats(0.1, 10.0), error_m=st.floats(-0.003, 0.003))
def test_density_and_size_errors_act_on_the_objects_fields_as_another_object_would(
    factor: float, error_m: float
) -> None:
    stated = GraspObject("block", Box(0.03, 0.04, 0.05), 500.0)
    real = GraspObject("other", Box(0.03 + error_m, 0.04 + error_m, 0.05 + error_m), 500.0 * factor)
    theirs = object_fields(real, 1.0)
    for name, values in object_fields(stated, factor, error_m).items():
        np.testing.assert_allclose(values, theirs[name], rtol=1e-9, atol=1e-15, err_msg=name)


@pytest.mark.parametrize("n_digits", [2, 3, 4])
def test_a_smaller_hands_world_has_its_digits_and_no_others(cut_hands: Mapping[int, Hand], n_digits: int) -> None:
    hand = cut_hands[n_digits]
    world = build_world(hand, as_object("sphere:40mm"), PAPER.physics)
    assert len(world.touch_sensors) == n_digits + 1
    assert world.model.nq == len(hand.joint_names) + 7
    assert world.control_map.shape == (len(hand.joint_names), world.model.nu)
    assert world.model.npair > n_digits
