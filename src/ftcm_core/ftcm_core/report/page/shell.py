# SPDX-License-Identifier: Apache-2.0
"""The frame of a page: style and script are in it, and its policy lets the browser fetch nothing."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

_HERE = Path(__file__).parent
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; base-uri 'none'"


def document(
    title: str,
    about: str,
    verdict: Sequence[str],
    sections: Sequence[tuple[str, str, str]],
    data: Mapping[str, Any],
) -> str:
    """Return a whole page.

    Args:
        title: heading.
        about: the line below it.
        verdict: sentences, which come first.
        sections: identifier, heading and HTML of each; those without HTML are left out.
        data: what the script draws; plain data without numbers that are not finite.
    """
    shown = [(name, heading, html) for name, heading, html in sections if html]
    links = "".join(f'<a href="#{name}">{escape(heading)}</a>' for name, heading, _ in shown)
    body = "\n".join(
        f'<section id="{name}"><h2>{escape(heading)}</h2>\n{html}\n</section>'
        for name, heading, html in shown
    )
    sentences = "".join(f"<li>{escape(text, quote=False)}</li>" for text in verdict)
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace(
        "<", "\\u003c"
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
<title>{escape(title)}</title>
<style>
{(_HERE / "page.css").read_text(encoding="utf-8")}</style>
</head>
<body>
<header><h1>{escape(title)}</h1><p>{escape(about)}</p></header>
<section id="verdict"><h2>Verdict</h2><ul>{sentences}</ul></section>
<nav>{links}</nav>
{body}
<script type="application/json" id="data">{text}</script>
<script>
{(_HERE / "page.js").read_text(encoding="utf-8")}</script>
</body>
</html>
"""


def details(summary: str, html: str) -> str:
    """Return something that is shown on demand."""
    return f"<details><summary>{escape(summary)}</summary>{html}</details>"


def pre(text: str) -> str:
    """Return text as it is written."""
    return f"<pre>{escape(text, quote=False)}</pre>"
