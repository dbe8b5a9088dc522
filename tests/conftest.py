"""Objects that many tests share because they take a moment to make; none of them is ever changed."""

from dataclasses import replace

import numpy as np
import pytest

from graspcascade.candidates import candidates, draw_sides
from graspcascade.grasps import Grasps
from graspcascade.hands import HandModel, shadow_hand
from graspcascade.objects import CATALOGUE
from graspcascade.postures import PosturePrior
from graspcascade.taxonomy import GRASP_TYPES
from graspcascade.trials import PAPER, Outcomes, Protocol, run


@pytest.fixture(scope="session")
def hand() -> HandModel:
    return shadow_hand()


@pytest.fixture(scope="session")
def prior() -> PosturePrior:
    return PosturePrior.pretrained()


@pytest.fixture(scope="session")
def short() -> Protocol:
    """Give the paper protocol with less time under gravity, for tests that need no full-length trial."""
    return replace(PAPER, name="short", gravity_s=0.4)


@pytest.fixture(scope="session")
def drawn(hand: HandModel, prior: PosturePrior) -> Grasps:
    """Draw a candidate of every type for every object, unscreened."""
    rng = np.random.default_rng(5)
    types, labels = np.repeat(list(GRASP_TYPES), len(CATALOGUE)), np.tile(list(CATALOGUE), len(GRASP_TYPES))
    return candidates(hand, prior.sample(types, rng), types, labels, draw_sides(labels, rng), rng)


@pytest.fixture(scope="session")
def outcomes(drawn: Grasps, short: Protocol) -> Outcomes:
    """Execute the drawn candidates in the short protocol."""
    return run(drawn, short)
