"""YAML files: plain data only, written and read by PyYAML."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import FileFormatError

YAML_SUFFIXES = (".yaml", ".yml")


def yaml_files(folder: Path) -> list[Path]:
    """List the YAML files of a folder, in the order of their names."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in YAML_SUFFIXES)


def dump_yaml(path: Path, data: Any, comment: str) -> None:
    """Write plain data with a comment on top, keys in their order, numbers to the last bit."""
    # Only these formats pay for loading it.
    import yaml

    class Plain(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
        def ignore_aliases(self, data: object) -> bool:
            """Write equal parts in full: not every reader follows references."""
            return True

    text = yaml.dump(data, Dumper=Plain, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True)
    lines = "".join(f"# {line}\n" for line in comment.splitlines())
    path.write_text(lines + text, encoding="utf-8")


def load_yaml(path: Path) -> Any:
    """Read plain data; tags that would make Python objects are refused.

    Raises:
        FileFormatError: it is not one complete YAML document.
    """
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        return yaml.load(path.read_bytes(), Loader=loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        reason = " ".join(str(error).split()) or "nested too deep"
        raise FileFormatError(f"not a complete YAML document ({reason})") from error
