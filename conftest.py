"""Objects that many tests share because they take a moment to make; none of them is ever changed."""

import numpy as np
import pytest

from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import CATALOGUE
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.protocols import Carry, Close, Protocol, Shake
from graspcascade.core.tasks import draw_tasks
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.engines import run_trials
from graspcascade.hands import Hand, load_hand
from graspcascade.proposals.heuristic import place
from graspcascade.proposals.prior import PosturePrior


@pytest.fixture(scope="session")
def hand() -> Hand:
    """Read the Shadow Hand."""
    return load_hand("shadow")


@pytest.fixture(scope="session")
def prior() -> PosturePrior:
    """Read the prior that ships with the package."""
    return PosturePrior.pretrained()


@pytest.fixture(scope="session")
def short() -> Protocol:
    """Make the paper protocol with less time under weight, for tests that need no full-length trial."""
    return Protocol("short", (Close(), Shake(), Carry(0.4)))


@pytest.fixture(scope="session")
def drawn(hand: Hand, prior: PosturePrior) -> Grasps:
    """Draw a grasp of every type for every catalogue object, unscreened: 54 rows, the nine of a type together."""
    rng = np.random.default_rng(5)
    cells = [(obj, kind) for kind in GRASP_TYPES.values() for obj in CATALOGUE.values()]
    postures = prior.sample([kind.name for _, kind in cells], rng)
    return place(hand, postures, draw_tasks(cells, 1, hand.reach_m, rng), rng)


@pytest.fixture(scope="session")
def outcomes(drawn: Grasps, short: Protocol) -> Outcomes:
    """Try the drawn grasps in the short protocol."""
    return run_trials(drawn, short)
