"""Shows how to compare the heuristic with a trained cascade: the same trials, rates with 95 % intervals."""

from graspcascade import GraspSampler
from graspcascade.evaluation import evaluate, heuristic_source, model_source, newcombe
from graspcascade.hands import shadow_hand
from graspcascade.postures import PosturePrior

CELLS = [("box_medium", "tripod"), ("cylinder_small", "palmar_pinch"), ("sphere_large", "parallel_extension")]

sources = {
    "heuristic": heuristic_source(shadow_hand(), PosturePrior.pretrained()),
    "model": model_source(GraspSampler.pretrained()),
}
found = {name: evaluate(name, source, per_cell=10, seed=0, cells=CELLS) for name, source in sources.items()}

for name, evaluation in found.items():
    held, faithful = evaluation.held, evaluation.faithful
    print(f"{name}, {evaluation.n} trials under protocol {evaluation.protocol.name}:")
    print(f"  held     {held.rate:5.0%}  (95 %: {held.low:.0%} to {held.high:.0%})")
    print(f"  faithful {faithful.rate:5.0%}  (95 %: {faithful.low:.0%} to {faithful.high:.0%})")

model, base = found["model"].total, found["heuristic"].total
gain = newcombe(model.held, model.n, base.held, base.n)
print(f"held, model over heuristic: {gain.difference:+.0%} (95 %: {gain.low:+.0%} to {gain.high:+.0%})")
