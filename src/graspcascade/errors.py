"""Errors that a user's input can cause, worded so that one line is enough to mend it."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable


class InputError(ValueError):
    """Report input that cannot be used; the message says what was given and what is allowed."""


class FileFormatError(InputError):
    """Report a file that is truncated, foreign or of another schema."""


def unknown(kind: str, given: object, valid: Iterable[str]) -> InputError:
    """Build the error for an unknown name, naming the nearest valid one.

    Args:
        kind: what was asked for, as a person calls it ("grasp type").
        given: the value received.
        valid: every accepted name.
    """
    names = list(valid)
    near = difflib.get_close_matches(str(given).lower().replace(" ", "_"), names, n=1, cutoff=0.5)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    return InputError(f"unknown {kind} {given!r}.{hint} Valid: {', '.join(names)}.")


def check_name(kind: str, given: str, valid: Collection[str]) -> None:
    """Check that a name is one of the valid ones.

    Raises:
        InputError: it is not; see `unknown`.
    """
    if given not in valid:
        raise unknown(kind, given, valid)
