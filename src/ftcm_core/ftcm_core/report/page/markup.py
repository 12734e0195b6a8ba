# SPDX-License-Identifier: Apache-2.0
"""HTML made of the suite's own Markdown: paragraphs, lists, tables, bold. No other Markdown."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape

_RULE = re.compile(r"[|:\- ]+")
_CELLS = re.compile(r"(?<!\\)\|")
_NUMBER = re.compile(r"[-–+]?\d|–$")


def from_markdown(text: str) -> str:
    """Return what the tables of ``ftcm_core.report.table`` and others say, as HTML."""
    parts = []
    for block in re.split(r"\n\s*\n", text.strip("\n")):
        lines = block.splitlines()
        tables = [line for line in lines if line.startswith("|")]
        items = [line[2:] for line in lines if line.startswith("- ")]
        if tables:
            rows = [[cell.strip() for cell in _CELLS.split(line.strip())[1:-1]] for line in tables]
            parts.append(table(rows[0], [row for row in rows[1:] if not _RULE.fullmatch("".join(row))]))
        elif items:
            parts.append("<ul>" + "".join(f"<li>{_inline(item)}</li>" for item in items) + "</ul>")
        elif block.strip():
            parts.append(f"<p>{_inline(' '.join(lines))}</p>")
    return "\n".join(parts)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table of Markdown cells; it scrolls by itself where it is wider than the page."""
    heads = "".join(f"<th>{_inline(cell)}</th>" for cell in head)
    body = "".join(
        "<tr>" + "".join(f"<td{_aligned(cell)}>{_inline(cell)}</td>" for cell in row) + "</tr>"
        for row in rows
    )
    return f'<div class="wide"><table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table></div>'


def pairs(values: Mapping[str, object]) -> str:
    """Return a table of names and values."""
    rows = "".join(f"<tr><th>{escape(k)}</th><td>{escape(str(v))}</td></tr>" for k, v in values.items())
    return f'<div class="wide"><table class="pairs">{rows}</table></div>'


def _aligned(cell: str) -> str:
    return ' class="number"' if _NUMBER.match(cell.replace("*", "")) else ""


def _inline(text: str) -> str:
    return re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", escape(text.replace("\\|", "|"), quote=False))
