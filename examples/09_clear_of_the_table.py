"""Shows how to choose, among the symmetric copies of grasps, the one whose hand stays highest above a table."""

import numpy as np

from graspcascade import GraspSampler, Pose, load_hand

hand = load_hand("shadow")
# A ball, 6 cm thick, lies on a table at z = 0.
X_world_object = Pose.of([0.4, 0.0, 0.03], [1.0, 0.0, 0.0, 0.0])


def clearance_mm(batch):
    """Measure how high the lowest contact place or the palm of each hand is above the table, open and closed."""
    X_world_hand = batch.hand_pose(X_world_object)
    lowest = X_world_hand.position_m[:, 2]
    for posture in (batch.pregrasp, batch.posture):
        for place in hand.place_points(posture, list(hand.places)).values():
            lowest = np.minimum(lowest, X_world_hand.apply(place.point_m)[:, 2])
    return 1000 * lowest


grasps = GraspSampler.pretrained().sample("tripod", "sphere_large", n=5, seed=0)
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
