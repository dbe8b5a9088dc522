"""``graspcascade view``: the web page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from ..errors import InputError
from ..objects import grasp_object
from ..taxonomy import grasp_type
from .models import load_sampler
from .needs import need

if TYPE_CHECKING:
    from ..viewer.page import Start


@dataclass(frozen=True)
class View:
    """Serve a web page: sample grasps, see them in 3-D, play their trials, download them.

    With --html nothing is served; the grasps and their trials are written as one page that needs no server.
    """

    file: Annotated[Positional[Path | None], arg(metavar="FILE")] = None
    """Grasp file to open; without one the page begins with sampled grasps."""
    trust_pickle: bool = False
    """Unpickle .npy files, which can run any code: only for files you trust."""
    grasp_type: str | None = None
    """Grasp type to begin with (tripod)."""
    object_label: Annotated[str | None, arg(name="object")] = None
    """Catalogue label to begin with (box_medium)."""
    side_axis: str | None = None
    """The side to hold by its body axis (x, y or z); without it, each grasp draws one."""
    n: int | None = None
    """Number of grasps to begin with (10)."""
    seed: int | None = None
    """Seed of the first grasps (0)."""
    friction: float | None = None
    """Friction of the trials; without it, the paper protocol's."""
    model: str = "default"
    """Name of a shipped cascade, or the folder of a trained one."""
    host: str = "127.0.0.1"
    """Address to listen on; anyone who reaches it can use the page."""
    port: int = 8080
    """Port to listen on, 0 for any free one."""
    html: Path | None = None
    """Write a standalone page to this file and serve nothing."""

    def run(self) -> None:
        """Serve until interrupted, or write the page."""
        need("viser", extra="view")
        if self.html is not None and self.html.suffix.lower() not in (".html", ".htm"):
            raise InputError(f"a standalone page is an .html file, got {self.html.name!r}")
        if self.html is not None and not self.html.parent.is_dir():
            raise InputError(f"there is no folder {self.html.parent} to write {self.html.name} into")
        start = self._start()
        if self.html is None:
            self._serve(start)
            return
        from ..viewer.standalone import write_standalone

        shown = write_standalone(self.html, start.batch, start.protocol, start.shapes)
        total = len(start.batch.grasps)
        of_all = "" if shown == total else f" (the first of {total})"
        print(f"wrote {shown} grasps{of_all} with their trials under protocol {start.protocol.name} to {self.html}")

    def _start(self) -> Start:
        asked = {
            name: value
            for name in ("grasp_type", "object_label", "side_axis", "n", "seed")
            if (value := getattr(self, name)) is not None
        }
        if self.file is not None and asked:
            raise InputError(f"give a file or what to sample, not both: {self.file} and {', '.join(asked)}")
        if self.grasp_type is not None:
            asked["grasp_type"] = grasp_type(self.grasp_type).name
        if self.object_label is not None:
            asked["object_label"] = grasp_object(self.object_label).label
        from ..hands import shadow_hand
        from ..trials import PAPER
        from ..viewer import SampleRequest, file_batch, sample_batch, with_friction
        from ..viewer.page import Start
        from ..viewer.scene import HandShapes
        from ..viewer.shapes import hand_meshes

        protocol = PAPER if self.friction is None else with_friction(self.friction)
        request, hand, sampler = SampleRequest(**asked), shadow_hand(), load_sampler(self.model)
        request.check()
        batch = sample_batch(sampler, request) if self.file is None else file_batch(self.file, hand, self.trust_pickle)
        note = "" if self.file is None else f"{len(batch.grasps)} grasps of {self.file.name}"
        return Start(sampler, HandShapes(hand, hand_meshes(hand)), request, protocol, batch, note)

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
