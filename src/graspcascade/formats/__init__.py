"""Grasp files: a name or suffix picks the format, a file appears under its name only when complete."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from ..core.files import write_folder_staged, write_staged
from ..core.grasps import Grasps
from ..core.poses import Pose
from ..hands import Hand
from .document import SCHEMA_VERSION, Assumptions, ExportOptions, GraspDocument, held_rates, keep_limits, place
from .native import document_to_json
from .registry import FORMATS, FORMATS_BY_NAME, GraspFormat, check_file_place, format_to_read, format_to_write

__all__ = [
    "FORMATS",
    "FORMATS_BY_NAME",
    "SCHEMA_VERSION",
    "Assumptions",
    "ExportOptions",
    "GraspDocument",
    "GraspFormat",
    "check_file_place",
    "check_target",
    "document_to_json",
    "held_rates",
    "load_document",
    "load_executable",
    "load_grasps",
    "save_grasps",
]


def save_grasps(
    path: Path | str,
    grasps: Grasps,
    *,
    metadata: dict[str, Any],
    X_world_object: Pose | None = None,
    format: str | None = None,
    options: ExportOptions | None = None,
) -> None:
    """Write grasps to a file, replacing what it held, or to a new folder.

    Args:
        path: its suffix picks the format unless `format` names one; its parent folder must exist.
        grasps: one batch.
        metadata: where the grasps come from (model, seed, versions), anything JSON can hold.
        X_world_object: one object pose ``(3,)``, ``(4,)``; where given, each grasp also carries its hand pose.
        format: a name of `FORMATS_BY_NAME`.
        options: what else to write, for formats that have a place for it.

    Raises:
        InputError: an unknown format or suffix, no such folder, values a file cannot hold, or a format that states the
            hand in contact (`GraspFormat.contact`) and neither trials nor that targets will do.
    """
    path = Path(path)
    chosen = format_to_write(path, format)
    check_file_place(path, chosen.writes_folder(path))
    options = (options or ExportOptions()).with_rates_of(metadata)
    if chosen.contact and options.outcomes is None and options.contact == "settled" and len(grasps):
        raise InputError(
            f"{chosen.name} states the hand in contact, which only a trial tells: give outcomes=run_trials(grasps), or "
            "contact='target' (--no-settle) to state the targets, which lie inside the object"
        )
    if options.hand is not None:
        keep_limits(grasps.columns(), grasps.joint_names, options.hand)
    if not len(grasps) and chosen.writes_folder(path):
        raise InputError(f"a {chosen.name} folder of no grasps cannot be read back; give grasps, or write a .json file")
    if options.outcomes is not None and len(options.outcomes) != len(grasps):
        raise InputError(f"there are {len(options.outcomes)} outcomes for {len(grasps)} grasps")
    if chosen.layout == "folder" and options.object_root is None:
        # Objects are named by where they will be, not by where they are staged.
        options = replace(options, object_root=str(path.resolve() / "objects"))
    document = GraspDocument(grasps, metadata, X_world_object)
    stage = write_folder_staged if chosen.writes_folder(path) else write_staged
    stage(path, lambda staged: chosen.write(staged, document, options))


def load_grasps(
    path: Path | str, format: str | None = None, *, trust_pickle: bool = False, assume: Assumptions | None = None
) -> Grasps:
    """Read the grasps of a file; see `load_document`."""
    return load_document(path, format, trust_pickle=trust_pickle, assume=assume).grasps


def load_document(
    path: Path | str, format: str | None = None, *, trust_pickle: bool = False, assume: Assumptions | None = None
) -> GraspDocument:
    """Read a file or folder with all it says of its grasps.

    Args:
        path: what to read.
        format: a name of `FORMATS_BY_NAME`; by default told from the suffix and content.
        trust_pickle: read pickled files, which run whatever code they carry: only from a source you trust.
        assume: what foreign files do not say of their grasps.

    Raises:
        FileFormatError: it is truncated, foreign or of another schema.
        InputError: an unknown suffix or format, no such file, or a pickled file that is not trusted.
    """
    path = Path(path)
    chosen = format_to_read(path, format)
    if path.is_dir() and chosen.layout == "file":
        raise InputError(f"{path} is a folder; {chosen.name} grasps are read from a file")
    if not path.is_file() and not path.is_dir():
        raise InputError(f"there is no file {path}")
    if chosen.pickled and not trust_pickle:
        risk = "pickled Python objects, and reading those runs whatever code the file carries"
        trust = "if you trust where it comes from, pass trust_pickle=True (--trust-pickle on the command line)"
        raise InputError(f"{path} holds {risk}; {trust}")
    with place(str(path)):
        return chosen.read(path, assume or Assumptions())


def load_executable(path: Path | str, hand: Hand, *, trust_pickle: bool = False) -> GraspDocument:
    """Read a file of grasps for a hand to execute; an InputError says that it has none, or other joints."""
    document = load_document(path, trust_pickle=trust_pickle, assume=Assumptions(hand=hand))
    if not len(document.grasps):
        raise InputError(f"{path} holds no grasps")
    given, needed = document.grasps.joint_names, hand.joint_names
    if missing := [name for name in needed if name not in given]:
        raise InputError(f"{path} lacks joints of {hand.name}: {', '.join(missing)}")
    if extra := [name for name in given if name not in needed]:
        raise InputError(f"{path} has joints that {hand.name} lacks: {', '.join(extra)}")
    return document


def check_target(path: Path | str, format: str | None = None) -> None:
    """Check, before any work is done for it, that grasps can be written under a name; else an InputError."""
    check_file_place(Path(path), format_to_write(Path(path), format).writes_folder(Path(path)))
