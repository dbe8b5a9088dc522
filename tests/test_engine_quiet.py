"""The engine is quiet while trials run, and as it was before and after."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import mujoco
import numpy as np
import pytest

from graspcascade.engines.mujoco.quiet import quiet_engine


class CutOffError(Exception):
    """Stand for whatever ends a block early."""


@pytest.fixture(autouse=True)
def log(tmp_path: Path) -> Iterator[Path]:
    """Let the engine write where nobody minds, and give it back its settings at the end."""
    before, config = mujoco.MjLogConfig.get(), mujoco.MjLogConfig.get()
    config.logfile, config.logto_console, config.logto_file = str(tmp_path / "log.txt"), False, True
    config.set()
    yield tmp_path / "log.txt"
    before.set()


def warn() -> None:
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qpos[0] = np.nan
    mujoco.mj_checkPos(model, data)
    assert data.warning[mujoco.mjtWarning.mjWARN_BADQPOS].number == 1


def test_warnings_are_counted_and_not_written(log: Path) -> None:
    with quiet_engine():
        warn()
    assert not log.exists()


def test_a_callers_handler_hears_warnings_all_the_same() -> None:
    heard: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(heard.append)
    try:
        with quiet_engine():
            warn()
    finally:
        mujoco.set_mju_user_warning(before)
    assert len(heard) == 1
    assert "QPOS" in heard[0]


def test_afterwards_warnings_are_written_as_before(log: Path) -> None:
    with pytest.raises(CutOffError), quiet_engine():
        raise CutOffError
    warn()
    assert "QPOS" in log.read_text()


def test_blocks_in_several_threads_end_in_any_order(log: Path) -> None:
    """The first to begin ends first, and the other is quiet to its end."""
    both, one = Barrier(2), Barrier(2)

    def early() -> None:
        with quiet_engine():
            both.wait(60)
        one.wait(60)

    def late() -> None:
        with quiet_engine():
            both.wait(60)
            one.wait(60)
            warn()

    with ThreadPoolExecutor(2) as pool:
        for ended in [pool.submit(early), pool.submit(late)]:
            ended.result()
    assert not log.exists()
    warn()
    assert log.exists()
