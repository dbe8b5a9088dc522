"""Shows the way from recorded postures in a CSV file to a prior and grasps in physics; needs the train extra."""

import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from graspcascade import Task, Tasks, load_hand, run_trials
from graspcascade.proposals.heuristic import Heuristic
from graspcascade.studies.learn import PRIOR_TRAINING, fit_prior
from graspcascade.studies.postures import export_postures, import_postures
from graspcascade.studies.seeds import SeedSpec, make_seeds

if not find_spec("torch"):
    sys.exit("this example trains: pip install -c constraints.txt '.[train]'")

hand = load_hand("shadow")
with TemporaryDirectory() as folder:
    # A stand-in for your recordings: one row a posture, a grasp_type column and a column for each joint.
    recordings = Path(folder) / "recordings.csv"
    export_postures(recordings, make_seeds(hand, SeedSpec(per_type=12)))
    postures = import_postures(recordings, hand)
print(f"{len(postures)} recorded postures, {postures.n_clipped} angles beyond the joint limits")

# The default training takes more steps; this shows the way alone.
prior = fit_prior(hand, postures, replace(PRIOR_TRAINING, epochs=60, min_steps=0, batch_size=32))

task = Task.of("tip_pinch", "box_small", "x", hand.reach_m)
grasps = Heuristic(hand, prior).propose(Tasks.repeat(task, 12), np.random.default_rng(0))
outcomes = run_trials(grasps)
print(f"{len(grasps)} grasps from this prior: {outcomes.held.sum()} held under protocol paper")
