# SPDX-License-Identifier: Apache-2.0
"""Commands that tell what there is: ``list`` and ``describe``."""

from __future__ import annotations

import argparse
import math
import textwrap
from typing import Any

from ftcm_core.errors import FtcmError, suggestion
from ftcm_core.params import specs
from ftcm_core.registry import KINDS, Component, components, find, summary
from ftcm_core.report.results import to_json
from ftcm_core.scenario import shipped_scenarios


def list_command(arguments: argparse.Namespace) -> int:
    """List scenarios and components."""
    kinds = ["scenario", *KINDS]
    if arguments.kind is not None and arguments.kind not in kinds:
        raise FtcmError(f"no component kind {arguments.kind!r}; {suggestion(arguments.kind, kinds)}")
    listing = {kind: _names(kind) for kind in kinds if arguments.kind in (None, kind)}
    if arguments.json:
        print(to_json(listing))
        return 0
    width = max((len(name) for names in listing.values() for name in names), default=0)
    for kind, names in listing.items():
        print(f"{kind}:")
        for name, text in names.items():
            print(f"  {name.ljust(width)}  {text}".rstrip())
    return 0


def _names(kind: str) -> dict[str, str]:
    """Name and one line of everything of a kind; of a scenario, the first comment of its file."""
    if kind != "scenario":
        return {name: summary(cls) for name, cls in components(kind).items()}
    found = {}
    for name, path in shipped_scenarios().items():
        first = path.read_text(encoding="utf-8").split("\n", 1)[0]
        found[name] = first.lstrip("# ") if first.startswith("#") else ""
    return found


def describe_command(arguments: argparse.Namespace) -> int:
    """Describe a component and its parameters."""
    kind, _, name = arguments.name.rpartition("/")
    if kind:
        matches = [find(kind, name)]
    else:
        matches = [found[name] for found in map(components, KINDS) if name in found]
    if not matches:
        known = {n for k in KINDS for n in components(k)}
        raise FtcmError(f"no component {name!r}; {suggestion(name, known)}")
    if len(matches) > 1:
        options = " or ".join(f"{cls.kind}/{name}" for cls in matches)
        raise FtcmError(f"{name!r} is the name of several components; say {options}")
    cls = matches[0]
    print(to_json(_description(cls)) if arguments.json else _description_text(cls))
    return 0


def _description(cls: type[Component]) -> dict[str, Any]:
    parameters = [
        {
            "name": s.name,
            "type": s.kind,
            "default": s.default,
            "unit": s.unit,
            "lower": s.lower,
            "upper": s.upper,
            "lower_open": s.lower_open and math.isfinite(s.lower),
            "upper_open": s.upper_open and math.isfinite(s.upper),
            "choices": s.choices,
            "per_joint": s.per_joint,
            "optional": s.optional,
            "doc": s.doc,
            "source": s.source,
        }
        for s in specs(cls).values()
    ]
    described: dict[str, Any] = {
        "kind": cls.kind,
        "name": cls.type_name,
        "doc": summary(cls),
        "parameters": parameters,
    }
    if hasattr(cls, "needs_observer"):
        described["needs_observer"] = cls().needs_observer  # type: ignore[attr-defined]
    if hasattr(cls, "site"):
        described["site"] = cls.site
    return described


def _description_text(cls: type[Component]) -> str:
    lines = [f"{cls.kind} {cls.type_name}", *textwrap.wrap(summary(cls), 100, initial_indent="  ")]
    if getattr(cls(), "needs_observer", False):
        lines.append("  Needs an observer.")
    if hasattr(cls, "site"):
        lines.append(f"  Site: {cls.site}.")
    declared = specs(cls)
    if not declared:
        lines.append("  No parameters.")
    for s in declared.values():
        unit = "" if s.unit == "-" else f" {s.unit}"
        default = list(s.default) if isinstance(s.default, tuple) else s.default
        lines += ["", f"  {s.name} = {'null' if default is None else default}{unit}"]
        for text in (s.doc, f"expected: {s.expected}", f"source: {s.source}"):
            lines += textwrap.wrap(text, 100, initial_indent="      ", subsequent_indent="      ")
    return "\n".join(lines)
