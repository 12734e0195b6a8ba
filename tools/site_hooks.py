# SPDX-License-Identifier: Apache-2.0
"""What mkdocs does with the pages of docs/ besides: the README as the first page, formulas as MathML.

The pages are written for a viewer of repositories; nothing in them is for the site only.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

import latex2mathml.converter
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
MATH = re.compile(r"^```math\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ALIGNED = re.compile(r"\\(begin|end)\{aligned\}")
LINK = re.compile(r"\[([^\]]*)\]\(([^):#]+)(#[^)]*)?\)")
"""A link to a file: its text, the file, and the place in it."""


def on_files(files: Files, config: Any) -> Files:
    """The README is the first page; its links into docs/ stay within the site."""
    text = (ROOT / "README.md").read_text(encoding="utf-8").replace("](docs/", "](")
    found = (*files.documentation_pages(), *files.media_files())
    _known.update(file.src_uri for file in found if file.inclusion.is_included())
    files.append(File.generated(config, "index.md", content=text))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Formulas become MathML, which browsers draw by themselves; links out of docs/ name the file."""
    folder = posixpath.dirname(page.file.src_uri)

    def linked(found: re.Match[str]) -> str:
        inside = posixpath.normpath(posixpath.join(folder, found[2])) in _known
        return found[0] if inside else f"{found[1]} (`{found[2]}`)"

    text = LINK.sub(linked, markdown)
    return MATH.sub(lambda found: formula(found[1]), text)


_known: set[str] = set()
"""Files of the site: a link to another file of the repository names it instead."""


def formula(latex: str) -> str:
    """One block of LaTeX as MathML."""
    text = " ".join(ALIGNED.sub(lambda m: f"\\{m[1]}{{align*}}", latex).split())
    return f'<div style="overflow-x: auto">{latex2mathml.converter.convert(text, display="block")}</div>\n'
