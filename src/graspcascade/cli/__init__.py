"""The command line: ``graspcascade <verb>``. What goes wrong becomes one line and an exit status."""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import re
import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from ..core.errors import InputError, check_name

__all__ = ["VERBS", "main"]
DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


class Verb(NamedTuple):
    """A module of this package, whose class of the verb's name is the command; a line on it; how to go on with it."""

    module: str
    summary: str
    resume: str = ""


_MAY_BE_EMPTY = ("--frame-id", "--joint-prefix")
_AGAIN = "what is finished is kept: run the same command again to go on"
VERBS: Mapping[str, Verb] = {
    "sample": Verb("grasps", "grasps of a type for an object, from a trained cascade or the heuristic"),
    "trial": Verb("trials", "execute the grasps of a file in physics"),
    "verify": Verb("trials", "the share of several varied trials that each grasp of a file holds"),
    "evaluate": Verb("trials", "success rates of a model or of the heuristic", f"with --out, {_AGAIN}"),
    "seeds": Verb("learning", "labelled seed postures by inverse kinematics"),
    "prior": Verb("learning", "train the posture prior from seeds or recordings"),
    "collect": Verb("learning", "collect trials of the heuristic as a dataset", _AGAIN),
    "train": Verb("learning", "train a cascade on a dataset"),
    "build": Verb("learning", "all of these in one: a model for objects of any size, measured", _AGAIN),
    "view": Verb("grasps", "a web page: sample, see, try and download grasps"),
    "export": Verb("grasps", "write the grasps of a file in another format"),
    "hands": Verb("catalogue", "list the hands, or show one's joints, limits and frames"),
    "objects": Verb("catalogue", "list the objects and their graspable sides"),
    "types": Verb("catalogue", "how likely grasps of each type and side of an object are to hold"),
    "completion": Verb("catalogue", "a completion script for bash or zsh"),
}
"""Every command by name, in the order of the workflow."""

_OVERVIEW = """\
usage: graspcascade COMMAND [OPTIONS]

Precision grasps of an asked type for a dexterous hand: joint angles and hand pose, learned from physics.
For example: graspcascade sample tripod box_medium --side-cm 3

commands:
{}

graspcascade COMMAND --help says what a command takes; graspcascade --version names the version."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit status: 0 done, 2 bad arguments or input, 1 anything else."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    name = arguments[0] if arguments else ""
    _open_streams()
    try:
        _run(name, arguments[1:])
        sys.stdout.flush()
        return DONE
    except InputError as error:
        return _fail(name, str(error), BAD_INPUT)
    except BrokenPipeError:
        # The reader (head, less) has seen enough; Python would complain once more while closing stdout.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except (OSError, FloatingPointError) as error:
        return _fail(name, str(error), FAILED)
    except MemoryError as error:
        return _fail(name, f"not enough memory for this {name}: {error}".rstrip(": "), FAILED)
    except KeyboardInterrupt:
        resume = VERBS[name].resume if name in VERBS else ""
        return _fail(name, "interrupted" + (f"; {resume}" if resume else ""), INTERRUPTED)


def _open_streams() -> None:
    # A stream is None where the caller closed it.
    sys.stdout, sys.stderr = (stream or Path(os.devnull).open("w") for stream in (sys.stdout, sys.stderr))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # What is printed may quote what no terminal can show, such as half of a surrogate pair.
            stream.reconfigure(errors="backslashreplace")


def _run(name: str, arguments: list[str]) -> None:
    if name in ("-h", "--help"):
        width = max(map(len, VERBS))
        print(_OVERVIEW.format("\n".join(f"  {name:<{width}}  {verb.summary}" for name, verb in VERBS.items())))
    elif name == "--version":
        from importlib.metadata import version

        print(f"graspcascade {version('graspcascade')}")
    elif not name:
        raise InputError(f"give a command: {', '.join(VERBS)} (see graspcascade --help)")
    else:
        check_name("command", name, VERBS)
        if (command := _parse(name, arguments)) is not None:
            command.run()


def command_class(name: str) -> Any:
    """Load the command of a verb: a frozen dataclass whose fields tyro reads and whose `run()` does it."""
    return getattr(importlib.import_module(f".{VERBS[name].module}", __package__), name.capitalize())


def tyro_config() -> tuple[Any, ...]:
    """List the markers under which tyro reads every command."""
    import tyro

    return (tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone)


def _parse(name: str, arguments: list[str]) -> Any:
    """Let tyro read the arguments, None when it has printed help; its complaint is an `InputError` of one line."""
    import tyro

    verb, complaint = command_class(name), io.StringIO()
    given = {argument.replace("_", "-") for argument in arguments if argument.startswith("--")}
    words = [word for one in arguments for word in (one.split("=", 1) if one.startswith("--") else [one])]
    for before, word in pairwise(["", *words]):
        # An empty path would be the working folder.
        if not word and before.replace("_", "-") not in _MAY_BE_EMPTY:
            raise InputError(f"{before if before.startswith('--') else 'an argument'} is empty")
    for option in given:
        if (opposite := option.replace("--", "--no-", 1)) in given:
            raise InputError(f"give {option} or {opposite}, not both (see graspcascade {name} --help)")
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(verb, args=arguments, prog=f"graspcascade {name}", config=tyro_config())
    except SystemExit as stop:
        if not stop.code:
            return None
        raise InputError(f"{_gist(complaint.getvalue())} (see graspcascade {name} --help)") from None


def _gist(complaint: str) -> str:
    """Take the first section out of tyro's box, in plainer words: what follows the rule repeats the help."""
    sections = re.split(r"\n[│ ]*[─-]{8,}[│ ]*(?=\n)", complaint)
    # On a terminal without box characters a rule also follows the title.
    lines = sections[0 if complaint.startswith("╭") else 1 % len(sections)].splitlines()
    gist = " ".join(" ".join(line.strip(" │") for line in lines if not line.startswith("╭")).split())
    gist = re.sub(r"^Error parsing (?!-)\S+: ", "", gist)
    wrong_count = r"no type matching .* from (\[.*?\])\..*input length (\d+) did not match .* count (\d+).*"
    gist = re.sub(wrong_count, r"\3 values are needed, got \2: \1", gist)
    gist = re.sub(r"no type matching .*? could be instantiated from (\[.*?\])\..*", r"unfit values \1", gist)
    gist = re.sub(r"invalid literal for int\(\) with base 10: ", "a whole number is needed, got ", gist)
    return gist.replace("could not convert string to float: ", "a number is needed, got ") or "unusable arguments"


def _fail(name: str, message: str, status: int) -> int:
    print(f"graspcascade {name}:" if name in VERBS else "graspcascade:", *message.split(), file=sys.stderr)
    return status
