"""Any other committed JSON on the results page: its numbers as tables, named as in the file.

A measurement is a JSON object. Its `title` and `description`, if there, head the section; single values become one
table, objects are spread over it by their path, and each list of objects becomes a table of its own. An object
of `rate`, `low` and `high` is one value. What `file_only` names stays in the file, and is counted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from .markdown import plain, table

_HEADING = ("title", "description", "file_only")


def measurement_section(stem: str, data: Mapping[str, Any], prior: str | None = None) -> str:
    """Write the section of one measurement, headed by its title or file name.

    Args:
        stem: of its file.
        data: what the file holds.
        prior: the one behind the page's rates; a measurement of another one says so.
    """
    only = data.get("file_only", [])
    kept = "".join(f" It also holds {len(data[name])} {name}." for name in only)
    blocks = [f"### {data.get('title', stem)}", f"File `{stem}.json`.{kept}"]
    if prior is not None and data.get("prior", prior) != prior:
        blocks.append(f"Measured with another prior than the rates above, which are of {prior}.")
    if "description" in data:
        blocks.append(str(data["description"]))
    values = list(spread({key: value for key, value in data.items() if key not in (*_HEADING, *only)}))
    single = [(name, plain(value)) for name, value in values if not _is_table(value)]
    if single:
        blocks.append(table(("quantity", "value"), single))
    for name, rows in values:
        if _is_table(rows):
            blocks += [f"{name}:", _row_table(rows)]
    return "\n\n".join(blocks)


def _row_table(rows: list[Mapping[str, Any]]) -> str:
    flat = [dict(spread(row)) for row in rows]
    columns = list(dict.fromkeys(name for row in flat for name in row))
    return table(columns, [[plain(row.get(name)) for name in columns] for row in flat])


def _is_table(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(row, Mapping) for row in value)


def spread(data: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Walk over an object's values, those of inner objects under ``outer.inner``."""
    for key, value in data.items():
        if isinstance(value, Mapping) and value.keys() != {"rate", "low", "high"}:
            yield from spread(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
