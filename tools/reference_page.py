# SPDX-License-Identifier: Apache-2.0
"""The reference page of every component and its parameters, generated from the registry.

``python tools/reference_page.py docs/`` writes ``docs/reference.md``; with ``--check`` it exits with 1
if the page is out of date.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

from ftcm_core.faults import ProfiledFault
from ftcm_core.params import ParamSpec, specs
from ftcm_core.registry import KINDS, components, summary
from ftcm_core.scenario import InitialState, Scenario
from topics_page import write_or_check

FILE = "reference.md"

_INTRO = """# Reference

Generated from the code by `python tools/reference_page.py docs/`; do not edit.

A component is chosen in a [scenario file](scenarios.md) by its `type`; parameters left out have the
defaults below. On the command line a parameter is a dotted path, e.g. `--set controller.gamma1=3`. In ROS the
parameters of a component are `<type>.<name>` on its node, e.g. `ftcm.gamma1` on `/controller` and `do.k1` on
`/observer`.

"Per joint" means: one number for all joints, or a list with one number per joint. Sources are equations,
tables and sections of Vo and Kang (2020), other works by author and year, which the component's file cites in
full ([laws](laws.md), [observers](observers.md)), or "chosen", with the reason.
"""

_TITLES = {
    "robot": "Robots",
    "plant": "Plants",
    "detector": "Detectors",
    "sensor": "Sensors",
    "reference": "References",
    "controller": "Controllers",
    "observer": "Observers",
    "disturbance": "Disturbances",
    "fault": "Faults",
    "policy": "Policies",
}


def reference_page() -> str:
    """Return the page, in Markdown."""
    parts = [_INTRO, "## Scenario", "Top-level keys besides the components, `initial_state` and `injection`:"]
    parts += [table(specs(Scenario).values()), "### `initial_state`", table(specs(InitialState).values())]
    for kind in KINDS:
        parts.append(f"## {_TITLES.get(kind, kind.capitalize())}")
        if kind == "fault":
            parts += ["Parameters that faults share:", table(specs(ProfiledFault).values())]
        for name, cls in components(kind).items():
            declared = list(specs(cls).values())
            parts += [f"### `{name}`", escape(summary(cls))]
            if hasattr(cls, "site"):
                parts.append(f"Site: {cls.site}.")
            if getattr(cls(), "needs_observer", False):
                parts.append("Needs an observer.")
            if not getattr(cls, "needs_velocity", True):
                parts.append("Does not look at the measured velocity.")
            if kind == "fault":
                shared = [s for s in declared if s.name in specs(ProfiledFault)]
                parts.append(f"Of every fault, above: {', '.join(f'`{s.name}`' for s in shared)}.")
                declared = [s for s in declared if s not in shared]
            parts.append(table(declared) if declared else "No parameters of its own.")
    return "\n\n".join(part.strip() for part in parts) + "\n"


def main() -> int:
    """Write the page, or check the one on disk."""
    return write_or_check("tools/reference_page.py", __doc__, FILE, reference_page())


def table(declared: Iterable[ParamSpec]) -> str:
    """Return parameters as a table, in Markdown."""
    lines = ["| name | default | unit | allowed | description | source |", "|---|---|---|---|---|---|"]
    for spec in declared:
        cells = (f"`{spec.name}`", _value(spec.default), spec.unit, _allowed(spec), spec.doc, spec.source)
        lines.append("| " + " | ".join(escape(c) for c in cells) + " |")
    return "\n".join(lines)


def _value(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(_value(v) for v in value)}]"
    short = f"{value:g}" if isinstance(value, float) else str(value)
    return short if not isinstance(value, float) or float(short) == value else repr(value)


def _allowed(spec: ParamSpec) -> str:
    """Type and bounds in a few words."""
    if spec.choices:
        text = ", ".join(spec.choices)
    else:
        kinds = {"float": "number", "int": "whole number", "bool": "true, false", "str": "text"}
        text = " ".join(x for x in (kinds.get(spec.kind, spec.kind), spec.interval) if x)
    return text + (", per joint" if spec.per_joint else "") + (", or null" if spec.optional else "")


def escape(text: str) -> str:
    """Return a text as Markdown shows it."""
    for mark in ("|", "<", "*"):
        text = text.replace(mark, "\\" + mark)
    return text


if __name__ == "__main__":
    sys.exit(main())
