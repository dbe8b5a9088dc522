"""Serve the page: one `Page` for each browser that connects."""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import io
import ipaddress
import socket
import threading
import warnings
from collections.abc import Iterator
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import viser
import websockets.asyncio.server

from ..core.errors import InputError
from ..hands import Hand
from .page import Page, Start
from .shapes import hand_bounds

TITLE = "graspcascade"
_SIGHT = np.array([-0.5, 0.8, -0.33])
"""Direction of sight in the hand frame: at the palm, from the thumb's side and from above."""
_FIELD_RAD = 0.7
_REFUSAL = "Refused: asked for by another site's page or an unknown host name. Open it by the machine's address.\n"


class _LocalServer(viser.ViserServer):
    """Serve without ever opening a tunnel to the outside, which a browser could otherwise ask viser for."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        return None


def open_server(host: str, port: int, hand: Hand) -> viser.ViserServer:
    """Start a server that says nothing by itself and looks at a hand.

    Args:
        host: address to listen on.
        port: port to listen on, 0 for any free one.
        hand: what the camera is to show.

    Raises:
        InputError: nothing can listen there, or a version of viser that cannot be guarded.
    """
    _check_address(host, port)
    # viser announces itself on standard output, where a command's own words belong.
    with contextlib.redirect_stdout(io.StringIO()), _own_pages_only(host) as guarded:
        server = _LocalServer(host=host, port=port, label=TITLE, verbose=False)
    if not guarded:
        close_server(server)
        raise InputError(f"viser {viser.__version__} cannot be kept from serving other sites' pages; install viser 1.1")
    if port not in (0, server.get_port()):
        close_server(server)
        raise InputError(f"port {port} of {host} is in use; give another --port")
    server.get_event_loop().set_exception_handler(_on_error)
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


def serve(start: Start, host: str = "127.0.0.1", port: int = 8080) -> viser.ViserServer:
    """Serve pages until the server is stopped; each browser has grasps, trials and scene of its own.

    Raises:
        InputError: nothing can listen at that address, or the hand has no MJCF.
    """
    # A browser that leaves while a trial plays is nothing to warn of.
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")
    server = open_server(host, port, start.hand)
    pages: dict[int, Page] = {}
    lock = threading.Lock()

    def connect(client: viser.ClientHandle) -> None:
        page = Page(client, start)
        with lock:
            pages[client.client_id] = page
        if client.client_id not in server.get_clients():
            disconnect(client)

    async def leave(client: viser.ClientHandle) -> None:
        disconnect(client)

    def disconnect(client: viser.ClientHandle) -> None:
        with lock:
            page = pages.pop(client.client_id, None)
        if page is not None:
            page.close()

    server.on_client_connect(connect)
    # Awaited rather than queued, so that what plays stops at once.
    server.on_client_disconnect(leave)
    return server


def is_own_page(headers: Any, host: str) -> bool:
    """Tell whether a request comes from this server's own page, or from no page at all.

    A page of another site could otherwise drive the server through its reader's browser: by opening a connection of its
    own, which the origin gives away, or by pointing a name of its own at this machine, which the host gives away.

    Args:
        headers: of the request.
        host: address that the server listens on.
    """
    asked, origin = headers.get("Host", ""), headers.get("Origin")
    name = (urlsplit(f"//{asked}").hostname or "").rstrip(".")
    known = name in {"localhost", host.lower(), socket.gethostname().lower()} or name.endswith(".localhost")
    if not known:
        try:
            ipaddress.ip_address(name)  # an address cannot be pointed elsewhere
        except ValueError:
            return False
    return origin is None or urlsplit(origin).netloc.lower() == asked.lower()


@contextlib.contextmanager
def _own_pages_only(host: str) -> Iterator[list[str]]:
    """Let a viser server that is made meanwhile refuse requests of other sites' pages, and give its page a title.

    viser has no setting for either, but leaves every request to a function that it hands to the websockets library.

    Yields:
        What servers were made so, by their host.
    """
    module, guarded = websockets.asyncio.server, list[str]()
    original: Any = module.serve

    def serve_guarded(*args: Any, process_request: Any, **options: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            if not is_own_page(request.headers, host):
                return connection.respond(HTTPStatus.FORBIDDEN, _REFUSAL)
            response = process_request(connection, request)
            if response is not None and response.headers.get("Content-Type", "").startswith("text/html"):
                _set_title(response)
            return response

        guarded.append(host)
        return original(*args, process_request=process, **options)

    module.serve = serve_guarded  # type: ignore[misc,assignment]
    try:
        yield guarded
    finally:
        module.serve = original  # type: ignore[misc]


def _set_title(response: Any) -> None:
    packed = response.headers["Content-Encoding"] == "gzip"
    body = gzip.decompress(response.body) if packed else response.body
    body = body.replace(b"<title>Viser</title>", f"<title>{TITLE}</title>".encode(), 1)
    response.body = gzip.compress(body, 1) if packed else body
    del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))


def _on_error(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Leave out the traceback of a value that a browser sent and that is not of its widget's type."""
    if not isinstance(context.get("exception"), ValueError | TypeError | AssertionError | OverflowError):
        loop.default_exception_handler(context)


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
