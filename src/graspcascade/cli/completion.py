"""``graspcascade completion``: a script that teaches a shell the commands and their options."""

from __future__ import annotations

import contextlib
import importlib
from dataclasses import dataclass
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from .main import VERBS, tyro_config


@dataclass(frozen=True)
class Completion:
    """Print the completion script of a shell, as in: source <(graspcascade completion bash)."""

    shell: Annotated[Positional[Literal["bash", "zsh"]], arg(metavar="bash|zsh")]
    """Which shell."""

    def run(self) -> None:
        """Print the script."""
        import tyro

        commands = {
            name: getattr(importlib.import_module(f".{verb.module}", __package__), name.capitalize())
            for name, verb in VERBS.items()
        }
        # tyro prints the script and then exits as after --help.
        with contextlib.suppress(SystemExit):
            tyro.extras.subcommand_cli_from_dict(
                commands, prog="graspcascade", args=["--tyro-print-completion", self.shell], config=tyro_config()
            )
