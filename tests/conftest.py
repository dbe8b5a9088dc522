"""Hands with fewer digits than the Shadow Hand, for all tests."""

from collections.abc import Mapping

import pytest

from graspcascade.hands import Hand
from hand_files import cut_hand


@pytest.fixture(scope="session")
def cut_hands(tmp_path_factory: pytest.TempPathFactory) -> Mapping[int, Hand]:
    """Cut hands of two, three and four digits out of the Shadow Hand, by their number of digits."""
    return {n: cut_hand(tmp_path_factory.mktemp(f"hand_of_{n}"), n) for n in (2, 3, 4)}
