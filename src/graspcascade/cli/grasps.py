"""``graspcascade sample``, ``view`` and ``export``: grasps drawn, shown and written in other formats."""

from __future__ import annotations

import contextlib
import threading
from dataclasses import dataclass, fields
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from tyro.conf import Positional, arg

from .. import formats, hands
from ..core.errors import FileFormatError, InputError
from ..core.grasps import Grasps
from ..core.intervals import wilson
from ..core.objects import as_object
from ..core.poses import Pose
from ..core.taxonomy import as_type
from ..formats.registry import GraspFormat, format_to_read, format_to_write
from . import console
from .console import (
    Flag,
    Friction,
    HandName,
    Json,
    MassG,
    ModelName,
    ObjectPose,
    OwnHand,
    PoseNumbers,
    PriorFile,
    ProtocolName,
    Raw,
    Trust,
    numbers,
)

if TYPE_CHECKING:
    from ..proposals import Proposal
    from ..studies.record import Evaluation
    from ..viewer.page import Start

_PICTURED = 4
_FORMAT_HELP = "Format to write; by default the suffix of --out says. One of " + "; ".join(
    f"{name} ({known.description})" for name, known in formats.FORMATS_BY_NAME.items()
)


@dataclass(frozen=True)
class Sample:
    """Sample grasps of a type for an object.

    Prints a summary, or with --out writes the grasps to a file (.json or .parquet).
    """

    grasp_type: Annotated[Positional[str], arg(metavar="TYPE")]
    """Grasp type: tripod, palmar_pinch, parallel_extension, writing_tripod, lateral_tripod or tip_pinch."""
    object: Annotated[Positional[str], arg(metavar="OBJECT")]
    """Catalogue name, such as box_medium, or a size: box:32x41x60mm, cylinder:27x80mm (diameter x height),
    sphere:40mm."""
    side_cm: float | None = None
    """Length in cm of the side to hold; without a side, each grasp draws one of the graspable sides."""
    side_axis: str | None = None
    """The side to hold by its body axis (x, y or z) instead of its length."""
    n: int = 10
    """Number of grasps."""
    friction: Friction = None
    mass_g: MassG = None
    raw: Raw = False
    seed: int = 0
    """Seed of the draws: the same seed gives the same grasps."""
    object_pose: ObjectPose = None
    out: Path | None = None
    """File to write; the suffix picks the format (.json, .parquet)."""
    format: str | None = None
    """Format of --out by name, where the suffix does not say it; `graspcascade export --help` lists them."""
    picture: Path | None = None
    """Picture to draw, .png: the first four grasps placed, closed and at the end of their trials."""
    model: ModelName = "default"
    hand: OwnHand = None
    prior: PriorFile = None
    json: Json = False

    def run(self) -> None:
        """Sample, then print or write."""
        kind, placed = as_type(self.grasp_type), console.object_pose(self.object_pose)
        obj = console.weighed(as_object(self.object), self.mass_g)
        if self.side_cm is not None and self.side_axis is not None:
            raise InputError("give --side-cm or --side-axis, not both")
        if self.out is not None:
            formats.check_target(self.out, self.format)
        if self.picture is not None:
            # Sampling alone needs neither physics nor a renderer.
            from ..viewer.pictures import check_png, need_matplotlib, need_renderer

            check_png(self.picture)
            need_matplotlib()
            need_renderer()
        if self.raw and self.friction is not None:
            raise InputError("--friction is what grasps are ranked for; give it or --raw, not both")
        proposal = console.load_proposal(self.model, self.hand, self.prior, raw=self.raw)
        proposal = console.with_friction(proposal, self.friction, self.model)
        reach_m = proposal.hand.reach_m
        side = self.side_axis if self.side_cm is None else obj.site_of_length(self.side_cm / 100, reach_m)
        grasps = proposal.sample(kind.name, obj, side, self.n, self.seed)
        console.say("sample", *proposal.notes(grasps))
        asked: dict[str, Any] = {"grasp_type": kind.name, "object": obj.name}
        names = ("side_cm", "side_axis", "n", "friction", "mass_g", "raw", "seed")
        asked |= {name: getattr(self, name) for name in names}
        versions = {"graspcascade": version("graspcascade"), "numpy": np.__version__}
        metadata = proposal.origin(kind, obj) | {"asked": asked, "versions": versions}
        if self.out is not None:
            formats.save_grasps(self.out, grasps, metadata=metadata, X_world_object=placed, format=self.format)
        pictured = grasps[:_PICTURED]
        if self.picture is not None:
            from ..viewer.pictures import Renderer, grasp_strip, save_png

            with Renderer(hands.executing_hand(proposal.hand, self.hand)) as renderer:
                save_png(grasp_strip(renderer, pictured), self.picture)
        if self.json:
            console.print_json(formats.document_to_json(formats.GraspDocument(grasps, metadata, placed)))
            return
        if self.out is not None:
            print(f"wrote {len(grasps)} grasps to {self.out}")
        else:
            _print_summary(grasps, placed)
            # What became of other grasps of the same type and object, where the model was evaluated.
            for cell in metadata["measured"].values():
                rate = console.interval(wilson(cell["held"], cell["n"]).to_json())
                print(f"Of {cell['n']} such grasps, tried under protocol {cell['protocol']}, held: {rate}.")
        if self.picture is not None:
            print(f"drew {len(pictured)} of {len(grasps)} grasps in {self.picture}")


def _print_summary(grasps: Grasps, placed: Pose | None) -> None:
    print(f"{grasps.grasp_type[0]} grasps of {grasps.object_name[0]}; the object in the hand (palm) frame:")
    pose, rows = grasps.X_hand_object, []
    chances = np.isfinite(grasps.probability).any()
    for i, (axis, side_m, grasp_m) in enumerate(zip(grasps.side_axis, grasps.side_m, grasps.grasp_size_m, strict=True)):
        at = numbers(pose.position_m[i] * 1000, "6.1f"), numbers(pose.quat_wxyz[i], "6.3f")
        chance = [f"{100 * grasps.probability[i]:.0f}"] if chances else []
        rows.append([str(i), *chance, f"{axis} {side_m * 100:g}", f"{grasp_m * 100:.1f}", *at])
    chance = ["chance\n%"] if chances else []
    titles = ["#", *chance, "side\ncm", "grasp\ncm", "position mm\n(x y z)", "quaternion\n(w x y z)"]
    console.print_table(titles, rows)
    if placed is not None:
        print("hand (palm) frame in the world, for the object pose given:")
        hand = grasps.hand_pose(placed)
        poses = enumerate(zip(hand.position_m, hand.quat_wxyz, strict=True))
        rows = [[str(i), numbers(place, "7.4f"), numbers(quat, "6.3f")] for i, (place, quat) in poses]
        console.print_table(["#", "position m (x y z)", "quaternion (w x y z)"], rows)
    print("Joint angles: --json prints them, --out FILE.json writes them.")


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
    allow_host: tuple[str, ...] = ()
    """More host names to answer to, such as a proxy's; without them, localhost and --host."""
    html: Path | None = None
    """Write a standalone page to this file and serve nothing."""

    def run(self) -> None:
        """Serve until interrupted, or write the page."""
        console.need("viser", extra="view")
        if self.html is not None:
            console.check_out(self.html, ".html", "a standalone page")
        start = self._start()
        if self.html is not None:
            from ..viewer.server import write_standalone

            shown, total = write_standalone(self.html, start.batch, start.hand, start.protocol), len(start.batch.grasps)
            of_all = "" if shown == total else f" (the first of {total})"
            print(f"wrote {shown} grasps{of_all} with their trials under protocol {start.protocol.name} to {self.html}")
            return
        from ..viewer.server import close_server, serve

        server = serve(start, self.host, self.port, self.allow_host)
        host = f"[{self.host}]" if ":" in self.host else self.host
        print(f"http://{host}:{server.get_port()} shows the page; Ctrl-C ends it", flush=True)
        # Ctrl-C is how a server is meant to end.
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()
        close_server(server)

    def _start(self) -> Start:
        from ..core.protocols import PAPER
        from ..viewer.page import Start
        from ..viewer.session import SampleRequest, file_batch, sample_batch, with_friction

        names = ("grasp_type", "object", "side_axis", "n", "seed")
        given = {name: value for name in names if (value := getattr(self, name)) is not None}
        if self.file is not None and given:
            raise InputError(f"give a file or what to sample, not both: {self.file} and {', '.join(given)}")
        protocol = PAPER if self.friction is None else with_friction(self.friction)
        request = SampleRequest.of(**given)
        proposal: Proposal | None
        if self.file is None or self.hand is None or self.model != "default" or self.prior is not None:
            proposal = console.load_proposal(self.model, self.hand, self.prior)
            hand = hands.executing_hand(proposal.hand, self.hand)
            if self.file is None:
                return Start(proposal, hand, request, protocol, sample_batch(proposal, hand, request))
        else:
            # A file can be looked at with any hand: the model that nobody asked for need not be of it.
            hand, proposal = hands.load_hand(self.hand), None
            with contextlib.suppress(InputError):
                proposal = console.load_proposal(self.model, self.hand)
        console.check_exists(self.file)
        batch = file_batch(self.file, hand, self.trust_pickle)
        console.say("view", *batch.notes)
        return Start(proposal, hand, request, protocol, batch, f"{len(batch.grasps)} grasps of {self.file.name}")


@dataclass(frozen=True)
class Export:
    """Write the grasps of a file in another format.

    docs/formats.md says of each format its frame, joint order and units, and what it loses.
    """

    grasps: Annotated[Positional[Path], arg(metavar="GRASPS")]
    """Grasp file or folder to read, of any format."""
    out: Path
    """File to write, or for dexgraspbench, and several objects, a new folder."""
    format: Annotated[str | None, arg(help=_FORMAT_HELP + ".", metavar="NAME")] = None
    from_format: Annotated[str | None, arg(metavar="NAME")] = None
    """Format of GRASPS; by default told by its suffix and content."""
    trust_pickle: Trust = False
    grasp_type: str | None = None
    """Type of grasps whose file does not say."""
    object: str | None = None
    """What the file's object is, where its name does not say: a catalogue name or a size."""
    side_axis: str | None = None
    """Side axis (x, y or z) of grasps whose file does not say; by default the one nearest to the opposition axis."""
    hand: HandName = "shadow"
    evaluation: Path | None = None
    """Evaluation (JSON) of the model: its held rates become the confidence of grasps without a probability, instead of
    those that came with the model the grasps were sampled from."""
    settle: bool | None = None
    """Try the grasps in physics first and write joints and object pose in contact, where a format has them. By default
    formats that mean a hand in contact (dexgraspbench, dexgraspnet) are settled, others not."""
    only_held: Flag = False
    """Try the grasps in physics first, and write only those that held."""
    protocol: ProtocolName = "paper"
    object_pose: Annotated[PoseNumbers | None, arg(metavar="X Y Z QW QX QY QZ")] = None
    """Object pose in the world, metres and a unit quaternion, instead of the one GRASPS may give."""
    frame_id: str | None = None
    """Name of the frame that poses are in (moveit_grasp); '' for the object's own."""
    parent_link: Literal["forearm", "palm"] = "forearm"
    """Link whose pose is stated (moveit_grasp)."""
    frame_keys: Literal["frame", "frame_link"] = "frame"
    """Whether isaac_grasp says object_frame or object_frame_link, and the same of the gripper."""
    joint_prefix: str = ""
    """Put before link and joint names, such as rh_ (isaac_grasp, moveit_grasp)."""
    joint_numbering: Literal[0, 1] = 1
    """Number of the outermost joints in names, read and written; older Shadow models begin with 0."""
    object_root: str | None = None
    """Folder that object paths are written under (dexgraspbench); by default that of the export itself."""
    json: Json = False

    def run(self) -> None:
        """Read, then write."""
        formats.check_target(self.out, self.format)
        written = format_to_write(self.out, self.format)
        settle = written.contact if self.settle is None else self.settle
        evaluation = None if self.evaluation is None else _evaluation(self.evaluation)
        hand, placed = hands.load_hand(self.hand), console.object_pose(self.object_pose)
        kind = None if self.grasp_type is None else as_type(self.grasp_type).name
        obj = None if self.object is None else as_object(self.object)
        console.check_exists(self.grasps)
        assume = formats.Assumptions(kind, obj, self.side_axis, self.joint_numbering, hand)
        self._check_served(format_to_read(self.grasps, self.from_format), written)
        document = formats.load_document(self.grasps, self.from_format, trust_pickle=self.trust_pickle, assume=assume)
        grasps, metadata, outcomes = document.grasps, document.metadata, None
        if not len(grasps):
            raise InputError(f"{self.grasps} holds no grasps")
        console.say("export", *document.notes, *([] if evaluation is None else _other_origin(evaluation, document)))
        if settle or self.only_held:
            from ..engines import run_trials

            with console.bar("trials", len(grasps)) as progress:
                outcomes = run_trials(grasps, self.protocol, hand=hand, progress=progress.advance)
            if self.only_held:
                tried, kept = len(grasps), outcomes.held
                grasps, outcomes = grasps[kept], outcomes[kept]
                if not kept.any():
                    raise InputError(f"none of the {tried} grasps held under protocol {self.protocol}")
        options = formats.ExportOptions(
            held_rates={} if evaluation is None else formats.held_rates(evaluation),
            outcomes=outcomes,
            contact="settled" if settle else "target",
            frame_id=self.frame_id,
            frame_keys=self.frame_keys,
            parent_link=self.parent_link,
            joint_prefix=self.joint_prefix,
            joint_numbering=self.joint_numbering,
            object_root=self.object_root,
            hand=hand,
        )
        placed = document.X_world_object if placed is None else placed
        formats.save_grasps(
            self.out, grasps, metadata=metadata, X_world_object=placed, format=self.format, options=options
        )
        unknown = int(np.isnan(options.with_rates_of(metadata).confidence(grasps)).sum())
        held = None if outcomes is None else int(outcomes.held.sum())
        if self.json:
            console.print_json({"out": str(self.out), "n": len(grasps), "without_confidence": unknown, "held": held})
            return
        print(f"wrote {len(grasps)} grasps to {self.out}")
        if held is not None:
            print(f"{held} of them held in the trial")
        if unknown and "evaluation" in written.writes_options:
            print(f"{unknown} of them have no measured confidence and say 0: --evaluation FILE.json gives it")

    def _check_served(self, read: GraspFormat, written: GraspFormat) -> None:
        every = formats.FORMATS_BY_NAME.values()
        for option in (option for option in fields(self) if getattr(self, option.name) != option.default):
            of = sorted(one.name for one in every if option.name in (*one.reads_options, *one.writes_options))
            if of and option.name not in (*read.reads_options, *written.writes_options):
                useless = f"--{option.name.replace('_', '-')} says nothing of an export from {read.name}"
                raise InputError(f"{useless} to {written.name}; it is for {', '.join(of)}")


def _other_origin(evaluation: Evaluation, document: formats.GraspDocument) -> list[str]:
    grasps = document.grasps
    said = {"hand": grasps.hand, "model": document.metadata.get("model"), "taxonomy": grasps.tasks.taxonomy}.items()
    other = [(key, getattr(evaluation, key), own) for key, own in said if own not in (None, getattr(evaluation, key))]
    return [f"the evaluation is of {key} {rated}, the grasps are of {own}" for key, rated, own in other]


def _evaluation(path: Path) -> Evaluation:
    # Evaluations load the physics engine.
    from ..studies.record import Evaluation

    try:
        return Evaluation.load(path)
    except FileFormatError as error:
        raise FileFormatError(f"{error} (--evaluation takes what `graspcascade evaluate --json` prints)") from error
