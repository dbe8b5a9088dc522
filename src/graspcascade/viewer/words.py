"""The page's words: the table of samples, the grasp looked at, rates, messages. HTML, escaped."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from ..core.intervals import Interval, wilson
from ..core.outcomes import Outcomes
from .session import Session

MEANING = {
    "held": "still in the hand at the end",
    "overlap": "hand and object intersect at the start",
    "missed": "thumb and a finger do not both touch it after closing",
    "shaken_out": "left the hand during the shake",
    "dropped": "left the hand under its weight",
    "unstable": "the simulation broke down",
}
RARE = 0.3
"""A measured rate below this comes with a warning."""
_COLOURS = {"held": "#2b8a3e", "unstable": "#5c5f66"}
_FAILED = "#c92a2a"
_PANEL = "padding:0 0.75em 0.5em;font-size:0.8em;line-height:1.45"
_CELL = "text-align:left;padding:0.1em 0.6em 0.1em 0;border-bottom:1px solid #e9ecef;white-space:nowrap"
_STYLES = {"note": "color:#495057", "error": "background:#fff5f5;border-left:3px solid #c92a2a;color:#a61e1e"}


def _fixed(content: str, lines: int) -> str:
    """Put content into a space of so many lines, whatever its length: what stands below must not move."""
    return f'<div style="{_PANEL}"><div style="height:{1.45 * lines:g}em;overflow:auto">{content}</div></div>'


def message_html(text: str, *, error: bool = False) -> str:
    """Word a message; errors stand out."""
    kind = "error" if error else "note"
    style = f"{_STYLES[kind]};padding:0 0.6em;min-height:100%"
    inner = f'<div class="gc-message" data-kind="{kind}" role="status" style="{style}">{escape(text)}</div>'
    return _fixed(inner if text else "", 3)


def measured_html(measured: Mapping[str, Any] | None, problem: str = "") -> str:
    """Word what was measured of a type and object, with a warning where few hold; or what is wrong with them."""
    if problem:
        kind, text = "error", escape(problem)
    elif measured is None:
        kind, text = "note", "how often these hold has not been measured"
    else:
        rate, trials = wilson(measured["held"], measured["n"]), f"{measured['n']} trials"
        kind = "error" if rate.rate < RARE else "note"
        text = "<b>These rarely hold.</b> Measured" if rate.rate < RARE else "measured"
        text += f": {_percent(rate)} of {trials} held, protocol {escape(str(measured['protocol']))}"
    return _fixed(f'<div class="gc-measured" data-kind="{kind}" style="{_STYLES[kind]}">{text}</div>', 3)


def grasp_html(session: Session, shown: str, *, playing: bool = False) -> str:
    """Say which grasp is looked at, what of it is shown, and its verdict, which a playing trial keeps to its end."""
    task = session.grasp.tasks.distinct[0]
    kind, name = (escape(text.replace("_", " ")) for text in (task.grasp_type.name, task.object.name))
    lines = [
        f"<b>{kind}</b> of <b>{name}</b>, by {_side(session, session.index)}",
        f'shown: <span class="gc-shown">{escape(shown)}</span>',
        f"protocol {escape(session.protocol.name)}"
        if playing
        else verdict_html(session.outcome, session.faithful(session.index), session.protocol.name),
    ]
    return _fixed("<br>".join(lines), 5)


def verdict_html(outcome: Outcomes | None, faithful: bool, protocol: str) -> str:
    """Word a verdict, always with its protocol."""
    if outcome is None:
        return '<span class="gc-verdict">not tried yet</span>'
    verdict = str(outcome.verdict[0])
    more = f"{MEANING[verdict]}; " + ("type-faithful; " if faithful else "")
    return f'<span class="gc-verdict">{_badge(verdict)} {more}protocol {escape(protocol)}</span>'


def table_html(session: Session, *, mark: bool = True) -> str:
    """Tabulate the samples: index, side, grasp size, chance where known, verdict where tried.

    Args:
        session: what is looked at.
        mark: set off the row of the grasp looked at.
    """
    grasps = session.batch.grasps
    mixed = [
        (title, column)
        for title, column in (("type", grasps.grasp_type), ("object", grasps.object_name))
        if len(np.unique(column)) > 1
    ]
    chance = bool(np.isfinite(grasps.probability).any())
    titles = ["#", *(title for title, _ in mixed), "side", "size cm", *(["P(hold)"] if chance else []), "verdict"]
    rows = []
    for index in range(len(session)):
        cells = [str(index), *(escape(str(column[index])) for _, column in mixed), _side(session, index)]
        cells.append(_number(grasps.grasp_size_m[index] * 100, ".1f"))
        if chance:
            cells.append(_number(grasps.probability[index], ".2f"))
        outcome = session.outcomes.get(index)
        faithful = " faithful" if session.faithful(index) else ""
        cells.append("-" if outcome is None else _badge(str(outcome.verdict[0])) + faithful)
        here = ' class="gc-current" style="background:#e7f1ff"' if mark and index == session.index else ""
        rows.append(f"<tr{here}>" + "".join(f'<td style="{_CELL}">{cell}</td>' for cell in cells) + "</tr>")
    head = "".join(f'<th style="{_CELL};position:sticky;top:0;background:#fff">{title}</th>' for title in titles)
    body = f'<table class="gc-table" style="border-collapse:collapse;width:100%"><tr>{head}</tr>{"".join(rows)}</table>'
    return (
        f'<div style="{_PANEL}"><div style="max-height:17em;overflow:auto">{body}</div>'
        f'<div class="gc-rate" style="padding-top:0.4em">{escape(rate_text(session))}</div></div>'
    )


def rate_text(session: Session) -> str:
    """Word the rate of the tried grasps with its interval and protocol."""
    tried = len(session.outcomes)
    if not tried:
        return f"{len(session)} grasps, none tried yet under protocol {session.protocol.name}"
    held = sum(bool(outcome.held[0]) for outcome in session.outcomes.values())
    return f"{held} of {tried} tried held: {_percent(session.held())}, protocol {session.protocol.name}"


def _percent(rate: Interval) -> str:
    return f"{100 * rate.rate:.0f} % (95 %: {100 * rate.low:.0f} to {100 * rate.high:.0f} %)"


def _number(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "-"


def _side(session: Session, index: int) -> str:
    grasps = session.batch.grasps
    return f"{escape(str(grasps.side_axis[index]))} = {grasps.side_m[index] * 100:g} cm"


def _badge(verdict: str) -> str:
    return f'<b style="color:{_COLOURS.get(verdict, _FAILED)}">{escape(verdict.replace("_", " "))}</b>'
