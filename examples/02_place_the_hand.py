"""Shows where the hand must be, in the world, for an object whose pose in the world is known."""

import numpy as np

from graspcascade import Pose, as_object, load_hand
from graspcascade.proposals.heuristic import Screened

# A tin of one's own size stands on a table 40 cm in front of the robot: its centre is half its height above the table.
tin = as_object("cylinder:42x85mm")
X_world_object = Pose.of([0.40, 0.0, tin.extents_m[2] / 2], [1.0, 0.0, 0.0, 0.0])

grasps = Screened.pretrained().sample("palmar_pinch", tin, n=20, seed=1)
X_world_hand = grasps.hand_pose(X_world_object)

# A robot arm carries the hand's base, a forearm; the palm's pose in it is fixed while the wrist is straight.
X_world_base = X_world_hand @ load_hand("shadow").X_base_hand.inverse()

# The palm looks along the hand's -y axis, and that is the way it comes: from above, where this points down most.
facing = X_world_hand.apply(np.array([0.0, -1.0, 0.0])) - X_world_hand.position_m
best = int(facing[:, 2].argmin())
steep = np.degrees(np.arcsin(-facing[best, 2]))
print(f"of {len(grasps)} grasps, number {best} comes most steeply from above, at {steep:.0f} degrees to the table")
print("palm in the world:    m", X_world_hand.position_m[best].round(4), "wxyz", X_world_hand.quat_wxyz[best].round(4))
print("forearm in the world: m", X_world_base.position_m[best].round(4))
