# SPDX-License-Identifier: Apache-2.0
"""Generates the reference page of topics and node parameters from their declarations.

``python tools/topics_page.py docs/`` writes it; ``--check`` tells whether it is up to date.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from ftcm_ros.parameters.node_parameters import SETTINGS
from ftcm_ros.transport.topics import TOPICS

PAGE = "topics.md"
_INTRO = """# Topics and node parameters

Generated from the declarations by `python tools/topics_page.py docs/`; do not edit.

## Topics

Every topic is reliable; latched topics are transient local. Stamps of the data topics are the time of
the tick, t_k = k·dt from zero, in lockstep and in real time; with `stamps: free` they are those of the
measurement ([hardware](hardware.md)). The time a message was published is in the bag. Torques are joint
torques in N·m; `position`, `velocity` and `effort` are the arrays of `sensor_msgs/JointState`, joints by
name in any order.
"""
_PARAMETERS = """
## Node parameters

Read-only: set them at start (`--ros-args -p NAME:=VALUE`). The controller, the observer and the detector have
besides, changeable while running, the parameter `controller`, `observer` or `detector`, and one for every
parameter of every component, `<type>.<name>` (`ftcm.upsilon1`, `do.k1`): see [reference.md](reference.md).
A change takes effect between two ticks and is announced on `component_changes` with its first tick.
"""


def page() -> str:
    """Return the page."""
    lines = [_INTRO, "| topic | type | depth | from | to | content |", "|---|---|---|---|---|---|"]
    for t in TOPICS:
        latched = " (latched)" if t.latched else ""
        lines.append(
            f"| `{t.name}` | `{t.type}` | {t.depth} | {', '.join(t.publishers) or '–'} "
            f"| {', '.join(t.subscribers) or '–'} | {t.content}{latched} |"
        )
    lines.append(_PARAMETERS)
    for node, settings in SETTINGS.items():
        lines += [f"### {node}", "", "| parameter | default | meaning |", "|---|---|---|"]
        for s in settings:
            choices = f"; one of {', '.join(f'`{c}`' for c in s.choices)}" if s.choices else ""
            default = str(s.default).lower() if isinstance(s.default, bool) else s.default
            lines.append(f"| `{s.name}` | `{default}` | {s.description}{choices} |")
        lines.append("")
    return "\n".join(lines)


def write_or_check(
    tool: str, purpose: str | None, name: str, text: str, more: Callable[[Path], None] | None = None
) -> int:
    """Command line of a tool that generates a file: write it, or tell whether it is up to date.

    Args:
        tool: file of the tool, for the messages.
        purpose: what it is for.
        name: name of the file in the folder.
        text: what is to be in it.
        more: writes what else there is to write, to the folder.

    Returns:
        The exit status.
    """
    parser = argparse.ArgumentParser(prog=tool, description=purpose)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--check", action="store_true", help="only tell whether the file is up to date")
    options = parser.parse_args()
    file = options.folder / name
    if not options.check:
        file.write_text(text, encoding="utf-8")
        if more is not None:
            more(options.folder)
    elif not file.is_file() or file.read_text(encoding="utf-8") != text:
        print(f"{file} is out of date; run: python {tool} {options.folder}", file=sys.stderr)
        return 1
    return 0


def main() -> int:
    """Write or check the page."""
    return write_or_check("tools/topics_page.py", __doc__, PAGE, page())


if __name__ == "__main__":
    sys.exit(main())
