"""Serve the page: one `Page` for each browser that connects."""

from __future__ import annotations

import contextlib
import io
import socket
import threading
import warnings

import viser

from ..errors import InputError
from .page import Page, Start
from .scene import CAMERA_POSITION_M, CAMERA_TARGET_M


class _LocalServer(viser.ViserServer):
    """Serve without ever opening a tunnel to the outside, which a browser could otherwise ask viser for."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        return None


def open_server(host: str, port: int) -> viser.ViserServer:
    """Start a server that says nothing by itself.

    Args:
        host: address to listen on.
        port: port to listen on, 0 for any free one.

    Raises:
        InputError: nothing can listen there.
    """
    _check_address(host, port)
    # viser announces itself on standard output, where a command's own words belong.
    with contextlib.redirect_stdout(io.StringIO()):
        server = _LocalServer(host=host, port=port, label="graspcascade", verbose=False)
    if port not in (0, server.get_port()):
        close_server(server)
        raise InputError(f"port {port} of {host} is in use; give another --port")
    server.initial_camera.position = CAMERA_POSITION_M
    server.initial_camera.look_at = CAMERA_TARGET_M
    server.initial_camera.fov = 0.7
    server.initial_camera.near = 0.01
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
        InputError: nothing can listen at that address.
    """
    # A browser that leaves while a trial plays is nothing to warn of.
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")
    server = open_server(host, port)
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


def _check_address(host: str, port: int) -> None:
    """Find out whether a port is free: viser would go on to the next one without a word, or hang on a bad host."""
    if not 0 <= port <= 65535:
        raise InputError(f"port must be between 0 and 65535, got {port}")
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        for family, kind, protocol, _, address in found:
            with socket.socket(family, kind, protocol) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(address)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot listen on port {port} of {host}: {reason}; give another --port or --host") from error
