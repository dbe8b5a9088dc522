"""Shows the whole chain in miniature: collect trials, train a cascade, save it and sample; needs the train extra."""

import sys
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from graspcascade import GraspSampler, load_hand
from graspcascade.core.protocols import Carry, Close, Protocol, Shake
from graspcascade.nets import TrainingSpec
from graspcascade.proposals.cascade.stages import factorization
from graspcascade.proposals.heuristic import Heuristic
from graspcascade.studies.collect import CollectionSpec, collect
from graspcascade.studies.dataset import load_dataset
from graspcascade.studies.learn import CascadeTraining, fit_cascade

if not (find_spec("torch") and find_spec("pyarrow")):
    sys.exit("this example trains: pip install -c constraints.txt '.[train]'")

hand = load_hand("shadow")
heuristic = Heuristic.pretrained()
# In earnest: the paper protocol as it is, and 1200 trials for each cell, one of 54 pairs of object and type.
short = Protocol("short", (Close(), Shake(cycles=1), Carry(0.3)))
few = CollectionSpec(trials_per_cell=8, round_per_cell=8)

with TemporaryDirectory() as folder:
    data, model = Path(folder) / "data", Path(folder) / "model"
    state = collect(heuristic, few, data, protocol=short)
    trials, held, faithful = state.trials.sum(), state.held.sum(), state.faithful.sum()
    print(f"{trials} trials under protocol {short.name}: {held} held, {faithful} type-faithful")

    training = CascadeTraining(training=TrainingSpec(epochs=15, batch_size=32))
    fitted = fit_cascade(hand, load_dataset(data), factorization("model3"), training)
    for stage, history in fitted.history.items():
        print(f"stage {stage}: loss {history[0].train_loss:.2f} -> {history[-1].train_loss:.2f}")

    fitted.save(model)
    sampler = GraspSampler.load(model)
grasps = sampler.sample("tripod", "box_medium", "x", n=5)
print(f"{sampler.name} drew {len(grasps)} grasps; trained on so little, they are not expected to hold")
