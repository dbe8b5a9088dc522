"""The compiled scene: frames, physics options, controls and sensors."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from graspcascade.hands import SHADOW_HAND, load_spec
from graspcascade.objects import CATALOGUE, DENSITY_KG_M3, grasp_object
from graspcascade.trials import PAPER, TOUCH_COLUMNS, Scene, build_scene

JOINTS = SHADOW_HAND.joint_names


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene(SHADOW_HAND, grasp_object("box_medium"), PAPER)


@pytest.fixture(scope="module")
def whole() -> Scene:
    return build_scene(SHADOW_HAND, grasp_object("box_medium"), PAPER, reduced=False)


@pytest.mark.parametrize("reduced", [True, False])
def test_the_palm_frame_is_the_world_frame_and_the_fingers_point_up(reduced: bool) -> None:
    model = build_scene(SHADOW_HAND, grasp_object("sphere_small"), PAPER, reduced=reduced).model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body("palm").xpos, 0, atol=1e-12)
    np.testing.assert_allclose(data.body("palm").xmat.reshape(3, 3), np.eye(3), atol=1e-12)
    assert data.body("forearm").xpos[2] < -0.2
    assert data.body("mfdistal").xpos[2] > 0.15


def test_the_physics_is_the_protocols(scene: Scene) -> None:
    option = scene.model.opt
    assert option.timestep == 0.004
    assert option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert option.impratio == 10
    assert option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert not option.gravity.any()
    np.testing.assert_allclose(scene.model.geom_friction[:, :2], [[0.8, 0.005]] * scene.model.ngeom)
    assert (scene.model.geom_condim == 4).all()
    assert not scene.model.dof_frictionloss.any()


def test_gains_are_a_multiple_of_the_hands_own_and_force_limits_stay(scene: Scene) -> None:
    own = load_spec(SHADOW_HAND).compile()
    assert scene.model.nu == 18
    for i in range(scene.model.nu):
        ours, reference = scene.model.actuator(i), own.actuator(scene.model.actuator(i).name)
        assert ours.gainprm[0] == pytest.approx(3 * reference.gainprm[0])
        assert ours.biasprm[1] == pytest.approx(-3 * reference.gainprm[0])
        np.testing.assert_array_equal(ours.forcerange, reference.forcerange)


def test_a_protocols_numbers_reach_the_scene() -> None:
    varied = replace(PAPER, friction=0.6, gain_factor=1.0, density_factor=2.0, time_step_s=0.002, impratio=5.0)
    model = build_scene(SHADOW_HAND, grasp_object("sphere_large"), varied).model
    assert (model.geom_friction[:, 0] == 0.6).all()
    assert model.opt.timestep == 0.002
    assert model.opt.impratio == 5.0
    assert model.actuator("FFJ3").gainprm[0] == pytest.approx(1.0)
    assert model.body("object").mass[0] == pytest.approx(2 * DENSITY_KG_M3 * grasp_object("sphere_large").volume_m3)


@pytest.mark.parametrize("label", CATALOGUE)
def test_the_object_has_its_catalogue_size_and_mass(label: str) -> None:
    obj = grasp_object(label)
    model = build_scene(SHADOW_HAND, obj, PAPER).model
    assert model.body("object").mass[0] == pytest.approx(DENSITY_KG_M3 * obj.volume_m3)
    x, y, z = np.array(obj.extents_m) / 2
    expected = {"box": [x, y, z], "cylinder": [x, z], "sphere": [x]}[obj.shape]
    np.testing.assert_allclose(model.geom("object").size[: len(expected)], expected)
    np.testing.assert_allclose(model.body("object").ipos, 0, atol=1e-12)


def test_only_the_reduced_scene_lacks_the_wrist(scene: Scene, whole: Scene) -> None:
    n_object = 7
    assert scene.model.nq == len(JOINTS) + n_object
    assert whole.model.nq == len(JOINTS) + len(SHADOW_HAND.wrist_joints) + n_object
    for found in (scene, whole):
        names = [found.model.joint(int(j)).name for j in range(found.model.njnt)]
        addresses = [found.model.joint(name).qposadr[0] for name in JOINTS]
        np.testing.assert_array_equal(found.joint_qpos, addresses)
        assert found.object_qpos == found.model.joint("object").qposadr[0]
        assert set(JOINTS) <= set(names)


@given(posture=hnp.arrays(float, (len(JOINTS),), elements=st.floats(-1.5, 1.5)))
def test_a_tendon_takes_the_sum_of_its_joints_and_a_motor_its_joint(
    scene: Scene, whole: Scene, posture: np.ndarray
) -> None:
    angle = dict(zip(JOINTS, posture, strict=True))
    for found in (scene, whole):
        control = posture @ found.control_map
        for i in range(found.model.nu):
            name = found.model.actuator(i).name
            # The wrist, which a posture does not name, is held at zero.
            joints = SHADOW_HAND.coupled.get(name, (name,))
            assert control[i] == pytest.approx(sum(angle.get(joint, 0.0) for joint in joints), abs=1e-12), name


def test_reduced_collisions_keep_the_object_with_the_hand_the_thumb_with_fingers_and_neighbours(scene: Scene) -> None:
    model = scene.model

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
    scene = build_scene(SHADOW_HAND, grasp_object("sphere_small"), PAPER)
    data = mujoco.MjData(scene.model)
    data.qpos[scene.joint_qpos[JOINTS.index("THJ4")]] = 1.22
    mujoco.mj_kinematics(scene.model, data)
    geom = scene.model.body(body).geomadr[0]
    # The sphere reaches into the part from the palm's side.
    data.qpos[scene.object_qpos :][:3] = data.geom_xpos[geom] - [0, 0.02, 0]
    mujoco.mj_forward(scene.model, data)
    touching = {
        name: any(data.sensordata[list(places)] > 0)
        for name, places in zip(TOUCH_COLUMNS, scene.touch_sensors, strict=True)
    }
    assert touching[column], touching
    assert data.sensordata[scene.overlap_sensor] > 0
    assert data.sensordata[scene.overlap_sensor + 1] < 0


def test_nothing_touches_a_distant_object(scene: Scene) -> None:
    data = mujoco.MjData(scene.model)
    data.qpos[scene.object_qpos :][:3] = [0, -0.5, 0]
    mujoco.mj_forward(scene.model, data)
    assert not data.sensordata[[place for places in scene.touch_sensors for place in places]].any()
    assert data.sensordata[scene.overlap_sensor] == 0
