"""Write a page that needs no server: the grasps with their trials, playing in any browser."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

import viser

from ..core.files import write_text
from ..core.protocols import Carry, Protocol
from ..formats import check_file_place
from ..hands import Hand
from .recording import Frame, Recording
from .scene import SceneNodes
from .server import TITLE, close_server, open_server
from .session import Batch, Session
from .words import table_html

MAX_SHOWN = 50
"""Most grasps on one standalone page, which holds every frame of every trial."""
_FRAME_S = 0.04
_PAUSE_S = 0.8
"""How long the start and the end of a trial stay."""
_CARRY_SPEED = 5.0
_CAPTION_M = (0.0, -0.06, -0.02)
_OVERLAY = (
    "position:fixed;left:0.75em;bottom:4.5em;z-index:10;max-width:30em;background:rgba(255,255,255,0.92);"
    "border:1px solid #dee2e6;border-radius:0.4em;padding:0.4em 0.2em;font-family:sans-serif;color:#212529"
)


def write_standalone(path: Path, batch: Batch, hand: Hand, protocol: Protocol) -> int:
    """Execute grasps and write them as one HTML file that needs no network.

    Args:
        path: file to write; its folder must exist.
        batch: grasps, of which the first `MAX_SHOWN` are taken.
        hand: the hand that executes them, with its MJCF.
        protocol: of the trials.

    Returns:
        How many grasps are on the page.

    Raises:
        InputError: no such folder.
    """
    check_file_place(path)
    session = Session(Batch(batch.grasps[:MAX_SHOWN], batch.name, batch.metadata), hand, protocol)
    recordings = []
    for index in range(len(session)):
        session.go(index)
        recordings.append(session.recording())
    server = open_server("127.0.0.1", 0, hand)
    try:
        html = _scene_html(server, session, recordings)
    finally:
        close_server(server)
    write_text(path, _with_overlay(html, session, len(batch.grasps)))
    return len(session)


def _scene_html(server: viser.ViserServer, session: Session, recordings: Sequence[Recording]) -> str:
    nodes = SceneNodes(server.scene, session.hand)
    nodes.show(recordings[0].frame(0))
    caption = server.scene.add_label("/caption", "", position=_CAPTION_M, anchor="center-center", font_screen_scale=1.3)
    serializer = server.get_scene_serializer()

    def show(frame: Frame, words: str, lasting_s: float) -> None:
        nodes.show(frame)
        if caption.text != words:
            caption.text = words
        serializer.insert_sleep(lasting_s)

    for index, recording in enumerate(recordings):
        task = session.batch.grasps.tasks[[index]].distinct[0]
        title = f"{index}: {task.grasp_type.name}, {task.object.name}".replace("_", " ")
        show(recording.frame(0), f"{title}: open hand", _PAUSE_S)
        row = 0
        while row < len(recording) - 1:
            phase, words = recording.phase(row)
            speed = _CARRY_SPEED if isinstance(phase, Carry) else 1.0
            fast = f" ({speed:g} x)" if speed != 1.0 else ""
            show(recording.frame(row), f"{title}: {words}{fast}", _FRAME_S)
            row = max(row + 1, recording.row_at(float(recording.time_s[row]) + _FRAME_S * speed))
        verdict = str(recording.outcome.verdict[0]).replace("_", " ")
        show(recording.frame(row), f"{title}: {verdict} (protocol {session.protocol.name})", _PAUSE_S)
    return serializer.as_html()


def _with_overlay(html: str, session: Session, total: int) -> str:
    """Put the table over the scene and the name into the title."""
    name = escape(session.batch.name)
    left_out = f"<div style='padding:0 0.75em;font-size:0.8em'>the first {len(session)} of {total}</div>"
    overlay = (
        f'<details open style="{_OVERLAY}"><summary style="padding:0 0.6em;cursor:pointer"><b>{name}</b></summary>'
        f"{left_out if total > len(session) else ''}{table_html(session, mark=False)}</details>"
    )
    titled = html.replace("<title>Viser</title>", f"<title>{name} - {TITLE}</title>")
    head, end, tail = titled.rpartition("</body>")
    return f"{head}{overlay}{end}{tail}"
