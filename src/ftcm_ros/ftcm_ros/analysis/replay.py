# SPDX-License-Identifier: Apache-2.0
"""The command ``replay``: run what a bag has recorded again, in process, and compare float for float.

Scenario, seed, changes of components and versions come from the bag alone. How it is done:
:mod:`ftcm_core.replay`.

Exit status: 0 equal, 1 a run differs or a bag is damaged, 2 a mistake in what was asked.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ftcm_core.cli.replaying import replay_options
from ftcm_core.errors import FtcmError
from ftcm_core.recording.provenance import provenance
from ftcm_core.recording.trace import ENDED_EARLY
from ftcm_core.registry import load_plugins
from ftcm_core.replay import Record, Replay, cause, replay, verdict
from ftcm_core.replay.record import Message, channels_of
from ftcm_core.report.results import to_json
from ftcm_core.report.table import markdown
from ftcm_ros.bags.reader import BagContents, read_bag


class Proof(NamedTuple):
    """What the replay of a bag says."""

    bag: BagContents
    found: Replay
    versions: dict[str, tuple[str, str]]
    """Versions that are not the same here: recorded, and here."""

    @property
    def lines(self) -> list[str]:
        """The verdict, the likely cause of a difference, and what else matters, each in one line."""
        said = [verdict(self.found)]
        if why := cause(self.found, self.versions):
            said.append(f"likely cause: {why}")
        elif self.versions:
            other = ", ".join(f"{name} {a} (here {b})" for name, (a, b) in self.versions.items())
            said.append(f"equal although recorded with {other}")
        if "provenance" not in self.bag.metadata:
            said.append("the bag does not say with which versions it was recorded")
        if self.bag.damage:
            said.append("the bag is damaged: this is about what is left of it")
        return said

    def to_mapping(self) -> dict[str, Any]:
        """The same as plain data."""
        found, held = self.found, self.found.held
        first = found.first
        return {
            "equal": found.equal,
            "verdict": verdict(found),
            "cause": cause(found, self.versions),
            "ticks": found.record.ticks,
            "held": {"command": held.command, "disturbance": held.disturbance, "safe_stop": held.safe_stop},
            "as_in_process": found.whole,
            "first": first and {**first._asdict(), "apart": first.apart},
            "stages": {
                stage.name: {
                    "ticks": stage.ticks,
                    "differing": len(stage.differing),
                    "undecided": len(stage.undecided),
                    "largest_relative_difference": stage.largest,
                }
                for stage in found.stages
            },
            "versions": self.versions,
            "damage": self.bag.damage,
        }


def record_of_bag(bag: BagContents) -> Record:
    """Make a record of what is in a bag.

    Raises:
        FtcmError: the bag does not carry its scenario, or that has policies.
    """
    scenario, plant = bag.trace.scenario, bag.nodes.get("plant", {})
    if scenario is None:
        raise FtcmError(f"bag {str(bag.path)!r} does not carry its scenario: it cannot be replayed")
    if scenario.policies:
        raise FtcmError(
            f"bag {str(bag.path)!r}: its scenario has policies, and what they change is not replayed yet; "
            "expected a run without"
        )
    count = max(int(stamps.max()) for stamps in bag.stamps.values() if len(stamps)) // scenario.dt_ns + 1
    said: dict[str, list[Message | None]] = {}
    for topic, channel in channels_of(scenario).items():
        said[topic] = [None] * count
        if topic not in bag.stamps:
            continue
        ticks, first = np.unique(bag.stamps[topic] // scenario.dt_ns, return_index=True)
        arrays = [bag.arrays[topic][i] for i, column in enumerate(channel.columns) if column]
        filled = [map(tuple, array[first].tolist()) for array in arrays if array is not None]
        if len(filled) < len(arrays):  # of another program
            continue
        for tick, message in zip(ticks.tolist(), zip(*filled)):
            said[topic][tick] = message
    status = plant.get("state", "")
    return Record(
        scenario,
        said,
        bag.trace.changes,
        lockstep=plant.get("mode") == "lockstep",
        status=status if status in ENDED_EARLY else "completed",
        compiled=frozenset(name for name, values in bag.nodes.items() if values.get("stages") == "compiled"),
    )


def prove(bag: BagContents) -> Proof:
    """Replay a bag.

    Raises:
        FtcmError: that is not possible.
    """
    return Proof(bag, replay(record_of_bag(bag)), _other_versions(bag))


def _other_versions(bag: BagContents) -> dict[str, tuple[str, str]]:
    """Versions that are not the same here: recorded, and here."""
    try:
        recorded = dict(json.loads(bag.metadata["provenance"]))
    except (KeyError, TypeError, ValueError):
        return {}
    here = provenance()
    pairs = {name: (str(value), here.get(name, "none")) for name, value in recorded.items()}
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}


def _table(found: Replay) -> str:
    rows = [["stage", "ticks", "differ", "largest difference, relative", "not decided"]]
    for stage in found.stages:
        largest = f"{stage.largest:.2g}" if stage.differing else "0"
        rows.append(
            [
                stage.name,
                f"{stage.ticks:,}",
                f"{len(stage.differing):,}",
                largest,
                f"{len(stage.undecided):,}",
            ]
        )
    return markdown(rows)


def summarised(proofs: Sequence[tuple[str, Proof]]) -> str:
    """Return the verdicts of some replays for a report, in Markdown; nothing if there are none."""
    if not proofs:
        return ""
    lines = [f"- {label}: {'; '.join(proof.lines)}" for label, proof in proofs]
    return "\n".join(["Replay, in process, of what was recorded:", "", *lines]) + "\n"


def replay_bags(options: argparse.Namespace) -> int:
    """Do what the options say; return the exit status.

    Raises:
        FtcmError: a bag cannot be replayed.
    """
    results, failed = {}, False
    for path in options.bags:
        bag = read_bag(path)
        for line in (*bag.warnings(), *bag.remarks()):
            print(f"{path}: {line}", file=sys.stderr)
        proof = prove(bag)
        failed |= not proof.found.equal or bool(bag.damage and not options.accept_damage)
        results[str(path)] = proof.to_mapping()
        if not options.json:
            print(f"{path}: " + "\n".join(proof.lines) + f"\n\n{_table(proof.found)}\n", flush=True)
    if options.json:
        print(to_json(results, indent=1))
    return int(failed)


def build_parser() -> argparse.ArgumentParser:
    """Return the command line of ``replay``."""
    parser = argparse.ArgumentParser(
        prog="replay",
        description="Run what rosbag2 bags have recorded again, in process, and compare float for float.",
    )
    replay_options(parser)
    parser.add_argument(
        "--plugin",
        action="append",
        default=[],
        metavar="FILE",
        help="load components that the runs used from a Python file or module; this runs its code",
    )
    return parser


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of ``ros2 run ftcm_ros replay``."""
    try:
        options = build_parser().parse_args(argv)
        if sys.stdout is None:
            raise OSError("standard output is closed; results go there: redirect it, e.g. > FILE")
        load_plugins(options.plugin)
        status = replay_bags(options)
        sys.stdout.flush()
    except FtcmError as error:
        print(f"replay: error: {error}", file=sys.stderr)
        status = 2
    except BrokenPipeError:
        sys.stderr.close()
        status = 141
    except OSError as error:
        print(f"replay: error: {error}", file=sys.stderr)
        status = 1
    except KeyboardInterrupt:
        status = 130
    sys.exit(status)


if __name__ == "__main__":
    main()
