"""YAML files of plain data: bounded while they are parsed, written to the last bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .errors import FileFormatError, InputError, shortened

YAML_SUFFIXES = (".yaml", ".yml")
_MAX_BYTES, _MAX_DEPTH, _MAX_PARTS, _MAX_TEXT, _MAX_NUMBER = 64_000_000, 40, 5_000_000, 100_000, 400
_VALUES = {f"tag:yaml.org,2002:{kind}" for kind in ("null", "bool", "int", "float")}
"""What text without quotes can mean; anything else, dates among them, stays text."""


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
    """Read plain data: text, numbers, true, false, null, lists, and mappings whose keys are text.

    References, merge keys, tags, repeated keys and several documents are refused, and so are very large or deeply
    nested files. Values are built from the parser's events, and reading ends at the first that is refused: composed and
    expanded before they are checked, some small files take all memory or crash the interpreter.

    Raises:
        InputError: there is no such file.
        FileFormatError: it is not one complete YAML document of plain data; the message says in which line.
    """
    import yaml

    if not path.is_file():
        raise InputError(f"there is no file {path}")
    # PyYAML's own parser in Python, without libyaml, takes ten times as long.
    limit = _MAX_BYTES if yaml.__with_libyaml__ else _MAX_BYTES // 10
    with path.open("rb") as file:
        content = file.read(limit + 1)
    if len(content) > limit:
        raise FileFormatError(f"it is larger than the {limit / 1e6:g} MB allowed")
    builder = _Builder(yaml)
    try:
        return builder.document(content)
    except FileFormatError as error:
        raise FileFormatError(f"line {builder.line}: {error}") from error
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        mark, reason = getattr(error, "problem_mark", None), getattr(error, "problem", None) or str(error)
        line = builder.line if mark is None else mark.line + 1
        raise FileFormatError(f"line {line}: not plain YAML ({' '.join(reason.split())[:200]})") from error


class _Builder:
    """Build plain data from the events of a YAML parser; raises a `FileFormatError` at the first that is refused."""

    def __init__(self, yaml: Any) -> None:
        self._yaml, self._parts, self.line = yaml, 0, 1

    def document(self, content: bytes) -> Any:
        yaml = self._yaml
        self._loader = (yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader)(content)
        self._next()  # the start of the stream
        if isinstance(self._next(), yaml.StreamEndEvent):
            return None
        built = self._value(self._next(), 0)
        self._next()  # the end of the document
        if not isinstance(self._next(), yaml.StreamEndEvent):
            raise FileFormatError("a second document begins here; only one is read")
        return built

    def _next(self) -> Any:
        event = self._loader.get_event()
        self.line = event.start_mark.line + 1
        return event

    def _value(self, event: Any, depth: int) -> Any:
        yaml = self._yaml
        self._check(event, depth)
        if isinstance(event, yaml.ScalarEvent):
            return self._scalar(event)
        if isinstance(event, yaml.SequenceStartEvent):
            items = []
            while not isinstance(event := self._next(), yaml.SequenceEndEvent):
                items.append(self._value(event, depth + 1))
            return items
        entries: dict[str, Any] = {}
        while not isinstance(event := self._next(), yaml.MappingEndEvent):
            self._check(event, depth + 1)
            if not isinstance(event, yaml.ScalarEvent):
                raise FileFormatError("a list or mapping is used as a key; only text is read")
            if event.value == "<<" and event.implicit[0]:
                raise FileFormatError("a YAML merge key (<<) is used; write the parts out")
            if event.value in entries:
                raise FileFormatError(f"the key {shortened(repr(event.value))} is twice in one mapping")
            entries[event.value] = self._value(self._next(), depth + 1)
        return entries

    def _check(self, event: Any, depth: int) -> None:
        self._parts += 1
        if isinstance(event, self._yaml.AliasEvent) or event.anchor is not None:
            raise FileFormatError("YAML references (& and *) are used; write the parts out")
        if event.tag is not None:
            raise FileFormatError(f"the YAML tag {shortened(repr(event.tag))} is used; only plain data is read")
        if depth > _MAX_DEPTH:
            raise FileFormatError(f"nested deeper than the {_MAX_DEPTH} levels allowed")
        if self._parts > _MAX_PARTS:
            raise FileFormatError(f"more than the {_MAX_PARTS} parts allowed")
        if isinstance(event, self._yaml.ScalarEvent) and len(event.value.encode()) > _MAX_TEXT:
            raise FileFormatError(f"text longer than the {_MAX_TEXT} bytes allowed")

    def _scalar(self, event: Any) -> Any:
        kind = self._loader.resolve(self._yaml.ScalarNode, event.value, event.implicit)
        if kind not in _VALUES:
            return event.value
        if len(event.value) > _MAX_NUMBER:
            raise FileFormatError(f"a number longer than the {_MAX_NUMBER} characters allowed")
        node = self._yaml.ScalarNode(kind, event.value)
        return self._loader.yaml_constructors[kind](self._loader, node)
