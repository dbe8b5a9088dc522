"""Figures onto paper: matplotlib without a display, and small PNG files written atomically."""

from __future__ import annotations

import io
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ...core.errors import InputError
from ...core.files import write_staged

INK = "#22262b"
"""Colour of text."""
FAINT = "#7a828c"
"""Colour of what is said in passing."""
_COLOURS = 256


def need_matplotlib() -> None:
    """Check that figures can be drawn.

    Raises:
        InputError: matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        raise InputError("pictures need matplotlib: install the extra 'view', in a checkout: pip install '.[view]'")


def blank_figure(width_inch: float, height_inch: float) -> Any:
    """Make an empty white figure that belongs to no window."""
    need_matplotlib()
    # Only those who draw wait for matplotlib to load.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_inch, height_inch), facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def check_png(path: Path) -> None:
    """Check the name of a picture before the work of drawing it.

    Raises:
        InputError: it does not end in .png, or its folder does not exist.
    """
    if path.suffix.lower() != ".png":
        raise InputError(f"a picture is a .png file, got {path.name!r}")
    if path.is_dir() or not path.parent.is_dir():
        raise InputError(f"{path} is a folder, or the folder {path.parent} does not exist")


def save_png(figure: Any, path: Path, dpi: int = 120) -> None:
    """Write a figure as a PNG of 256 colours, a fraction of the full file and hard to tell from it."""
    from PIL import Image

    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=dpi)
    image = Image.open(drawn).convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE)
    write_staged(path, lambda staged: image.save(staged, format="PNG", optimize=True))
