"""Text and JSON files, read with a clear word on what is wrong and written atomically."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..errors import FileFormatError


def write_text(path: Path, text: str) -> None:
    """Write a text file so that a half-written one is never found under its name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    staged = path.with_name(path.name + ".staged")
    staged.write_text(text, encoding="utf-8")
    staged.replace(path)


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        FileFormatError: it is missing or not JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileFormatError(f"{path} is not a readable JSON file: {error}") from error
