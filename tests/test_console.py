"""What commands say of their progress where there is no terminal."""

import pytest

from graspcascade.cli.console import Bar


def test_without_a_terminal_progress_is_a_line_a_minute(capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    bar = Bar(None, 100, "trials", clock=lambda: now[0])

    def said() -> str:
        return capsys.readouterr().err

    bar.advance(30)
    assert said() == ""
    now[0] = 61.0
    bar.advance(5)
    assert said() == "trials: 35 of 100\n"
    bar.advance(1)
    assert said() == ""
    now[0] = 122.0
    bar.show(50, 200, "half held")
    assert said() == "trials: 50 of 200, half held\n"


def test_a_total_that_is_not_known_is_not_told(capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    bar = Bar(None, None, "trials", clock=lambda: now[0])
    now[0] = 61.0
    bar.show(7)
    assert capsys.readouterr().err == "trials: 7\n"
