"""The command line called in this process, and what it said."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from graspcascade.cli import main


@dataclass(frozen=True)
class Said:
    status: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


Call = Callable[..., Said]


def said_by(capsys: pytest.CaptureFixture[str], *arguments: object) -> Said:
    """Call the command line and collect what it alone prints."""
    capsys.readouterr()
    status = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return Said(status, captured.out, captured.err)


def assert_refused(said: Said, *words: str) -> None:
    """Check for status 2 and one line on standard error that has every word."""
    assert said.status == 2
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    for word in words:
        assert word in said.err
