"""YAML files of plain data: bounded before they are built, written to the last bit."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from .errors import FileFormatError, InputError, shortened

YAML_SUFFIXES = (".yaml", ".yml")
_MAX_BYTES, _MAX_DEPTH, _MAX_NODES, _MAX_SCALAR = 64_000_000, 40, 5_000_000, 100_000


def yaml_files(folder: Path) -> list[Path]:
    """List the YAML files of a folder, in the order of their names."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in YAML_SUFFIXES)


def dump_yaml(path: Path, data: Any, comment: str) -> None:
    """Write plain data with a comment on top, keys in their order, numbers to the last bit."""
    import yaml  # only those who read or write YAML wait for it to load

    class Plain(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
        def ignore_aliases(self, data: object) -> bool:
            return True  # equal parts are written in full: not every reader follows references

    text = yaml.dump(data, Dumper=Plain, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True)
    lines = "".join(f"# {line}\n" for line in comment.splitlines())
    path.write_text(lines + text, encoding="utf-8")


def load_yaml(path: Path) -> Any:
    """Read plain data.

    References, merge keys and tags are refused, and so are repeated keys and very large or deeply nested files: some
    small files can take all memory or crash the parser.

    Raises:
        InputError: there is no such file.
        FileFormatError: it is not one complete YAML document of plain data.
    """
    import yaml

    if not path.is_file():
        raise InputError(f"there is no file {path}")
    if path.stat().st_size > _MAX_BYTES:
        raise FileFormatError(f"it is larger than {_MAX_BYTES // 1_000_000} MB")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

    class Plain(loader):  # type: ignore[misc, valid-type]
        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            built = super().construct_mapping(node, deep)
            if len(built) < len(node.value):
                ((twice, _),) = Counter(self.construct_object(key) for key, _ in node.value).most_common(1)
                raise FileFormatError(f"it has the key {shortened(repr(twice))} twice in one mapping")
            return built

    try:
        text = path.read_bytes()
        _check_events(yaml, yaml.parse(text, Loader=loader))
        return yaml.load(text, Loader=Plain)
    except FileFormatError:
        raise
    except (yaml.YAMLError, ValueError, TypeError, RecursionError, OverflowError) as error:
        reason = " ".join(str(error).split())[:300] or "nested too deep"
        raise FileFormatError(f"not a complete YAML document ({reason})") from error


def _check_events(yaml: Any, events: Any) -> None:
    depth = 0
    for number, event in enumerate(events):
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            raise FileFormatError("it uses YAML references (& and *), which are not read; write the parts out")
        tag = getattr(event, "tag", None)
        if tag is not None:
            raise FileFormatError(f"it uses the YAML tag {str(tag)[:60]}; only plain data is read")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _MAX_DEPTH or number > _MAX_NODES:
            raise FileFormatError(f"it is nested deeper than {_MAX_DEPTH} or holds more than {_MAX_NODES} parts")
        if isinstance(event, yaml.ScalarEvent):
            if event.value == "<<" and not event.style:  # None or empty, as the parser has it, where it is not quoted
                raise FileFormatError("it uses a YAML merge key (<<), which is not read; write the parts out")
            if len(event.value) > _MAX_SCALAR:
                raise FileFormatError(f"one of its values is longer than {_MAX_SCALAR} characters")
