"""The grasp file formats, as data, and which of them a path means."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, cast

from ..core.errors import FileFormatError, InputError, unknown
from ..core.yaml_files import YAML_SUFFIXES, yaml_files
from .document import Assumptions, ExportOptions, GraspDocument, place


@dataclass(frozen=True)
class GraspFormat:
    """Describe a format.

    Attributes:
        name: as given on the command line.
        suffixes: of its files; the first is the one to write.
        description: what it is, in a few words.
        module: module of this package with its ``write`` and ``read``; loaded when used.
        ending: of the names of those, where the module has several formats.
        needs: packages it is read and written with that a plain install lacks.
        layout: ``file``; ``folder`` where an export is a folder; ``either`` where a file holds one object and a path
            without suffix makes a folder of such files.
        pickled: reading it runs whatever code the file carries.
        contact: it states the hand in contact, which only a trial tells (see `ExportOptions.outcomes`).
        reads_options: options of ``graspcascade export`` that say something of what is read in it.
        writes_options: likewise of what is written in it.
        sniff: tells whether a folder, or a file of its suffix, is in it; None where the suffix alone does.
    """

    name: str
    suffixes: tuple[str, ...]
    description: str
    module: str
    ending: str = ""
    needs: tuple[str, ...] = ()
    layout: Literal["file", "folder", "either"] = "file"
    pickled: bool = False
    contact: bool = False
    reads_options: tuple[str, ...] = ()
    writes_options: tuple[str, ...] = ()
    sniff: Callable[[Path], bool] | None = None

    @property
    def missing(self) -> tuple[str, ...]:
        """Packages it needs that are not installed."""
        return tuple(package for package in self.needs if find_spec(package) is None)

    def write(self, path: Path, document: GraspDocument, options: ExportOptions) -> None:
        """Put a document into a new file, or into an empty folder."""
        self._function("write")(path, document, options)

    def read(self, path: Path, assume: Assumptions) -> GraspDocument:
        """Take a document out of a file or folder, see `load_document`."""
        return cast(GraspDocument, self._function("read")(path, assume))

    def writes_folder(self, path: Path) -> bool:
        """Tell whether a path names a folder to be made rather than a file."""
        return self.layout == "folder" or (self.layout == "either" and path.suffix.lower() not in self.suffixes)

    def _function(self, name: str) -> Any:
        return getattr(importlib.import_module(f".{self.module}", __package__), name + self.ending)


def check_file_place(path: Path, folder: bool = False) -> None:
    """Check that a file, or a new folder, can be put somewhere; an InputError says what is missing or in the way."""
    if path.is_dir() and not folder:
        raise InputError(f"{path} is a folder; give the name of a file")
    if folder and path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"{path} exists and is not an empty folder; give another name")
    if not path.parent.is_dir():
        raise InputError(f"there is no folder {path.parent} to write {path.name} into")


def _is_isaac(path: Path) -> bool:
    if path.is_dir():
        return bool(yaml_files(path))
    with path.open("rb") as file:
        lines = file.read(100_000).splitlines()
    return b"isaac_grasp" in b"".join(line for line in lines if not line.lstrip().startswith(b"#"))[:4096]


def _holds_a_list(path: Path) -> bool:
    return bool(importlib.import_module(".dexgrasp", __package__).array_shape(path))


_SAID = ("grasp_type", "object", "side_axis")
_NAMED = ("joint_prefix", "joint_numbering", "evaluation")
_YAML: dict[str, Any] = {"module": "yaml_grasps", "suffixes": YAML_SUFFIXES}
_YAML["reads_options"] = (*_SAID, "joint_numbering")
_NPY: dict[str, Any] = {"module": "dexgrasp", "suffixes": (".npy",), "pickled": True, "contact": True}
_NPY["reads_options"] = _SAID
FORMATS_BY_NAME: Mapping[str, GraspFormat] = {
    known.name: known
    for known in (
        GraspFormat("json", (".json",), "native JSON, joints by name", "native", "_json"),
        GraspFormat("parquet", (".parquet",), "native Parquet, one row a grasp", "native", "_parquet", ("pyarrow",)),
        GraspFormat(
            "isaac_grasp",
            description="isaac_grasp YAML 1.0 of NVIDIA Isaac, one object a file",
            ending="_isaac",
            layout="either",
            writes_options=("frame_keys", *_NAMED),
            sniff=_is_isaac,
            **_YAML,
        ),
        GraspFormat(
            "moveit_grasp",
            description="moveit_msgs/Grasp messages as YAML",
            ending="_moveit",
            writes_options=("frame_id", "parent_link", *_NAMED),
            sniff=lambda path: path.is_file() and not _is_isaac(path),
            **_YAML,
        ),
        GraspFormat(
            "dexgraspbench",
            description="DexGraspBench folder, one .npy a grasp, objects beside them",
            ending="_bench",
            layout="folder",
            writes_options=("object_root",),
            sniff=lambda path: not _holds_a_list(path) if path.is_file() else (path / "graspdata").is_dir(),
            **_NPY,
        ),
        GraspFormat(
            "dexgraspnet",
            description="DexGraspNet .npy, one object a file",
            ending="_net",
            layout="either",
            sniff=lambda path: _holds_a_list(path) if path.is_file() else (path / "dataset").is_dir(),
            **_NPY,
        ),
    )
}
"""Every format by name."""
FORMATS: Mapping[str, GraspFormat] = {
    suffix: known
    for known in FORMATS_BY_NAME.values()
    for suffix in known.suffixes
    if sum(suffix in other.suffixes for other in FORMATS_BY_NAME.values()) == 1
}
"""Formats by the suffix that by itself picks them."""


def format_to_write(path: Path, name: str | None = None) -> GraspFormat:
    """Find the format to write a path in; an InputError says that there is none, or that the suffix is not its own."""
    if name is None:
        return _by_suffix(path)
    chosen, suffix = _by_name(name), path.suffix.lower()
    if chosen.layout == "folder" and suffix in chosen.suffixes:
        raise InputError(f"a {chosen.name} export is a folder; give a name without {path.suffix!r}")
    if chosen.layout != "folder" and not (suffix in chosen.suffixes or (chosen.layout == "either" and not suffix)):
        folder = ", or for a folder a name without suffix" if chosen.layout == "either" else ""
        raise InputError(f"a {chosen.name} file is named {' or '.join(chosen.suffixes)}{folder}; got {path.name!r}")
    return chosen


def format_to_read(path: Path, name: str | None = None) -> GraspFormat:
    """Find the format that an existing file or folder is in, from its suffix and, where several share it, its start.

    Raises:
        InputError: an unknown format, or a suffix that picks none.
        FileFormatError: its start is that of no format.
    """
    suffix = path.suffix.lower()
    if name is not None:
        return _by_name(name)
    if path.exists():
        with place(str(path)):
            # The last first: folders of theirs may hold YAML files besides.
            for known in reversed(list(FORMATS_BY_NAME.values())):
                if known.sniff and (path.is_dir() or suffix in known.suffixes) and known.sniff(path):
                    return known
    if path.is_dir():
        raise FileFormatError(
            f"{path} is a folder without graspdata, dataset or files *{', *'.join(YAML_SUFFIXES)} in it; name its "
            f"format if it is one: {', '.join(name for name, one in FORMATS_BY_NAME.items() if one.layout != 'file')}"
        )
    return _by_suffix(path)


def _by_name(name: str) -> GraspFormat:
    chosen = FORMATS_BY_NAME.get(str(name).strip().lower().replace("-", "_"))
    if chosen is None:
        raise unknown("grasp format", name, FORMATS_BY_NAME)
    return chosen


def _by_suffix(path: Path) -> GraspFormat:
    suffix = path.suffix.lower()
    if suffix in FORMATS:
        return FORMATS[suffix]
    several = [known.name for known in FORMATS_BY_NAME.values() if suffix in known.suffixes]
    valid = ", ".join(f"{ending} ({known.description})" for ending, known in FORMATS.items())
    raise InputError(
        f"{path.name!r} does not tell its format by its suffix {path.suffix!r}; name the format: "
        f"{', '.join(several or FORMATS_BY_NAME)}. Valid: {valid}."
    )
