# SPDX-License-Identifier: Apache-2.0
"""What is said of a run, as HTML. No ROS. Everything that was heard is escaped: it may be of anybody."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape

from ftcm_ros.run.view import LEVELS, View

COLOURS = ("#2563eb", "#0d9488", "#9333ea", "#4d7c0f", "#db2777", "#0891b2", "#78716c", "#4338ca")
"""Of the joints, in plots, tables and on the arm; then again from the first."""
FAULT, ALARM = "#f59e0b", "#dc2626"
"""Of a joint on which a fault acts, and of one with an alarm."""
LEVEL_COLOURS = {"ok": "#16a34a", "warn": FAULT, "error": ALARM, "silent": ALARM}
GREY = "#9ca3af"
_TABLE = "border-collapse:collapse;width:100%;font-size:0.8em;font-variant-numeric:tabular-nums"
_CELL = "padding:0.15em 0.3em;vertical-align:top"
_SMALL = "font-size:0.8em;line-height:1.45;padding:0 0.7em"


def colour(joint: int) -> str:
    """Return the colour of a joint, numbered from 0."""
    return COLOURS[joint % len(COLOURS)]


def dot(shade: str) -> str:
    """Return a round mark of a colour."""
    return f'<span style="color:{shade}">&#9679;</span>'


def block(text: str) -> str:
    """Return a paragraph of what is HTML already."""
    return f'<div style="{_SMALL}">{text}</div>'


def table(head: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[int]) -> str:
    """Return a table of cells that are HTML already.

    Args:
        head: headings.
        rows: cells.
        right: columns of numbers, from 0.
    """
    sides = ["right" if k in right else "left" for k in range(len(head))]
    style = f"{_CELL};font-weight:600;opacity:0.65;white-space:nowrap"
    heads = "".join(
        f'<th style="{style};text-align:{side}">{escape(text)}</th>' for text, side in zip(head, sides)
    )
    body = "".join(
        '<tr style="border-top:1px solid rgba(128,128,128,0.2)">'
        + "".join(f'<td style="{_CELL};text-align:{side}">{cell}</td>' for cell, side in zip(row, sides))
        + "</tr>"
        for row in rows
    )
    return f'<div style="overflow-x:auto"><table style="{_TABLE}"><tr>{heads}</tr>{body}</table></div>'


def run(view: View, where: str) -> str:
    """Return which run it is, and how far.

    Args:
        view: what has been heard.
        where: the domain, in words.
    """
    plant = view.health.get("plant")
    values = plant.values if plant else {}
    lines = []
    if view.time is not None:
        done = ""
        if {"tick", "last_tick"} <= values.keys():
            tick, last = (escape(values[name]) for name in ("tick", "last_tick"))
            done = f' <span style="opacity:0.65">tick {tick} of {last}</span>'
        lines.append(f'<b style="font-size:1.4em">t = {view.time:.2f} s</b>{done}')
    words = [str(view.scenario.get("name", "")), values.get("mode", ""), values.get("state", "")]
    lines.append(escape(", ".join(filter(None, words))))
    parts = [f"{escape(kind)} <b>{escape(name)}</b>" for kind, name in sorted(view.components.items())]
    lines += [", ".join(parts), f'<span style="opacity:0.65">{escape(where)}</span>']
    return block("<br>".join(filter(None, lines)))


def nodes(view: View, now: float) -> str:
    """Return the table of the nodes.

    Args:
        view: what has been heard.
        now: steady time, s.
    """
    (_, _, rate, _, missed, _, _), *rows = view.nodes(now)
    if not rows:
        return block("No node of the suite says anything yet.")
    cells = []
    for node, level, hertz, _, misses, _, says in rows:
        mark = dot(LEVEL_COLOURS.get(level, GREY))
        said = "" if level == LEVELS[0] else f'<div style="opacity:0.75">{escape(f"{level}: {says}")}</div>'
        cells.append((f"{mark} {escape(node)}{said}", escape(hertz), escape(misses)))
    return table(("node", rate, missed), cells, right=(1, 2))


def faults(view: View) -> str:
    """Return what the faults do, one a line; nothing where there are none."""
    lines = []
    for text in view.acting():
        acts = " ACTS " in text
        lines.append(
            f"{dot(FAULT if acts else GREY)} {'<b>' if acts else ''}{escape(text)}{'</b>' if acts else ''}"
        )
    return block("<br>".join(lines) or "none")


def joints(view: View) -> str:
    """Return the table of the joints: the newest values, and what the detector says."""
    alarms, faulty = view.alarms(), view.faulty()
    rows = []
    for j, joint in enumerate(view.joints):
        values = view.values(joint)
        said = [f'<b style="color:{FAULT}">fault</b>'] if joint in faulty else []
        said += [f'<b style="color:{ALARM}">alarm: {escape(alarms[joint])}</b>'] if joint in alarms else []
        shown = (values.command, values.disturbance, values.estimate)
        cells = [_cell(values.error, ".1e"), *(_cell(x, ".2f") for x in shown)]
        below = f'<div style="width:0;white-space:nowrap">{" ".join(said)}</div>' if said else ""
        rows.append((f"{dot(colour(j))} {escape(joint)}{below}", *cells))
    head = ("joint", "e, rad", "u, N·m", "d, N·m", "estimate")
    return table(head, rows, right=(1, 2, 3, 4)) if rows else block("none yet")


def _cell(value: float, form: str) -> str:
    return "" if math.isnan(value) else f'<span style="white-space:nowrap">{value:{form}}</span>'


def answers(newest: Iterable[tuple[str, bool]]) -> str:
    """Return what has come of orders: texts, and whether they were taken."""
    lines = [f"{dot(LEVEL_COLOURS['ok' if taken else 'error'])} {escape(text)}" for text, taken in newest]
    return block("<br>".join(lines)) if lines else ""


def note(text: str) -> str:
    """Return a remark."""
    return block(f'<span style="opacity:0.65">{escape(text)}</span>')
