"""``graspcascade sample``: grasps from a trained cascade, or from the heuristic for any size."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from ..core.errors import MAX_SEED, InputError, check_whole
from ..core.grasps import Grasps
from ..core.intervals import wilson
from ..core.objects import GraspObject, as_object
from ..core.poses import Pose
from ..core.taxonomy import GraspType, as_type
from ..formats import GraspDocument, check_target, document_to_json, save_grasps
from ..proposals import Proposal
from ..proposals.cascade.sampler import GraspSampler
from ..proposals.heuristic import SCREENED, SCREENING_DRAWS, cannot_touch
from . import console
from .console import Json, ModelName, ObjectPose, OwnHand, PriorFile, numbers

_PICTURED = 4


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
        check_whole("n", self.n, 1)
        check_whole("seed", self.seed, most=MAX_SEED)
        kind, obj, placed = as_type(self.grasp_type), as_object(self.object), console.object_pose(self.object_pose)
        if self.side_cm is not None and self.side_axis is not None:
            raise InputError("give --side-cm or --side-axis, not both")
        if self.out is not None:
            check_target(self.out, self.format)
        if self.picture is not None:
            _check_picture(self.picture)
        proposal = console.load_proposal(self.model, self.hand, self.prior)
        grasps, metadata = self._draw(proposal, kind, obj), self._metadata(proposal, kind, obj)
        if proposal.name == SCREENED and (wide := int(cannot_touch(proposal.hand, grasps).sum())):
            tried = f"in {SCREENING_DRAWS} draws none was found whose digits can touch the object"
            print(f"graspcascade sample: {wide} of {len(grasps)} grasps are not screened: {tried}", file=sys.stderr)
        if self.out is not None:
            save_grasps(self.out, grasps, metadata=metadata, X_world_object=placed, format=self.format)
        pictured = grasps[:_PICTURED]
        if self.picture is not None:
            self._draw_picture(self.picture, pictured, proposal)
        if self.json:
            console.print_json(document_to_json(GraspDocument(grasps, metadata, placed)))
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

    def _draw(self, proposal: Proposal, kind: GraspType, obj: GraspObject) -> Grasps:
        site, reach = None, proposal.hand.reach_m
        if self.side_cm is not None:
            site = obj.site_of_length(self.side_cm / 100, reach)
        elif self.side_axis is not None:
            site = obj.site(self.side_axis, reach)
        return proposal.propose_alike(obj, kind, site, self.n, np.random.default_rng(self.seed))

    def _metadata(self, proposal: Proposal, kind: GraspType, obj: GraspObject) -> dict[str, Any]:
        if isinstance(proposal, GraspSampler):
            about = proposal.origin(kind, obj)
        else:
            about = {"source": "heuristic", "model": proposal.name, "hand": proposal.hand.name, "measured": {}}
        asked: dict[str, Any] = {"grasp_type": kind.name, "object": obj.name}
        asked |= {"side_cm": self.side_cm, "side_axis": self.side_axis, "n": self.n, "seed": self.seed}
        versions = {"graspcascade": version("graspcascade"), "numpy": np.__version__}
        return about | {"asked": asked, "versions": versions}

    def _draw_picture(self, path: Path, grasps: Grasps, proposal: Proposal) -> None:
        from ..viewer.pictures import Renderer, grasp_strip, save_png

        with Renderer(console.load_executing_hand(self.hand, proposal)) as renderer:
            save_png(grasp_strip(renderer, grasps), path)


def _check_picture(path: Path) -> None:
    # Sampling alone needs neither physics nor a renderer, so both are asked for only here.
    from ..viewer.pictures import check_png, need_matplotlib, need_renderer

    check_png(path)
    need_matplotlib()
    need_renderer()


def _print_summary(grasps: Grasps, placed: Pose | None) -> None:
    print(f"{grasps.grasp_type[0]} grasps of {grasps.object_name[0]}; the object in the hand (palm) frame:")
    pose, rows = grasps.X_hand_object, range(len(grasps))
    columns = {
        "#": [str(i) for i in rows],
        "side\ncm": [f"{grasps.side_axis[i]} {grasps.side_m[i] * 100:g}" for i in rows],
        "grasp\ncm": [f"{grasps.grasp_size_m[i] * 100:.1f}" for i in rows],
        "position mm\n(x y z)": [numbers(pose.position_m[i] * 1000, "6.1f") for i in rows],
        "quaternion\n(w x y z)": [numbers(pose.quat_wxyz[i], "6.3f") for i in rows],
    }
    console.print_table(list(columns), [list(row) for row in zip(*columns.values(), strict=True)])
    if placed is not None:
        hand = grasps.hand_pose(placed)
        print("hand (palm) frame in the world, for the object pose given:")
        console.print_table(
            ["#", "position m (x y z)", "quaternion (w x y z)"],
            [[str(i), numbers(hand.position_m[i], "7.4f"), numbers(hand.quat_wxyz[i], "6.3f")] for i in rows],
        )
    print("Joint angles: --json prints them, --out FILE.json writes them.")
