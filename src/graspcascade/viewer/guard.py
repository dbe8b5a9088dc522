"""Whom the server answers, and what of a browser's messages gets through to a page."""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import ipaddress
import logging
import re
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from http import HTTPStatus
from typing import Annotated, Any, Literal

import msgspec
import websockets.asyncio.server
from websockets.datastructures import Headers

from ..core.errors import InputError

TITLE = "graspcascade"
MAX_BROWSERS = 30
_MAX_FRAME_BYTES = 100_000
_MESSAGE_S, _BURST_S = 0.01, 1.0
"""A page that is dragged on sends 20 to 40 messages a second; more than this are read later."""
_REFUSAL = (
    "Refused: asked for by another site's page or by a name that this server was not told. Open it by the address that "
    "it listens on, or start it with --allow-host NAME.\n"
)
_NAME = "[a-z0-9._-]+"
_HOST = re.compile(rf"({_NAME}|\[[0-9a-f:.]+\])(:[0-9]{{1,5}})?")
_LOG = logging.getLogger(__name__)

_Number = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
_Vector = tuple[_Number, _Number, _Number]
_Pixels = Annotated[int, msgspec.Meta(ge=0, le=100_000)]
Value = bool | float | str


class _Camera(msgspec.Struct, tag="ViewerCameraMessage", forbid_unknown_fields=True):
    wxyz: tuple[_Number, _Number, _Number, _Number]
    position: _Vector
    fov: _Number
    near: _Number
    far: _Number
    image_height: _Pixels
    image_width: _Pixels
    look_at: _Vector
    up_direction: _Vector


class _Change(msgspec.Struct, tag="GuiUpdateMessage", forbid_unknown_fields=True):
    uuid: str
    updates: dict[Literal["value"], Value]


_decode = msgspec.msgpack.Decoder(_Camera | _Change).decode


class _Visitor(websockets.asyncio.server.ServerConnection):
    """A browser's connection that hands on what a page can send, no faster than a person makes a page send it.

    viser itself takes any message of its own, uploads and changes of a widget's inner state among them.
    """

    def __init__(self, takes: Callable[[str, Value], bool], *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._takes, self._due_s = takes, 0.0

    async def recv(self, decode: bool | None = None) -> Any:
        """Wait for the next message that is one of the page's; others are dropped."""
        while True:
            raw = await super().recv(decode)
            now_s = time.monotonic()
            self._due_s = max(self._due_s, now_s - _BURST_S) + _MESSAGE_S
            # What is not read yet stays in the browser.
            await asyncio.sleep(max(0.0, self._due_s - now_s))
            with contextlib.suppress(msgspec.MsgspecError, TypeError, ValueError, RecursionError):
                message = _decode(raw if isinstance(raw, bytes) else b"")
                if isinstance(message, _Camera) or all(self._takes(message.uuid, v) for v in message.updates.values()):
                    return raw


def is_own_page(headers: Headers, host: str, names: Sequence[str] = ()) -> bool:
    """Tell whether a request to a server that listens on a host comes from its own page, or from no page at all.

    A page of another site could otherwise drive the server through its reader's browser: by opening a connection of its
    own, which the origin gives away, or by pointing a name of its own at this machine, which the name asked for gives
    away. Names allowed are localhost, the host listened on, and `names`; where the server listens on all addresses, any
    address (which nobody can point elsewhere) and this machine's name.
    """
    asked, origins = headers.get_all("Host"), headers.get_all("Origin")
    parts = _HOST.fullmatch(asked[0].lower()) if len(asked) == 1 else None
    if parts is None or len(origins) > 1:
        return False
    if origins and origins[0].lower() not in (f"http://{parts[0]}", f"https://{parts[0]}"):
        return False
    name, everywhere = parts[1].strip("[]").rstrip("."), host in ("", "0.0.0.0", "::")
    allowed = {"localhost", host.lower(), *(one.lower() for one in names)}
    if everywhere:
        allowed.add(socket.gethostname().lower())
    if name in allowed or name.endswith(".localhost"):
        return True
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        return False
    return everywhere or address.is_loopback


@contextlib.contextmanager
def guarded(host: str, names: Sequence[str], takes: Callable[[str, Value], bool]) -> Iterator[list[str]]:
    """Let a viser server that is made meanwhile answer its own pages alone, and give its page a title.

    viser has no setting for either, but leaves connections to the websockets library, whose own hooks these are.
    What is yielded lists the servers made so, by their host.

    Args:
        host: what the server listens on.
        names: more names that it may be asked for by.
        takes: tells whether the widget of an id can take a value.

    Raises:
        InputError: one of the names is no host name.
    """
    for name in names:
        if not re.fullmatch(_NAME, name.lower()):
            raise InputError(f"a host to allow is a name such as lab.example, without scheme and port; got {name!r}")
    module, made = websockets.asyncio.server, list[str]()
    original: Any = module.serve
    _LOG.addFilter(_is_ours)

    def serve_guarded(*args: Any, process_request: Any, **options: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            if not is_own_page(request.headers, host, names):
                return connection.respond(HTTPStatus.FORBIDDEN, _REFUSAL)
            response = process_request(connection, request)
            if response is None and len(connection.server.connections) >= MAX_BROWSERS:
                return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, f"{MAX_BROWSERS} browsers are connected\n")
            if response is not None and response.headers.get("Content-Type", "").startswith("text/html"):
                _set_title(response)
                # Another site's page could show this one under its own and let a reader click on it.
                response.headers["X-Frame-Options"] = "DENY"
            return response

        made.append(host)
        own = {"max_size": _MAX_FRAME_BYTES, "create_connection": partial(_Visitor, takes), "logger": _LOG}
        return original(*args, process_request=process, **options | own)

    module.serve = serve_guarded  # type: ignore[misc,assignment]
    try:
        yield made
    finally:
        module.serve = original  # type: ignore[misc]


def _is_ours(record: logging.LogRecord) -> bool:
    """Leave out the traceback of a request that was no HTTP."""
    return record.getMessage() != "opening handshake failed"


def _set_title(response: Any) -> None:
    response.body = _titled(response.body, response.headers["Content-Encoding"] == "gzip")
    del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))


@lru_cache(maxsize=4)
def _titled(body: bytes, packed: bool) -> bytes:
    whole = gzip.decompress(body) if packed else body
    whole = whole.replace(b"<title>Viser</title>", f"<title>{TITLE}</title>".encode(), 1)
    return gzip.compress(whole) if packed else whole
