# SPDX-License-Identifier: Apache-2.0
"""Commands that tell what there is: ``list`` and ``describe``."""

from __future__ import annotations

import argparse
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ftcm_core.cli.output import note
from ftcm_core.errors import FtcmError, ParameterError, shown, suggestion
from ftcm_core.faults import Fault
from ftcm_core.params import specs
from ftcm_core.registry import KINDS, Component, components, find, summary
from ftcm_core.report.fault_pictures import write_picture
from ftcm_core.report.results import to_json
from ftcm_core.scenario import parse_yaml, shipped_scenarios


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
    if arguments.picture is not None:
        write_picture(_fault(cls, arguments.overrides), Path(arguments.picture))
        note(f"picture: {arguments.picture}")
    elif arguments.overrides:
        raise FtcmError("--set: a description has no values to set; expected with --picture FILE")
    print(to_json(_description(cls)) if arguments.json else _description_text(cls))
    return 0


def _fault(cls: type[Component], overrides: Sequence[str]) -> Fault:
    """A fault at its defaults, but for some ``parameter=value``."""
    if not issubclass(cls, Fault):
        known = suggestion("", components("fault"))
        raise FtcmError(f"--picture: {cls.kind} {cls.type_name!r} is no fault; {known}")
    values = {name: spec.default for name, spec in specs(cls).items()}
    for text in overrides:
        name, equals, value = text.partition("=")
        if not equals:
            raise FtcmError(f"--set {shown(text)}: expected parameter=value")
        if name not in values:
            raise FtcmError(f"--set {shown(name)}: unknown parameter; {suggestion(name, values)}")
        values[name], _ = parse_yaml(value, f"--set {name}")
    try:
        return cls(**values)
    except ParameterError as error:
        raise FtcmError(f"--set {error}") from None


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
