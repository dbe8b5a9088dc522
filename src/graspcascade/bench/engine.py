"""The yardstick of trials: what the engine alone takes to step every trial of the unreduced scene to its end."""

from __future__ import annotations

import copy
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..grasps import Grasps
from ..hands import HandModel
from ..objects import grasp_object
from ..trials import PAPER, Protocol, build_scene

STEPPING = "mj_step in a plain loop, one trial at a time on each thread"
"""How the yardstick steps; a few per cent faster than `mujoco.batch` on the same trials and threads."""


class RawEngine:
    """Step grasps through full-length trials of the unreduced scene: all joints, all default pairs.

    No trial ends early, no contact is looked at, and contact sensors are off: nothing is measured but the engine under
    the protocol's controls and gravity.

    Args:
        hand: the hand.
        grasps: what to execute.
        protocol: the trial.
    """

    def __init__(self, hand: HandModel, grasps: Grasps, protocol: Protocol = PAPER) -> None:
        self.protocol, self.grasps = protocol, grasps
        self._scenes = {
            label: build_scene(hand.description, grasp_object(label), protocol, reduced=False)
            for label in sorted(set(grasps.object_label.tolist()))
        }
        for scene in self._scenes.values():
            scene.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        self._pregrasp = hand.clip(self.grasps.pregrasp)
        self._weight_begins = protocol.closing_steps + protocol.shake_steps
        self._own = threading.local()

    @property
    def steps(self) -> int:
        """Count the steps of one measurement."""
        return len(self.grasps) * self.protocol.total_steps

    def measure(self, n_threads: int) -> float:
        """Execute every trial and give steps per second of elapsed time."""
        pool = ThreadPoolExecutor(n_threads)
        try:
            begun = time.perf_counter()
            for _ in pool.map(self.execute, range(len(self.grasps))):
                pass
            return self.steps / (time.perf_counter() - begun)
        finally:
            # After an interrupt, trials that have not begun are not waited for.
            pool.shutdown(cancel_futures=True)

    def execute(self, row: int) -> NDArray[np.float64]:
        """Step one trial to its end.

        Returns:
            ``(7,)`` the object's pose at the end, position in metres and quaternion wxyz, in the hand frame.
        """
        label = str(self.grasps.object_label[row])
        scene, model = self._scenes[label], self._model(label)
        data = mujoco.MjData(model)
        place = slice(scene.object_qpos, scene.object_qpos + 7)
        pose = self.grasps.X_hand_object
        data.qpos[scene.joint_qpos] = self._pregrasp[row]
        data.qpos[place] = np.concatenate([pose.position_m[row], pose.quat_wxyz[row]])
        limits = model.actuator_ctrlrange
        begin, end = (
            np.clip(posture[row] @ scene.control_map, limits[:, 0], limits[:, 1])
            for posture in (self._pregrasp, self.grasps.posture)
        )
        controls = begin + self.protocol.closing_fraction[: self._weight_begins, None] * (end - begin)
        control, gravity = data.ctrl, model.opt.gravity
        for step in range(self._weight_begins):
            control[:] = controls[step]
            gravity[:] = self.protocol.gravity[step]
            mujoco.mj_step(model, data)
        gravity[:] = self.protocol.gravity[-1]
        mujoco.mj_step(model, data, self.protocol.total_steps - self._weight_begins)
        return np.array(data.qpos[place])

    def _model(self, label: str) -> Any:
        """Give this thread's copy of a scene's model: gravity is a field of the model and changes as trials go on."""
        models = self._own.__dict__
        if label not in models:
            models[label] = copy.copy(self._scenes[label].model)
        return models[label]
