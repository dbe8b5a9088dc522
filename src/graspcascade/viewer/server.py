"""Serve the page, one `Page` for each browser that connects, or write one that needs no server."""

from __future__ import annotations

import contextlib
import io
import socket
import warnings
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path

import numpy as np
import viser

from ..core.errors import InputError
from ..core.files import write_text
from ..core.protocols import Carry, Protocol
from ..formats import check_file_place
from ..hands import Hand
from .guard import TITLE, Value, guarded
from .page import Page, Start
from .recording import Frame, Recording
from .session import Batch, Session
from .shapes import SceneNodes, hand_bounds
from .words import table_html

_SIGHT = np.array([-0.5, 0.8, -0.33])
"""Direction of sight in the hand frame: at the palm, from the thumb's side and from above."""
_FIELD_RAD = 0.7
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


class _LocalServer(viser.ViserServer):
    """Serve without ever opening a tunnel to the outside, which a browser could otherwise ask viser for."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        return None


def _takes_nothing(uuid: str, value: Value) -> bool:
    return False


def open_server(
    host: str,
    port: int,
    hand: Hand,
    names: Sequence[str] = (),
    takes: Callable[[str, Value], bool] = _takes_nothing,
) -> viser.ViserServer:
    """Start a server that says nothing by itself and whose camera sees a hand.

    Args:
        host: address to listen on.
        port: port to listen on, 0 for any free one.
        hand: what the camera looks at.
        names: more names that it may be asked for by, beside localhost and the host.
        takes: tells whether the widget of an id can take a value that a browser sent.

    Raises:
        InputError: nothing can listen there, or a version of viser that cannot be guarded.
    """
    _check_address(host, port)
    # viser announces itself on standard output, where a command's own words belong.
    with contextlib.redirect_stdout(io.StringIO()), guarded(host, names, takes) as made:
        server = _LocalServer(host=host, port=port, label=TITLE, verbose=False)
    if not made:
        close_server(server)
        raise InputError(f"viser {viser.__version__} cannot be kept from serving other sites' pages; install viser 1.1")
    if port not in (0, server.get_port()):
        close_server(server)
        raise InputError(f"port {port} of {host} is in use; give another --port")
    centre, radius = hand_bounds(hand)
    camera = server.initial_camera
    camera.position = centre - _SIGHT / np.linalg.norm(_SIGHT) * radius / np.sin(_FIELD_RAD / 2)
    camera.look_at, camera.fov, camera.near = centre, _FIELD_RAD, 0.01
    # viser's own surroundings and shadows keep a machine without a graphics card busy for seconds.
    server.scene.configure_environment_map(None)
    server.scene.configure_default_lights(cast_shadow=False)
    server.scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(120, 120, 140), intensity=2.4)
    server.scene.add_light_directional("/lamp", position=(0.6, -1.0, 0.8), intensity=1.2)
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop a server as quietly as it was started."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def serve(start: Start, host: str = "127.0.0.1", port: int = 8080, names: Sequence[str] = ()) -> viser.ViserServer:
    """Serve pages until the server is stopped; each browser has grasps, trials and scene of its own.

    A browser is answered that asks by localhost, by the host listened on, or by one of `names`.

    Raises:
        InputError: nothing can listen at that address, or the hand has no MJCF.
    """
    # A browser that leaves while a trial plays is nothing to warn of.
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")
    pages: dict[int, Page] = {}

    def takes(uuid: str, value: Value) -> bool:
        return any(page.takes(uuid, value) for page in list(pages.values()))

    server = open_server(host, port, start.hand, names, takes)

    def connect(client: viser.ClientHandle) -> None:
        page = Page(client, start)
        pages[client.client_id] = page
        if client.client_id not in server.get_clients():
            disconnect(client)

    def disconnect(client: viser.ClientHandle) -> None:
        page = pages.pop(client.client_id, None)
        if page is not None:
            page.close()

    # Awaited rather than queued, so that what plays stops at once.
    async def leave(client: viser.ClientHandle) -> None:
        disconnect(client)

    server.on_client_connect(connect)
    server.on_client_disconnect(leave)
    return server


def _check_address(host: str, port: int) -> None:
    """Find out whether a port is free: viser would go on to the next one without a word, or hang on a bad host."""
    if not 0 <= port <= 65535:
        raise InputError(f"port must be between 0 and 65535, got {port}")
    try:
        places = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        for family, kind, protocol, _, address in places:
            with socket.socket(family, kind, protocol) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(address)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot listen on port {port} of {host}: {reason}; give another --port or --host") from error


def write_standalone(path: Path, batch: Batch, hand: Hand, protocol: Protocol) -> int:
    """Execute the first `MAX_SHOWN` grasps, write them as one HTML file that needs no network, and count them."""
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
    # The table goes over the scene and the name into the title.
    name, total, shown = escape(batch.name), len(batch.grasps), len(session)
    left_out = f"<div style='padding:0 0.75em;font-size:0.8em'>the first {shown} of {total}</div>"
    overlay = (
        f'<details open style="{_OVERLAY}"><summary style="padding:0 0.6em;cursor:pointer"><b>{name}</b></summary>'
        f"{left_out if shown < total else ''}{table_html(session, mark=False)}</details>"
    )
    head, end, tail = html.replace("<title>Viser</title>", f"<title>{name} - {TITLE}</title>").rpartition("</body>")
    write_text(path, f"{head}{overlay}{end}{tail}")
    return shown


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
