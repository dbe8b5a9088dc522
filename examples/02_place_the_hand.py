"""Shows where the hand must be, in the world, for an object whose pose in the world is known."""

import numpy as np

from graspcascade import GraspSampler, Pose
from graspcascade.hands import shadow_hand

# A cylinder stands on a table 40 cm in front of the robot: its centre is half its height above the table.
X_world_object = Pose.of([0.40, 0.0, 0.035], [1.0, 0.0, 0.0, 0.0])

grasps = GraspSampler.pretrained().sample("palmar_pinch", "cylinder_medium", n=20, seed=1)
X_world_hand = grasps.hand_pose(X_world_object)

# A robot arm carries the forearm; the palm's pose in the forearm is fixed while the wrist is straight.
X_world_forearm = X_world_hand @ shadow_hand().X_forearm_hand.inverse()

# Fingers point along the hand's z axis: the grasp that comes most steeply from above has the lowest such z.
fingers = X_world_hand.apply(np.array([0.0, 0.0, 1.0])) - X_world_hand.position_m
best = int(fingers[:, 2].argmin())
print(f"of {len(grasps)} grasps, number {best} comes most steeply from above")
print("palm in the world:    m", X_world_hand.position_m[best].round(4), "wxyz", X_world_hand.quat_wxyz[best].round(4))
print("forearm in the world: m", X_world_forearm.position_m[best].round(4))
