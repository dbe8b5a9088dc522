"""The page's words: the table of samples, the grasp looked at, rates, messages. HTML, escaped."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from ..core.intervals import Interval, wilson
from ..formats.document import mapping
from ..proposals.ranked import FAIR
from .session import Session

MEANING = {
    "held": "still in the hand at the end",
    "overlap": "hand and object intersect at the start",
    "missed": "thumb and a finger do not both touch it after closing",
    "shaken_out": "left the hand during the shake",
    "dropped": "left the hand under its weight",
    "pushed_out": "pushed farther than allowed",
    "turned": "turned farther than allowed",
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


def hint_html(text: str) -> str:
    """Word what is always true of the control above."""
    return f'<div class="gc-hint" style="{_PANEL};{_STYLES["note"]}">{escape(text)}</div>'


def measured_html(measured: Mapping[str, Any] | None, problem: str = "", *, estimated: bool = False) -> str:
    """Word what was measured of a type and object, with a warning where few hold; or what is wrong with them.

    Where nothing was measured, `estimated` says that each grasp comes with a chance of its own.
    """
    if problem:
        kind, text = "error", escape(problem)
    elif measured is None:
        kind = "note"
        text = "each grasp's chance is estimated" if estimated else "how often these hold has not been measured"
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
    verdict, protocol = "not tried yet", f"protocol {escape(session.protocol.name)}"
    if session.outcome is not None:
        happened = str(session.outcome.verdict[0])
        faithful = "type-faithful; " if session.faithful(session.index) else ""
        verdict = f"{_badge(happened)} {MEANING[happened]}; {faithful}{protocol}"
    lines = [
        f"<b>{kind}</b> of <b>{name}</b>, by {_side(session, session.index)}",
        f'shown: <span class="gc-shown">{escape(shown)}</span>',
        protocol if playing else f'<span class="gc-verdict">{verdict}</span>',
    ]
    if np.isfinite(chance := float(session.grasp.probability[0])):
        doubt = ": <b>likely to fail</b>" if chance < FAIR else ""
        lines.insert(1, f'<span class="gc-chance">chance of success {chance_text(chance)}{doubt}</span>')
    return _fixed("<br>".join(lines), 5 + int(np.isfinite(session.batch.grasps.probability).any()))


def table_html(session: Session, *, mark: bool = True) -> str:
    """Tabulate the samples, chances where known and verdicts where tried; `mark` sets off the grasp looked at."""
    grasps, rows = session.batch.grasps, range(len(session))
    columns = {"#": [str(index) for index in rows]}
    for title, names in (("type", grasps.grasp_type), ("object", grasps.object_name)):
        if len(np.unique(names)) > 1:
            columns[title] = [escape(str(name)) for name in names]
    columns["side"] = [_side(session, index) for index in rows]
    columns["size cm"] = [_number(size_m * 100, ".1f") for size_m in grasps.grasp_size_m]
    if np.isfinite(grasps.probability).any():
        columns["chance"] = [chance_text(chance) for chance in grasps.probability]
    columns["verdict"] = ["-"] * len(session)
    for index, outcome in session.outcomes.items():
        faithful = " faithful" if session.faithful(index) else ""
        columns["verdict"][index] = _badge(str(outcome.verdict[0])) + faithful
    lines = []
    for index, cells in enumerate(zip(*columns.values(), strict=True)):
        here = ' class="gc-current" style="background:#e7f1ff"' if mark and index == session.index else ""
        lines.append(f"<tr{here}>" + "".join(f'<td style="{_CELL}">{cell}</td>' for cell in cells) + "</tr>")
    head = "".join(f'<th style="{_CELL};position:sticky;top:0;background:#fff">{title}</th>' for title in columns)
    body = (
        f'<table class="gc-table" style="border-collapse:collapse;width:100%"><tr>{head}</tr>{"".join(lines)}</table>'
    )
    return (
        f'<div style="{_PANEL}"><div style="max-height:17em;overflow:auto">{body}</div>'
        f'<div class="gc-rate" style="padding-top:0.4em">{escape(rate_text(session))}</div>'
        f"{_chances_html(session)}</div>"
    )


def _chances_html(session: Session) -> str:
    """Word the mean of the chances that are known, with a warning where it is low."""
    known = session.batch.grasps.probability[np.isfinite(session.batch.grasps.probability)]
    if not known.size:
        return ""
    friction = mapping(session.batch.metadata.get("ranking")).get("friction")
    at = "" if friction is None else f" at friction {escape(str(friction))}"
    doubt = ". <b>Most such grasps are expected to fail.</b>" if known.mean() < FAIR else ""
    return f'<div class="gc-chances">chance of success{at}: {chance_text(float(known.mean()))} on average{doubt}</div>'


def chance_text(chance: float) -> str:
    """Word a chance in whole percent, only certainty as 0 or 100; unknown is a dash."""
    if not np.isfinite(chance):
        return "-"
    percent = round(100 * chance)
    bound = {0: "under 1 %", 100: "over 99 %"}.get(percent)
    return bound if bound and 0 < chance < 1 else f"{percent} %"


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
