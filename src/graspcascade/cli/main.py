"""Find the verb, read its arguments, run it, and turn what goes wrong into one line and an exit status."""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from ..errors import InputError, check_name

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


class Command(Protocol):
    """A command with its arguments: a frozen dataclass whose fields tyro reads."""

    def run(self) -> None:
        """Do it."""


@dataclass(frozen=True)
class Verb:
    """Say where a command is and what it does.

    Attributes:
        module: module of this package whose class of the verb's name is the command; importing it is its own cost.
        summary: one line for the list of commands.
        resume: how to go on after an interruption, empty where nothing is kept.
    """

    module: str
    summary: str
    resume: str = ""


_AGAIN = "what is finished is kept: run the same command again to go on"

VERBS: Mapping[str, Verb] = {
    "sample": Verb("sample", "grasps of a type for an object, from a trained cascade"),
    "trial": Verb("trial", "execute the grasps of a file in physics"),
    "evaluate": Verb("evaluate", "success rates of a model or of the heuristic", f"with --out, {_AGAIN}"),
    "seeds": Verb("postures", "labelled seed postures by inverse kinematics"),
    "prior": Verb("postures", "train the posture prior from seeds or recordings"),
    "collect": Verb("collect", "collect trials of the heuristic as a dataset", _AGAIN),
    "train": Verb("train", "train a cascade on a dataset"),
    "report": Verb("report", "the results page from committed evaluations, and the figures"),
    "bench": Verb("bench", "how fast trials, sampling and training are on this machine"),
    "view": Verb("view", "a web page: sample, see, try and download grasps"),
    "export": Verb("export", "write the grasps of a file in another format"),
    "hands": Verb("catalogue", "list the hands, or show one's joints, limits and frames"),
    "objects": Verb("catalogue", "list the objects and their graspable sides"),
    "completion": Verb("completion", "a completion script for bash or zsh"),
}
"""Every command by name, in the order of the workflow."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line and give its exit status: 0 done, 2 bad arguments or input, 1 anything else."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    name = arguments[0] if arguments else ""
    try:
        status = _run(name, arguments[1:])
        sys.stdout.flush()
        return status
    except InputError as error:
        return _fail(name, str(error), BAD_INPUT)
    except BrokenPipeError:
        # The reader (head, less) has seen enough; Python would complain once more while closing stdout.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except (OSError, FloatingPointError) as error:
        return _fail(name, str(error), FAILED)
    except KeyboardInterrupt:
        resume = VERBS[name].resume if name in VERBS else ""
        return _fail(name, "interrupted" + (f"; {resume}" if resume else ""), INTERRUPTED)


def _run(name: str, arguments: list[str]) -> int:
    if name in ("-h", "--help"):
        print(_overview())
        return DONE
    if name == "--version":
        from importlib.metadata import version

        print(f"graspcascade {version('graspcascade')}")
        return DONE
    if not name:
        raise InputError(f"give a command: {', '.join(VERBS)} (see graspcascade --help)")
    check_name("command", name, VERBS)
    module = importlib.import_module(f".{VERBS[name].module}", __package__)
    command = _parse(name, getattr(module, name.capitalize()), arguments)
    if command is not None:
        command.run()
    return DONE


def tyro_config() -> tuple[Any, ...]:
    """Give the markers under which tyro reads every command."""
    import tyro

    return (tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone)


def _parse(name: str, verb: type[Command], arguments: list[str]) -> Command | None:
    """Let tyro read the arguments; None when it has printed help.

    Raises:
        InputError: what tyro has to say against the arguments, shortened to one line.
    """
    import tyro

    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(
                verb,
                args=arguments,
                prog=f"graspcascade {name}",
                config=tyro_config(),
            )
    except SystemExit as stop:
        if not stop.code:
            return None
        raise InputError(f"{_gist(complaint.getvalue())} (see graspcascade {name} --help)") from None


def _gist(complaint: str) -> str:
    """Take the first section out of tyro's box: what follows the rule repeats the help."""
    lines = [line.strip(" │") for line in complaint.splitlines() if not line.startswith(("╭", "╰"))]
    rule = next((i for i, line in enumerate(lines) if line.startswith("──")), len(lines))
    return _one_line(" ".join(lines[:rule])) or "the arguments cannot be used"


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _fail(name: str, message: str, status: int) -> int:
    who = f"graspcascade {name}" if name in VERBS else "graspcascade"
    print(f"{who}: {_one_line(message)}", file=sys.stderr)
    return status


def _overview() -> str:
    width = max(map(len, VERBS))
    lines = [f"  {name:<{width}}  {verb.summary}" for name, verb in VERBS.items()]
    return "\n".join(
        [
            "usage: graspcascade COMMAND [OPTIONS]",
            "",
            "Precision grasps for a five-fingered hand, learned from physics.",
            "",
            "commands:",
            *lines,
            "",
            "graspcascade COMMAND --help says what a command takes; graspcascade --version names the version.",
        ]
    )
