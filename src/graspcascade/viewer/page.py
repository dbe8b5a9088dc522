"""One browser's page: widgets, scene and session, and what each click does."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import viser

from ..cascade import GraspSampler
from ..errors import InputError
from ..trials import Protocol
from .controls import NEXT, SPEEDS, THIS, build, put, request_of, same_side, side_axis, side_choices
from .downloads import pack
from .recording import Recording
from .scene import Actors, HandShapes
from .session import Batch, SampleRequest, Session, sample_batch, with_friction
from .tables import grasp_html, message_html, table_html

_FRAME_S = 0.04
"""Least time between two frames sent while a trial plays."""


@dataclass(frozen=True)
class Start:
    """Say what every browser begins with.

    Attributes:
        sampler: where grasps come from.
        shapes: the hand as it is drawn.
        request: what the panel is set to.
        protocol: the trials' protocol.
        batch: the first grasps shown.
        note: the first message.
    """

    sampler: GraspSampler
    shapes: HandShapes
    request: SampleRequest
    protocol: Protocol
    batch: Batch
    note: str = ""


class Page:
    """Wire the widgets of one browser to its session.

    Clicks arrive on several threads; a lock lets one at a time change session and scene. A trial that plays gives the
    lock back between frames and ends as soon as anything else is asked for.
    """

    def __init__(self, client: viser.ClientHandle, start: Start) -> None:
        self._client, self._start = client, start
        self._lock = threading.RLock()
        self._halt = threading.Event()
        self.session = Session(start.batch, start.protocol)
        with client.atomic():
            self._actors = Actors(client.scene, start.shapes)
            self._controls = build(client.gui, start.request, start.protocol)
            self._new_grasps()
            self._say(start.note)
        self._connect()

    def close(self) -> None:
        """End what still plays."""
        self._halt.set()

    def _connect(self) -> None:
        c = self._controls
        c.object_label.on_update(lambda _: self._choose_object())
        c.sample.on_click(lambda _: self._sample())
        c.flip.on_click(lambda _: self._go(self.session.index + (1 if c.flip.value == NEXT else -1)))
        c.play.on_click(lambda _: self._play())
        c.stop.on_click(lambda _: self._stop())
        c.try_all.on_click(lambda _: self._try_all())
        c.download.on_click(lambda _: self._download())
        # What the page itself writes into a widget must not act as if a person had.
        c.grasp.on_update(_by_hand(lambda: self._go(c.grasp.value)))
        c.view.on_update(_by_hand(self._look))
        c.time.on_update(_by_hand(self._scrub))
        c.friction.on_update(_by_hand(self._choose_friction))

    @contextmanager
    def _action(self) -> Iterator[None]:
        """Do what a click asks for, alone; what cannot be done becomes a message."""
        self._halt.set()
        with self._lock:
            try:
                yield
            except InputError as error:
                self._say(str(error), error=True)

    def _choose_object(self) -> None:
        with self._action():
            c = self._controls
            axis = side_axis(c.side.value)
            choices = side_choices(c.object_label.value)
            c.side.options = choices
            put(c.side, same_side(choices, axis))

    def _sample(self) -> None:
        with self._action():
            self.session.show(sample_batch(self._start.sampler, request_of(self._controls)))
            self._say(f"{len(self.session)} grasps sampled")
            self._new_grasps()

    def _choose_friction(self) -> None:
        with self._action():
            self.session.use(with_friction(self._controls.friction.value))
            self._say(f"trials under protocol {self.session.protocol.name}")
            self._write()

    def _go(self, index: int) -> None:
        with self._action():
            self.session.go(index)
            put(self._controls.grasp, self.session.index)
            self._look()

    def _look(self) -> None:
        with self._action():
            self._controls.time.disabled = True
            view = self._controls.view.value
            if view == "settled" and self.session.outcome is None:
                self._say("executing the trial ...")
            try:
                frame = self.session.frame(view)
            except InputError:
                # The grasp itself can be looked at all the same.
                put(self._controls.view, "posture")
                with self._client.atomic():
                    self._actors.show(self.session.frame("posture"))
                self._write()
                raise
            with self._client.atomic():
                self._actors.show(frame)
            self._say("")
            self._write()

    def _play(self) -> None:
        with self._action():
            self._apply_friction()
            self._say("executing the trial ...")
            recording = self.session.recording()
            c = self._controls
            c.time.max = max(round(float(recording.time_s[-1]), 2), 0.02)
            c.stop.visible, c.time.disabled = True, False
            self._say("")
            self._halt = halt = threading.Event()
        self._run(recording, halt, SPEEDS[self._controls.speed.value])

    def _stop(self) -> None:
        with self._action():
            self._controls.stop.visible = False
            self._write("stopped")

    def _run(self, recording: Recording, halt: threading.Event, speed: float) -> None:
        """Show frames at the pace of the clock, leaving out those that a slow machine comes too late for."""
        began, row = time.monotonic(), 0
        while not halt.is_set():
            with self._lock:
                if halt.is_set():
                    return
                row = recording.row_at((time.monotonic() - began) * speed)
                self._show_moment(recording, row)
            if row == len(recording) - 1:
                break
            halt.wait(_FRAME_S)
        with self._lock:
            if self._halt is halt:
                self._controls.stop.visible = False
                self._write(self._moment(recording, row))

    def _scrub(self) -> None:
        with self._action():
            recording = self.session.recording()
            row = recording.row_at(self._controls.time.value)
            with self._client.atomic():
                self._actors.show(recording.frame(row))
            self._write(self._moment(recording, row))

    def _show_moment(self, recording: Recording, row: int) -> None:
        with self._client.atomic():
            self._actors.show(recording.frame(row))
            put(self._controls.time, round(float(recording.time_s[row]), 2))
            words = grasp_html(self.session, self._moment(recording, row), playing=True)
            if words != self._controls.about.content:
                self._controls.about.content = words

    def _moment(self, recording: Recording, row: int) -> str:
        return f"trial at {recording.time_s[row]:.1f} s: {recording.phase(row)}"

    def _try_all(self) -> None:
        with self._action():
            self._apply_friction()
            self._halt = halt = threading.Event()
            self._controls.stop.visible = True
        left = len(self.session)
        while left and not halt.is_set():
            with self._lock:
                if halt.is_set():
                    return
                left = self.session.try_some()
                self._say(f"tried {len(self.session) - left} of {len(self.session)}")
                self._write()
        with self._lock:
            if self._halt is halt:
                self._controls.stop.visible = False

    def _download(self) -> None:
        with self._action():
            c = self._controls
            rows = [self.session.index] if c.scope.value == THIS else list(range(len(self.session)))
            packed = pack(self.session.batch, c.file_format.value, rows, self.session.outcomes)
            self._client.send_file_download(packed.name, packed.content, save_immediately=True)
            self._say(f"{packed.name} sent")

    def _apply_friction(self) -> None:
        """Take the friction on the panel, which may be one that was refused when it was typed."""
        self.session.use(with_friction(self._controls.friction.value))

    def _new_grasps(self) -> None:
        c, count = self._controls, len(self.session)
        put(c.grasp, 0)
        c.grasp.max, c.grasp.disabled = max(count - 1, 1), count == 1
        put(c.time, 0.0)
        c.stop.visible, c.time.disabled = False, True
        if c.view.value == "settled":
            put(c.view, "posture")
        self._actors.show(self.session.frame(c.view.value))
        self._write()

    def _write(self, shown: str | None = None) -> None:
        c = self._controls
        c.about.content = grasp_html(self.session, shown or c.view.value)
        c.table.content = table_html(self.session)

    def _say(self, text: str, *, error: bool = False) -> None:
        self._controls.message.content = message_html(text, error=error)


def _by_hand(act: Callable[[], None]) -> Callable[[Any], None]:
    def on_update(event: Any) -> None:
        if event.client is not None:
            act()

    return on_update
