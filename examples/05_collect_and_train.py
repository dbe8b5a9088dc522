"""Shows the whole chain in miniature: collect trials as a dataset, train a cascade on them, save it and sample."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from graspcascade import GraspSampler
from graspcascade.cascade import CascadeTraining, factorization, fit_cascade
from graspcascade.dataset import CollectionSpec, collect, load_dataset
from graspcascade.hands import shadow_hand
from graspcascade.nets import TrainingSpec
from graspcascade.postures import PosturePrior
from graspcascade.trials import PAPER

hand, prior = shadow_hand(), PosturePrior.pretrained()
# In earnest: the paper protocol as it is, and 1200 trials for each of the 54 cells of object and type.
short = replace(PAPER, name="short", shake_cycles=1, gravity_s=0.3)
few = CollectionSpec(trials_per_cell=8, round_per_cell=8)

with TemporaryDirectory() as folder:
    data, model = Path(folder) / "data", Path(folder) / "model"
    state = collect(hand, prior, few, data, protocol=short)
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
