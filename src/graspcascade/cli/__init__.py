"""The command line: ``graspcascade <verb>``. Each verb is a module, loaded only when it is called."""

from .main import main

__all__ = ["main"]
