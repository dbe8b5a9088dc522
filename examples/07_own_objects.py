"""Shows grasps of objects of one's own size, a box, a marker pen and a ball, tried in physics."""

from graspcascade import as_object, run_trials
from graspcascade.proposals.heuristic import Screened

# The paper's cascade knows nine objects by name. The heuristic takes any size; screened, it draws another posture where
# the digits would stay too far apart to touch the object.
screened = Screened.pretrained()
ASKED = [
    ("tripod", "box:32x41x60mm", "x"),
    ("palmar_pinch", "cylinder:12x140mm", "x"),
    ("writing_tripod", "sphere:40mm", "x"),
]

for kind, size, axis in ASKED:
    obj = as_object(size)
    # The hand reaches round 65 mm: of the pen, 140 mm long, only the diameter can be held.
    print(f"{obj.name}: {obj.mass_kg * 1000:.0f} g, can be held by {obj.describe_sides(screened.hand.reach_m)}")
    grasps = screened.sample(kind, obj, axis, n=12, seed=0)
    outcomes = run_trials(grasps, "paper")
    # Keep those that held: grasps[outcomes.held].
    print(f"  {kind}: {outcomes.held.sum()} of {len(grasps)} held, {outcomes.faithful(grasps).sum()} type-faithful")
