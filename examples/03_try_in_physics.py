"""Shows how to execute grasps in physics and read each verdict, and which digits touched the object."""

from graspcascade import GraspSampler
from graspcascade.trials import PAPER, TOUCH_COLUMNS, run

grasps = GraspSampler.pretrained().sample("lateral_tripod", "sphere_medium", n=8, seed=0)
outcomes = run(grasps, PAPER)
faithful = outcomes.faithful(grasps)

for number in range(len(grasps)):
    touching = [name for name, touches in zip(TOUCH_COLUMNS, outcomes.touching_end[number], strict=True) if touches]
    print(
        f"grasp {number}: {outcomes.verdict[number]:10s} after {outcomes.duration_s[number]:.1f} s, "
        f"at the end touched by {', '.join(touching) or 'nothing'}"
    )

print(f"protocol {PAPER.name}: {outcomes.held.sum()} of {len(grasps)} held, {faithful.sum()} of them type-faithful")
