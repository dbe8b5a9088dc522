"""Shows how to ask for grasps by type, object and side, and what a grasp consists of."""

import numpy as np

from graspcascade import GraspSampler

sampler = GraspSampler.pretrained()
grasps = sampler.sample("tripod", "box_medium", "x", n=3, seed=0)

print(f"{len(grasps)} tripod grasps, holding the {grasps.side_m[0] * 100:g} cm side of box_medium")
for number, grasp in enumerate(grasps):
    position_mm = grasp.X_hand_object.position_m[0] * 1000
    quat_wxyz = grasp.X_hand_object.quat_wxyz[0]
    print(f"grasp {number}: object in the hand frame at {position_mm.round(1)} mm, wxyz {quat_wxyz.round(3)}")
    print(f"  thumb tip to index tip without an object: {grasp.grasp_size_m[0] * 1000:.1f} mm")

print("target joint angles of grasp 0, degrees:")
for name, angles in grasps.posture_by_name().items():
    print(f"  {name}: {np.degrees(angles[0]):6.1f}")
