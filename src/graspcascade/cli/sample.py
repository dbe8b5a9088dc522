"""``graspcascade sample``: grasps from a trained cascade."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from ..cascade import GraspSampler
from ..errors import InputError
from ..formats import GraspDocument, check_target, document_to_json, save_grasps
from ..grasps import Grasps
from ..intervals import wilson
from ..objects import grasp_object
from ..poses import Pose
from .console import at_least, interval, print_json, print_table
from .models import load_sampler

PoseNumbers = tuple[float, float, float, float, float, float, float]

_PICTURED = 4


@dataclass(frozen=True)
class Sample:
    """Sample grasps of a type for an object from a trained cascade.

    Prints a summary, or with --out writes the grasps to a file (.json or .parquet).
    """

    grasp_type: Annotated[Positional[str], arg(metavar="TYPE")]
    """Grasp type: tripod, palmar_pinch, parallel_extension, writing_tripod, lateral_tripod or tip_pinch."""
    object_label: Annotated[Positional[str], arg(metavar="OBJECT")]
    """Catalogue label, such as box_medium; `graspcascade objects` lists them."""
    side_cm: float | None = None
    """Length in cm of the side to hold; without a side, each grasp draws one of the graspable sides."""
    side_axis: str | None = None
    """The side to hold by its body axis (x, y or z) instead of its length."""
    n: int = 10
    """Number of grasps."""
    seed: int = 0
    """Seed of the draws: the same seed gives the same grasps."""
    object_pose: Annotated[PoseNumbers | None, arg(metavar="X Y Z QW QX QY QZ")] = None
    """Object pose in the world, metres and a unit quaternion: also gives the hand's pose in the world."""
    out: Path | None = None
    """File to write; the suffix picks the format (.json, .parquet)."""
    format: str | None = None
    """Format of --out by name, where the suffix does not say it; `graspcascade export --help` lists them."""
    picture: Path | None = None
    """Picture to draw, .png: the first four grasps placed, closed and at the end of their trials."""
    model: str = "default"
    """Name of a shipped cascade, or the folder of a trained one."""
    json: bool = False
    """Print the grasps as JSON, as in a .json file."""

    def run(self) -> None:
        """Sample, then print or write."""
        at_least("n", self.n, 1)
        at_least("seed", self.seed, 0)
        if self.side_cm is not None and self.side_axis is not None:
            raise InputError("give --side-cm or --side-axis, not both")
        if self.out is not None:
            check_target(self.out, self.format)
        if self.picture is not None:
            _check_picture(self.picture)
        placed = None if self.object_pose is None else Pose.of(self.object_pose[:3], self.object_pose[3:])
        axis = self.side_axis
        if self.side_cm is not None:
            axis = grasp_object(self.object_label).side_axis_of_length(self.side_cm / 100)
        sampler = load_sampler(self.model)
        grasps = sampler.sample(self.grasp_type, self.object_label, axis, self.n, self.seed)
        metadata = self._metadata(sampler)
        if self.out is not None:
            save_grasps(self.out, grasps, metadata=metadata, X_world_object=placed, format=self.format)
        if self.picture is not None:
            _draw(self.picture, grasps[:_PICTURED])
        if self.json:
            print_json(document_to_json(GraspDocument(grasps, metadata, placed)))
        elif self.out is not None:
            print(f"wrote {len(grasps)} grasps to {self.out}")
        else:
            _print_summary(grasps, placed)
            _print_measured(metadata["measured"])
        if self.picture is not None and not self.json:
            print(f"drew {min(len(grasps), _PICTURED)} of {len(grasps)} grasps in {self.picture}")

    def _metadata(self, sampler: GraspSampler) -> dict[str, Any]:
        asked: dict[str, Any] = {"grasp_type": self.grasp_type, "object": self.object_label}
        asked |= {"side_cm": self.side_cm, "side_axis": self.side_axis, "n": self.n, "seed": self.seed}
        versions = {"graspcascade": version("graspcascade"), "numpy": np.__version__}
        return sampler.origin(self.grasp_type, self.object_label) | {"asked": asked, "versions": versions}


def _check_picture(path: Path) -> None:
    # Sampling alone needs neither physics nor a renderer, so both are asked for only here.
    from ..pictures import need_matplotlib, need_renderer
    from ..pictures.paper import check_png

    check_png(path)
    need_matplotlib()
    need_renderer()


def _draw(path: Path, grasps: Grasps) -> None:
    from ..pictures import Studio, grasp_strip, save_png

    with Studio() as studio:
        save_png(grasp_strip(studio, grasps), path)


def _print_summary(grasps: Grasps, placed: Pose | None) -> None:
    print(f"{grasps.grasp_type[0]} grasps of {grasps.object_label[0]}; the object in the hand (palm) frame:")
    pose, numbers = grasps.X_hand_object, range(len(grasps))
    columns = {
        "#": [str(i) for i in numbers],
        "side\ncm": [f"{grasps.side_axis[i]} {grasps.side_m[i] * 100:g}" for i in numbers],
        "grasp\ncm": [f"{grasps.grasp_size_m[i] * 100:.1f}" for i in numbers],
        "position mm\n(x y z)": [_numbers(pose.position_m[i] * 1000, "6.1f") for i in numbers],
        "quaternion\n(w x y z)": [_numbers(pose.quat_wxyz[i], "6.3f") for i in numbers],
    }
    print_table(list(columns), [list(row) for row in zip(*columns.values(), strict=True)])
    if placed is not None:
        hand = grasps.hand_pose(placed)
        print("hand (palm) frame in the world, for the object pose given:")
        rows = [
            [str(i), _numbers(hand.position_m[i], "7.4f"), _numbers(hand.quat_wxyz[i], "6.3f")]
            for i in range(len(grasps))
        ]
        print_table(["#", "position m (x y z)", "quaternion (w x y z)"], rows)
    print("Joint angles: --json prints them, --out FILE.json writes them.")


def _numbers(values: np.ndarray[Any, np.dtype[np.float64]], form: str) -> str:
    return " ".join(format(float(value), form) for value in values)


def _print_measured(cells: Mapping[str, Mapping[str, Any]]) -> None:
    """Tell what became of other grasps of the same type and object, where the model was evaluated."""
    for found in cells.values():
        of_all = wilson(found["held"], found["n"]).to_json()
        print(f"Of {found['n']} such grasps, tried under protocol {found['protocol']}, held: {interval(of_all)}.")
