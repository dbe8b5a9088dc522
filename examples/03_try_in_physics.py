"""Shows how to execute grasps in physics and read each verdict, and which digits touched the object."""

from graspcascade import GraspSampler, run_trials

grasps = GraspSampler.pretrained().sample("lateral_tripod", "sphere_medium", n=8, seed=0)
outcomes = run_trials(grasps, "paper")
faithful = outcomes.faithful(grasps)

for number, touches in enumerate(outcomes.touching_end):
    touching = [name for name, touched in zip(outcomes.touch_columns, touches, strict=True) if touched]
    print(
        f"grasp {number}: {outcomes.verdict[number]:10s} after {outcomes.duration_s[number]:.1f} s, "
        f"at the end touched by {', '.join(touching) or 'nothing'}"
    )

print(f"protocol paper: {outcomes.held.sum()} of {len(grasps)} held, {faithful.sum()} of them type-faithful")
