"""The grasp file formats, as data, and which of them a path means."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from ..errors import FileFormatError, InputError, unknown
from .document import GraspDocument
from .options import Assumptions, ExportOptions
from .yaml_text import YAML_SUFFIXES, yaml_files

_SNIFF_BYTES = 4096


@dataclass(frozen=True)
class GraspFormat:
    """Describe a format.

    Attributes:
        name: as given on the command line.
        suffixes: of its files; the first is the one to write.
        description: what it is, in a few words.
        module: module of this package with its ``write`` and ``read``; loaded when used.
        needs: packages it is read and written with, beyond numpy.
        layout: ``file``; ``folder`` where an export is a folder; ``either`` where a file holds one object and a path
            without suffix makes a folder of such files.
        pickled: reading it runs whatever code the file carries.
    """

    name: str
    suffixes: tuple[str, ...]
    description: str
    module: str
    needs: tuple[str, ...] = ()
    layout: Literal["file", "folder", "either"] = "file"
    pickled: bool = False

    @property
    def missing(self) -> tuple[str, ...]:
        """Name the packages it needs that are not installed."""
        return tuple(package for package in self.needs if find_spec(package) is None)

    def write(self, path: Path, document: GraspDocument, options: ExportOptions) -> None:
        """Put a document into a new file, or into an empty folder."""
        self._module().write(path, document, options)

    def read(self, path: Path, assume: Assumptions) -> GraspDocument:
        """Take a document out of a file or folder.

        Raises:
            FileFormatError: it is anything but sound and of this format.
            InputError: something it does not say and nothing is assumed for.
        """
        found: GraspDocument = self._module().read(path, assume)
        return found

    def writes_folder(self, path: Path) -> bool:
        """Tell whether a path names a folder to be made rather than a file."""
        return self.layout == "folder" or (self.layout == "either" and path.suffix.lower() not in self.suffixes)

    def _module(self) -> Any:
        return importlib.import_module(f".{self.module}", __package__)


FORMATS_BY_NAME: Mapping[str, GraspFormat] = {
    found.name: found
    for found in (
        GraspFormat("json", (".json",), "native JSON, joints by name", "native_json"),
        GraspFormat("parquet", (".parquet",), "native Parquet, one row a grasp", "native_parquet", needs=("pyarrow",)),
        GraspFormat(
            "isaac_grasp",
            YAML_SUFFIXES,
            "isaac_grasp YAML 1.0 of NVIDIA Isaac, one object a file",
            "isaac_grasp",
            needs=("yaml",),
            layout="either",
        ),
        GraspFormat(
            "moveit_grasp", YAML_SUFFIXES, "moveit_msgs/Grasp messages as YAML", "moveit_grasp", needs=("yaml",)
        ),
        GraspFormat(
            "dexgraspbench",
            (".npy",),
            "DexGraspBench folder, one .npy a grasp, objects beside them",
            "dexgraspbench",
            layout="folder",
            pickled=True,
        ),
        GraspFormat(
            "dexgraspnet",
            (".npy",),
            "DexGraspNet .npy, one object a file",
            "dexgraspnet",
            layout="either",
            pickled=True,
        ),
    )
}
"""Every format by name."""

FORMATS: Mapping[str, GraspFormat] = {
    suffix: found
    for found in FORMATS_BY_NAME.values()
    for suffix in found.suffixes
    if sum(suffix in other.suffixes for other in FORMATS_BY_NAME.values()) == 1
}
"""Formats by the suffix that by itself picks them."""


def format_to_write(path: Path, name: str | None = None) -> GraspFormat:
    """Find the format to write a path in.

    Raises:
        InputError: an unknown format, or a suffix that picks none or is not the format's.
    """
    if name is None:
        return _by_suffix(path)
    found = _by_name(name)
    suffix = path.suffix.lower()
    if found.layout == "folder" and suffix in found.suffixes:
        raise InputError(f"a {found.name} export is a folder; give a name without {path.suffix!r}")
    if found.layout != "folder" and not (suffix in found.suffixes or (found.layout == "either" and not suffix)):
        folder = ", or for a folder a name without suffix" if found.layout == "either" else ""
        raise InputError(f"a {found.name} file is named {' or '.join(found.suffixes)}{folder}; got {path.name!r}")
    return found


def format_to_read(path: Path, name: str | None = None) -> GraspFormat:
    """Find the format that an existing file or folder is in, from its suffix and, where several share it, its start.

    Raises:
        InputError: an unknown format, or a suffix that picks none.
        FileFormatError: its start is that of no format.
    """
    if name is not None:
        return _by_name(name)
    if path.is_dir():
        return _of_folder(path)
    suffix = path.suffix.lower()
    if suffix in FORMATS or not path.is_file():
        return _by_suffix(path)
    if suffix in YAML_SUFFIXES:
        with path.open("rb") as file:
            start = file.read(_SNIFF_BYTES)
        return FORMATS_BY_NAME["isaac_grasp" if b"isaac_grasp" in start else "moveit_grasp"]
    if suffix == ".npy":
        from .pickled import array_shape

        return FORMATS_BY_NAME["dexgraspnet" if array_shape(path) else "dexgraspbench"]
    return _by_suffix(path)


def _of_folder(path: Path) -> GraspFormat:
    if (path / "graspdata").is_dir():
        return FORMATS_BY_NAME["dexgraspbench"]
    if (path / "dataset").is_dir():
        return FORMATS_BY_NAME["dexgraspnet"]
    if yaml_files(path):
        return FORMATS_BY_NAME["isaac_grasp"]
    raise FileFormatError(
        f"{path} is a folder without graspdata, dataset or files *{', *'.join(YAML_SUFFIXES)} in it; "
        "name its format if it is one: "
        f"{', '.join(found.name for found in FORMATS_BY_NAME.values() if found.layout != 'file')}"
    )


def _by_name(name: str) -> GraspFormat:
    found = FORMATS_BY_NAME.get(str(name).strip().lower().replace("-", "_"))
    if found is None:
        raise unknown("grasp format", name, FORMATS_BY_NAME)
    return found


def _by_suffix(path: Path) -> GraspFormat:
    suffix = path.suffix.lower()
    if suffix in FORMATS:
        return FORMATS[suffix]
    several = [found.name for found in FORMATS_BY_NAME.values() if suffix in found.suffixes]
    valid = ", ".join(f"{known} ({found.description})" for known, found in FORMATS.items())
    if several:
        raise InputError(
            f"{path.name!r} could be of several formats by its suffix {path.suffix!r}; "
            f"name the format: {', '.join(several)}. Valid: {valid}."
        )
    others = ", ".join(name for name, found in FORMATS_BY_NAME.items() if found not in FORMATS.values())
    raise InputError(
        f"{path.name!r} names no grasp format by its suffix {path.suffix!r}. Valid: {valid}; by name: {others}."
    )
