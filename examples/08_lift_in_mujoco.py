"""Shows a grasp commanded in a plain MuJoCo scene: the hand closes, lifts the object 150 mm and holds it."""

import sys

import mujoco
import numpy as np

from graspcascade import GraspSampler, Pose, load_hand
from graspcascade.hands import read_spec
from graspcascade.worlds.world import object_geom

LIFT_M, POST_M = 0.15, 0.25

# Another model of the same hand may be named by its hand file, such as a mesh model's that says `base: shadow`.
hand = load_hand(sys.argv[1] if len(sys.argv) > 1 else "shadow")
grasp = GraspSampler.pretrained().sample("tripod", "cylinder_medium", "x", n=1, seed=1)
(obj,) = grasp.tasks.objects.values()
X_world_object = Pose.of([0.0, 0.0, POST_M + obj.extents_m[2] / 2], [1.0, 0.0, 0.0, 0.0])
# The hand's base follows from the palm's place, the wrist being straight.
X_world_base = grasp.hand_pose(X_world_object) @ hand.X_base_hand.inverse()
position, quat = X_world_base.position_m[0], X_world_base.quat_wxyz[0]

spec = read_spec(hand)
spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10  # fingertips slip less
base = spec.body(hand.prefix + hand.body)
while base.parent.name != "world":
    base = base.parent
base.pos, base.quat = position, quat
base.add_freejoint()
for body in spec.bodies[1:]:
    body.gravcomp = 1  # an arm would carry the hand
# A carrier that the hand is welded to moves it: a hand that is set from place to place has no velocity to lift with.
spec.worldbody.add_body(name="carrier", mocap=True, pos=position, quat=quat)
body_kind, weld_kind = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtEq.mjEQ_WELD
weld = spec.add_equality(name1="carrier", name2=base.name, objtype=body_kind, type=weld_kind)
weld.data[:3] = 0.0  # the anchor, which is preset to another place
weld.data[10] = 1.0  # how much turning counts against shifting
# The object stands on a post.
thing = spec.worldbody.add_body(name="object", pos=X_world_object.position_m)
thing.add_freejoint()
kind, size = object_geom(obj.shape)
thing.add_geom(type=kind, size=size, density=obj.density_kg_m3)
post = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": [0.01, POST_M / 2, 0.0]}
spec.worldbody.add_geom(**post, pos=[0.0, 0.0, POST_M / 2])
model = spec.compile()
data = mujoco.MjData(model)

for joint, angle in zip(grasp.joint_names, grasp.pregrasp[0], strict=True):
    data.joint(hand.prefix + joint).qpos = angle
opened, closed = grasp.controls(hand, opened=True), grasp.controls(hand)
END_S = 5.0
while data.time < END_S:
    closing, raised_m = np.interp(data.time, [0.2, 1.2], [0.0, 1.0]), np.interp(data.time, [2.0, 4.0], [0.0, LIFT_M])
    for name in closed:
        data.actuator(name).ctrl = (1 - closing) * opened[name][0] + closing * closed[name][0]
    data.mocap_pos[0, 2] = position[2] + raised_m
    mujoco.mj_step(model, data)
rose_m = data.body("object").xpos[2] - X_world_object.position_m[2]
print(f"{hand.name}: {obj.name} rose {rose_m * 1000:.0f} mm, {'lifted' if rose_m > 0.9 * LIFT_M else 'not lifted'}")
