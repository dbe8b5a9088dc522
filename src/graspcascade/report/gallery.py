"""Pictures on the results page: what their files are called, and which of them can be shown."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

TRAINING_CURVES = "training_curves.png"
POSE_FRAMES = "pose_frames.png"


def heat_map_name(stem: str) -> str:
    """Name the heat map of an evaluation by the stem of its file."""
    return f"success_{stem}.png"


def pooled_heat_map_name(model: str) -> str:
    """Name the heat map of one of the paper's models over all its training seeds."""
    return heat_map_name(f"paper_{model}")


@dataclass(frozen=True)
class Gallery:
    """Refer to pictures from a page.

    Attributes:
        page: the Markdown file.
        folder: where pictures lie.
        drawn: whether all are drawn along with the page; otherwise only those that exist are shown.
    """

    page: Path
    folder: Path
    drawn: bool

    def show(self, name: str, caption: str) -> list[str]:
        """Give the blocks of a picture and its caption, none if it cannot be shown."""
        path = self.folder / name
        if not (self.drawn or path.is_file()):
            return []
        link = Path(os.path.relpath(path, self.page.parent)).as_posix()
        return [f"![{caption}]({link})", f"*{caption}.*"]
