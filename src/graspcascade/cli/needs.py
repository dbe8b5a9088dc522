"""Optional packages, asked for before long work rather than after it."""

from __future__ import annotations

from importlib.util import find_spec

from ..errors import InputError


def need(package: str, extra: str = "train") -> None:
    """Check that a package of an extra is installed.

    Raises:
        InputError: it is not.
    """
    if find_spec(package) is None:
        raise InputError(f"this needs {package}: pip install 'graspcascade[{extra}]'")
