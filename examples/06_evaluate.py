"""Shows how to compare the heuristic with a trained cascade: the same trials, rates with 95 % intervals."""

from graspcascade import GraspSampler, as_object, as_type
from graspcascade.core.intervals import newcombe
from graspcascade.proposals.heuristic import Heuristic
from graspcascade.studies.evaluate import evaluate

NAMES = [("box_medium", "tripod"), ("cylinder_small", "palmar_pinch"), ("sphere_large", "parallel_extension")]
CELLS = [(as_object(name), as_type(kind)) for name, kind in NAMES]

proposals = {
    "heuristic": Heuristic.pretrained(),
    "model": GraspSampler.pretrained(),
}
evaluations = {
    name: evaluate(proposal, per_cell=10, seed=0, cells=CELLS, name=name) for name, proposal in proposals.items()
}

for name, evaluation in evaluations.items():
    held, faithful = evaluation.held, evaluation.faithful
    print(f"{name}, {evaluation.n} trials under protocol {evaluation.protocol.name}:")
    print(f"  held     {held.rate:5.0%}  (95 %: {held.low:.0%} to {held.high:.0%})")
    print(f"  faithful {faithful.rate:5.0%}  (95 %: {faithful.low:.0%} to {faithful.high:.0%})")

model, base = evaluations["model"].total, evaluations["heuristic"].total
gain = newcombe(model.held, model.n, base.held, base.n)
print(f"held, model over heuristic: {gain.difference:+.0%} (95 %: {gain.low:+.0%} to {gain.high:+.0%})")
