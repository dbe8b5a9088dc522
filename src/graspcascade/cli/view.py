"""``graspcascade view``: the web page."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from ..core.errors import InputError
from . import console
from .console import ModelName, OwnHand, PriorFile, Trust

if TYPE_CHECKING:
    from ..viewer.page import Start


@dataclass(frozen=True)
class View:
    """Serve a web page: sample grasps, see them in 3-D, play their trials, download them.

    With --html nothing is served; the grasps and their trials are written as one page that needs no server.
    """

    file: Annotated[Positional[Path | None], arg(metavar="FILE")] = None
    """Grasp file to open; without one the page begins with sampled grasps."""
    trust_pickle: Trust = False
    grasp_type: str | None = None
    """Grasp type to begin with (tripod)."""
    object: str | None = None
    """Object to begin with (box_medium): a catalogue name or a size such as box:32x41x60mm."""
    side_axis: str | None = None
    """The side to hold by its body axis (x, y or z); without it, each grasp draws one."""
    n: int | None = None
    """Number of grasps to begin with (10)."""
    seed: int | None = None
    """Seed of the first grasps (0)."""
    friction: float | None = None
    """Friction of the trials; without it, the paper protocol's."""
    model: ModelName = "default"
    hand: OwnHand = None
    prior: PriorFile = None
    host: str = "127.0.0.1"
    """Address to listen on; anyone who reaches it can use the page."""
    port: int = 8080
    """Port to listen on, 0 for any free one."""
    html: Path | None = None
    """Write a standalone page to this file and serve nothing."""

    def run(self) -> None:
        """Serve until interrupted, or write the page."""
        console.need("viser", extra="view")
        if self.html is not None:
            console.check_out(self.html, ".html", "a standalone page")
        start = self._start()
        if self.html is None:
            self._serve(start)
            return
        from ..viewer.standalone import write_standalone

        shown, total = write_standalone(self.html, start.batch, start.hand, start.protocol), len(start.batch.grasps)
        of_all = "" if shown == total else f" (the first of {total})"
        print(f"wrote {shown} grasps{of_all} with their trials under protocol {start.protocol.name} to {self.html}")

    def _start(self) -> Start:
        from ..core.protocols import PAPER
        from ..viewer.page import Start
        from ..viewer.session import SampleRequest, file_batch, sample_batch, with_friction

        names = {"grasp_type": "grasp_type", "object": "obj", "side_axis": "side_axis", "n": "n", "seed": "seed"}
        given = {name: value for name in names if (value := getattr(self, name)) is not None}
        if self.file is not None and given:
            raise InputError(f"give a file or what to sample, not both: {self.file} and {', '.join(given)}")
        protocol = PAPER if self.friction is None else with_friction(self.friction)
        request = SampleRequest.of(**{names[name]: value for name, value in given.items()})
        proposal = console.load_proposal(self.model, self.hand, self.prior)
        hand = console.load_executing_hand(self.hand, proposal)
        if self.file is None:
            return Start(proposal, hand, request, protocol, sample_batch(proposal, hand, request))
        batch = file_batch(self.file, hand, self.trust_pickle)
        for note in batch.notes:
            print(f"graspcascade view: {note}", file=sys.stderr)
        return Start(proposal, hand, request, protocol, batch, f"{len(batch.grasps)} grasps of {self.file.name}")

    def _serve(self, start: Start) -> None:
        import threading

        from ..viewer.server import close_server, serve

        server = serve(start, self.host, self.port)
        host = f"[{self.host}]" if ":" in self.host else self.host
        print(f"http://{host}:{server.get_port()} shows the page; Ctrl-C ends it", flush=True)
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            # That is how a server is meant to end.
            close_server(server)
