"""What many tests use: hands with fewer digits than the Shadow Hand, and the command line."""

from collections.abc import Mapping

import pytest

from command_line import Call, Said, said_by
from graspcascade.hands import Hand
from hand_files import cut_hand


@pytest.fixture(scope="session")
def cut_hands(tmp_path_factory: pytest.TempPathFactory) -> Mapping[int, Hand]:
    """Cut hands of two, three and four digits out of the Shadow Hand, by their number of digits."""
    return {n: cut_hand(tmp_path_factory.mktemp(f"hand_of_{n}"), n) for n in (2, 3, 4)}


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Call:
    """Call the command line with arguments of any kind."""

    def run(*arguments: object) -> Said:
        return said_by(capsys, *arguments)

    return run
