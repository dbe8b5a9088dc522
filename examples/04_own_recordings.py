"""Shows the way from recorded hand postures, in a CSV file, to a posture prior and candidate grasps."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from graspcascade.candidates import candidates
from graspcascade.hands import shadow_hand
from graspcascade.postures import PRIOR_TRAINING, SeedSpec, export_postures, fit_prior, import_postures, make_seeds
from graspcascade.trials import run

hand = shadow_hand()
with TemporaryDirectory() as folder:
    # A stand-in for your recordings: one row a posture, a grasp_type column and a column for each joint.
    recordings = Path(folder) / "recordings.csv"
    export_postures(recordings, make_seeds(hand, SeedSpec(per_type=12)))
    postures = import_postures(recordings, hand)
print(f"{len(postures)} recorded postures, {postures.n_clipped} angles beyond the joint limits")

# A minute's training would be 600 epochs; this shows the steps alone.
prior = fit_prior(hand, postures, replace(PRIOR_TRAINING, epochs=60, batch_size=32))

rng = np.random.default_rng(0)
types = np.full(12, "tip_pinch")
grasps = candidates(hand, prior.sample(types, rng), types, np.full(12, "box_small"), np.full(12, "x"), rng)
outcomes = run(grasps)
print(f"{len(grasps)} candidates from this prior: {outcomes.held.sum()} held under protocol paper")
