# SPDX-License-Identifier: Apache-2.0
"""What the shell completes on the command line of ``ftcm``, by argcomplete where it is installed."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from typing import Any

from ftcm_core.errors import FtcmError
from ftcm_core.registry import KINDS, components
from ftcm_core.scenario import from_mapping, read_mapping, shipped_scenarios


def complete(parser: argparse.ArgumentParser) -> None:
    """Answer the shell and end, if it is the shell that asks."""
    if "_ARGCOMPLETE" not in os.environ:
        return
    try:
        import argcomplete
    except ImportError:
        return
    _prepare(parser)
    argcomplete.autocomplete(parser)


def _prepare(parser: argparse.ArgumentParser) -> None:
    """Say which actions of a parser, and of its commands, take which words."""
    known: dict[str, Callable[..., Any]] = {
        "scenario": _scenarios, "scenarios": _scenarios, "source": _scenarios,
        "overrides": _paths, "vary": _paths, "faults": _names("fault"),
        "controller": _names("controller"), "controllers": _names("controller"),
        "observer": _names("observer"), "detector": _names("detector"),
        "kind": lambda **_: list(KINDS), "name": lambda **_: [n for kind in KINDS for n in components(kind)],
    }  # fmt: skip
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                _prepare(inner)
        elif action.dest in known and not action.choices:
            # Where argcomplete looks for it; argparse does not know it.
            action.completer = known[action.dest]  # type: ignore[attr-defined]


def _names(kind: str) -> Callable[..., list[str]]:
    return lambda **_: list(components(kind))


def _scenarios(prefix: str, **_: Any) -> list[str]:
    from argcomplete.completers import FilesCompleter

    return [*shipped_scenarios(), *FilesCompleter(("yaml", "yml"))(prefix)]


def _paths(parsed_args: argparse.Namespace, **_: Any) -> list[str]:
    """Paths of the scenario's values, each with the `=` that follows."""
    named = [getattr(parsed_args, name, None) for name in ("scenario", "source")]
    source = next((name for name in named if isinstance(name, str)), "paper")
    try:
        data, _, origin = read_mapping(source)
        mapping = from_mapping(data, origin=origin).to_mapping()
    except FtcmError:
        return []
    return list(_flat(mapping, ""))


def _flat(node: Any, path: str) -> Iterator[str]:
    if isinstance(node, dict):
        for key, value in node.items():
            yield from _flat(value, f"{path}.{key}" if path else str(key))
    elif isinstance(node, list) and node and isinstance(node[0], dict):
        for number, value in enumerate(node):
            yield from _flat(value, f"{path}.{number}")
    else:
        yield f"{path}="
