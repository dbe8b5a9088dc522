"""Errors that a user's input can cause, worded so that one line is enough to mend it."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike, NDArray

MAX_SEED = 2**63 - 1


class InputError(ValueError):
    """Input that cannot be used; the message says what was given and what is allowed."""


class FileFormatError(InputError):
    """A file that is truncated, foreign or of another schema."""


def unknown(kind: str, given: object, valid: Iterable[str]) -> InputError:
    """Build the error for an unknown name of a kind ("grasp type"), with the nearest of the valid ones."""
    names = list(valid)
    hint = f" Did you mean {near!r}?" if (near := nearest(str(given).lower().replace(" ", "_"), names)) else ""
    said = repr(shortened(given)) if isinstance(given, str) else shortened(repr(given))
    return InputError(f"unknown {kind} {said}.{hint} Valid: {', '.join(names)}.")


def nearest(given: str, valid: Iterable[str]) -> str | None:
    """Find the valid name most like the one given, None where none is like it."""
    return next(iter(difflib.get_close_matches(given[:200], list(valid), n=1, cutoff=0.5)), None)


def as_numbers(name: str, given: ArrayLike) -> NDArray[np.float64]:
    """Read numbers as an array of floats, or raise an `InputError` that names them."""
    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be numbers: {shortened(str(error))}") from error


def shortened(text: str) -> str:
    """Cut a text to the 60 characters that a message has room for."""
    return text if len(text) <= 60 else text[:57] + "..."


def check_name(kind: str, given: str, valid: Collection[str]) -> None:
    """Check that a name is one of the valid ones, or raise the error that `unknown` builds."""
    if given not in valid:
        raise unknown(kind, given, valid)


def check_whole(name: str, given: object, least: int = 0, most: int = 1_000_000) -> None:
    """Check that a value is a whole number within bounds, or raise an `InputError` that names both."""
    if not isinstance(given, Integral):
        raise InputError(f"{name} must be a whole number, got {shortened(repr(given))}")
    if int(given) < least:
        raise InputError(f"{name} must {f'be at least {least}' if least else 'not be negative'}, got {given}")
    if int(given) > most:
        raise InputError(f"{name} must be at most {most}, got {shortened(str(given))}")
