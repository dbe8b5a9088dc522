"""Shows how to choose, among the symmetric copies of grasps, the one whose hand stays highest above a table."""

import mujoco
import numpy as np

from graspcascade import GraspSampler, Pose, load_hand
from graspcascade.hands import read_spec

hand = load_hand("shadow")
# A ball, 6 cm thick, lies on a table at z = 0.
X_world_object = Pose.of([0.4, 0.0, 0.03], [1.0, 0.0, 0.0, 0.0])

# The whole hand, forearm included, above a table.
spec = read_spec(hand)
spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.0, 1.0, 1.0])
base = spec.body(hand.prefix + hand.body)
while base.parent.name != "world":
    base = base.parent
base.mocap = True  # it can be put anywhere
model = spec.compile()
data = mujoco.MjData(model)
table = model.geom("table").id
shapes = [g for g in range(model.ngeom) if g != table]


def clearance_mm(batch):
    """Measure how high the lowest point of each hand is above the table, the lower of the open and the closed hand."""
    X_world_base = batch.hand_pose(X_world_object) @ hand.X_base_hand.inverse()
    columns = [model.joint(hand.prefix + name).qposadr[0] for name in batch.joint_names]
    lowest = np.full(len(batch), np.inf)
    for postures in (batch.pregrasp, hand.executed(batch.posture)):
        for row, angles in enumerate(postures):
            data.qpos[columns] = angles
            data.mocap_pos[0], data.mocap_quat[0] = X_world_base.position_m[row], X_world_base.quat_wxyz[row]
            mujoco.mj_kinematics(model, data)
            heights = [mujoco.mj_geomDistance(model, data, table, g, 1.0, None) for g in shapes]
            lowest[row] = min(lowest[row], *heights)
    return 1000 * lowest


grasps = GraspSampler.pretrained().sample("palmar_pinch", "sphere_large", n=8, seed=0)
# A ball looks the same however it is turned; 24 of these ways give the same grasp from 24 sides.
copies = grasps.symmetric_copies()
heights = clearance_mm(copies).reshape(len(grasps), -1)
for number, of_copies in enumerate(heights):
    clear = f"{(of_copies > 0).sum()} of its {len(of_copies)} copies clear the table"
    print(f"grasp {number}: lowest point at {of_copies[0]:.0f} mm; {clear}")

best = int(heights.argmax())
print(f"the best is copy {best % heights.shape[1]} of grasp {best // heights.shape[1]}, at {heights.max():.0f} mm")
X_world_hand = copies[best].hand_pose(X_world_object)
print("palm in the world: m", X_world_hand.position_m[0].round(4), "wxyz", X_world_hand.quat_wxyz[0].round(4))
