# SPDX-License-Identifier: Apache-2.0
"""The command line: ``ftcm simulate``, ``compare``, ``reproduce``, ``campaign``, ``list``, ``describe``.

Results go to stdout, warnings, progress and errors to stderr. Exit status: 0 done (a run that diverges is a
result), 1 the machine failed (disk, memory), 2 a mistake in what was asked, 130 interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import functools
import io
import math
import os
import sys
import textwrap
import time
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import ftcm_core
from ftcm_core import campaign, compiled
from ftcm_core.controllers import Controller
from ftcm_core.errors import FtcmError, ScenarioError, suggestion
from ftcm_core.metrics import result
from ftcm_core.parallel import run_parallel
from ftcm_core.params import specs
from ftcm_core.registry import KINDS, Component, components, find
from ftcm_core.report.reference import summary
from ftcm_core.report.results import labelled, new_folder, report, save_trace, to_json, write_results
from ftcm_core.report.table import PUBLISHED, status
from ftcm_core.scenario import Scenario, load, shipped_scenarios
from ftcm_core.simulation import simulate
from ftcm_core.trace import Trace

Job = tuple[str, Scenario]
"""A label and what to run."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: arguments; those of the process by default.

    Returns:
        The exit status.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # "Δ" must not crash on an ASCII terminal
            stream.reconfigure(errors="replace")
    try:
        arguments = _parser().parse_args(argv)
        code: int = arguments.run(arguments)
        if sys.stdout is not None:
            sys.stdout.flush()
        return code
    except FtcmError as error:
        return _fail(str(error), 2)
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        _drop_stdout()
        return 141
    except BrokenProcessPool:
        return _fail("a simulation process was ended from outside; out of memory?", 1)
    except MemoryError:
        return _fail("out of memory; shorten duration or raise dt", 1)
    except OSError as error:
        _drop_stdout()
        return _fail(": ".join(str(x) for x in (error.filename, error.strerror or error) if x), 1)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ftcm", description="Fault-tolerant control of a robot, simulated in process."
    )
    parser.add_argument("--version", action="version", version=f"ftcm {ftcm_core.__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def command(name: str, function: Any, text: str, example: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text, epilog=f"example: {example}")
        sub.set_defaults(run=function)
        return sub

    def shared(sub: argparse.ArgumentParser, *, overrides: bool = True) -> None:
        if overrides:
            sub.add_argument(
                "--set", nargs="+", action="extend", default=[], metavar="PATH=VALUE", dest="overrides",
                help="change values of the scenario, e.g. observer.k1=10000",
            )  # fmt: skip
        sub.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
        sub.add_argument("--output", metavar="DIR", help="write results, tables and figures to a new folder")
        sub.add_argument("--no-figures", action="store_true", help="leave the figures out of --output")

    sub = command(
        "simulate", _simulate, "run one scenario", "ftcm simulate paper --controller smc --set duration=20"
    )
    sub.add_argument(
        "scenario", nargs="?", metavar="SCENARIO", help="scenario file, or name of a shipped one"
    )
    sub.add_argument("--controller", metavar="NAME", help="use this controller")
    sub.add_argument("--observer", metavar="NAME", help="use this observer")
    sub.add_argument("--engine", choices=("plain", "compiled"), default="plain", help="compiled needs numba")
    shared(sub)

    sub = command("compare", _compare, "run several controllers on one or more scenarios, in parallel",
                  "ftcm compare paper --controllers smc ftcm")  # fmt: skip
    sub.add_argument(
        "scenarios", nargs="*", metavar="SCENARIO", help="scenario files or names of shipped ones"
    )
    sub.add_argument("--controllers", nargs="+", metavar="NAME", help="controllers to compare; default: all")
    shared(sub)

    sub = command("reproduce", _reproduce, "repeat the paper's experiment: its Table 2 and its figures",
                  "ftcm reproduce --output results/paper")  # fmt: skip
    shared(sub, overrides=False)

    sub = command(
        "campaign", _campaign, "run one scenario many times, values drawn at random, and give statistics",
        "ftcm campaign paper --runs 1000 --vary 'injection.faults.0.start=uniform(5, 15)'",
    )  # fmt: skip
    sub.add_argument(
        "source",
        nargs="?",
        metavar="SCENARIO",
        help="scenario or campaign file, or name of a shipped scenario",
    )
    sub.add_argument("--runs", type=int, metavar="N", help="number of draws; default: 100")
    sub.add_argument("--seed", type=int, metavar="N", help="seed of the draws; default: 0")
    sub.add_argument(
        "--vary", nargs="+", action="extend", default=[], metavar="PATH=DISTRIBUTION",
        help="draw a value: " + "; ".join(form for form, _ in campaign.DISTRIBUTIONS.values()),
    )  # fmt: skip
    sub.add_argument(
        "--set", nargs="+", action="extend", default=[], metavar="PATH=VALUE", dest="overrides",
        help="change values in every run",
    )  # fmt: skip
    sub.add_argument("--controllers", nargs="+", metavar="NAME", help="run every draw with each of these")
    sub.add_argument("--jobs", type=int, metavar="N", help="number of processes; default: one per core")
    sub.add_argument(
        "--engine", choices=campaign.ENGINES, default="auto",
        help="compiled needs numba; auto: compiled where that is installed",
    )  # fmt: skip
    sub.add_argument("--json", action="store_true", help="print the summary as one JSON object")
    sub.add_argument("--output", metavar="DIR", help="write every run and the summary to a new folder")

    sub = command("list", _list, "list scenarios and components", "ftcm list controller")
    sub.add_argument("kind", nargs="?", metavar="KIND", help=f"one of scenario, {', '.join(KINDS)}")
    sub.add_argument("--json", action="store_true", help="print one JSON object")

    sub = command("describe", _describe, "describe a component and its parameters", "ftcm describe ftcm")
    sub.add_argument("name", metavar="NAME", help="name of a component, or KIND/NAME")
    sub.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _simulate(arguments: argparse.Namespace) -> int:
    overrides = list(arguments.overrides)
    sources = _sources([arguments.scenario] if arguments.scenario else [], overrides)
    if len(sources) != 1:
        raise FtcmError(
            f"simulate runs one scenario, got {', '.join(sources) or 'none'}; expected e.g. paper"
        )
    if arguments.controller is not None:
        find("controller", arguments.controller)
    if arguments.observer is not None:
        find("observer", arguments.observer)
        overrides.insert(0, f"observer.type={arguments.observer}")
    scenario = load(sources[0], overrides, arguments.controller)
    folder = new_folder(arguments.output) if arguments.output is not None else None
    label = scenario.controller.type_name
    _warn([(label, scenario)])
    if arguments.engine == "compiled":
        compiled_trace = compiled.simulate(scenario)
        if compiled_trace.engine != "compiled":
            _note(f"warning: it ran {compiled_trace.engine}")
        trace: Trace = compiled_trace
    else:
        trace = simulate(scenario, progress=_progress_line if sys.stderr and sys.stderr.isatty() else None)
    found = result(trace)
    _print_results(found if arguments.json else [found])
    if folder:
        save_trace(folder / "trace.npz", trace)
        write_results(folder, [(label, trace)], figures=not arguments.no_figures)
    return 0


def _compare(arguments: argparse.Namespace) -> int:
    sources = _sources(arguments.scenarios, arguments.overrides)
    if not sources:
        raise FtcmError("compare runs one scenario or more; expected e.g. paper")
    names: list[str] = arguments.controllers or list(components("controller"))
    for name in names:
        find("controller", name)
    jobs: list[Job] = []
    for source in sources:
        for name in dict.fromkeys(names):
            try:
                scenario = load(source, arguments.overrides, name)
            except ScenarioError as error:
                if arguments.controllers or "uses the disturbance estimate" not in str(error):
                    raise ScenarioError(f"with controller {name}: {error}") from None
                _note(f"left out: {error}")
                continue
            jobs.append((name if len(sources) == 1 else f"{scenario.name}/{name}", scenario))
    return _run_all(jobs, arguments)


def _reproduce(arguments: argparse.Namespace) -> int:
    paper = str(shipped_scenarios()["paper"])
    return _run_all([(name, load(paper, controller=name)) for name in PUBLISHED], arguments)


def _run_all(jobs: Sequence[Job], arguments: argparse.Namespace) -> int:
    """Run jobs in parallel, then print and write their results in the order of the jobs."""
    folder = new_folder(arguments.output) if arguments.output is not None else None
    _warn(jobs)
    found: dict[int, tuple[dict[str, Any], Trace | None]] = {}
    for index, outcome in run_parallel(functools.partial(_run_job, keep_trace=folder is not None), jobs):
        found[index] = outcome
        _note(f"[{len(found)}/{len(jobs)}] {jobs[index][0]}: {status(outcome[0])}")
    results = [found[i][0] for i in range(len(jobs))]
    _print_results({"results": results} if arguments.json else results)
    if folder:
        traces = [(label, found[i][1]) for i, (label, _) in enumerate(jobs)]
        kept = [(label, trace) for label, trace in traces if trace is not None]
        write_results(folder, kept, figures=not arguments.no_figures)
    return 0


def _print_results(found: dict[str, Any] | list[dict[str, Any]]) -> None:
    """Print one JSON object, or the tables of a list of results."""
    if isinstance(found, dict):
        print(to_json(found), flush=True)
    else:
        print(report(found), end="", flush=True)


def _run_job(job: Job, keep_trace: bool) -> tuple[dict[str, Any], Trace | None]:
    label, scenario = job
    trace = simulate(scenario)
    return labelled(label, trace), trace if keep_trace else None


def _campaign(arguments: argparse.Namespace) -> int:
    overrides = list(arguments.overrides)
    sources = _sources([arguments.source] if arguments.source else [], overrides)
    if len(sources) != 1:
        raise FtcmError(
            f"campaign takes one scenario or campaign file, got {', '.join(sources) or 'none'}; "
            "expected e.g. paper"
        )
    planned = campaign.from_file(sources[0])
    varied = tuple(campaign.parse_variation(text) for text in arguments.vary)
    again = {v.path for v in varied}
    planned = dataclasses.replace(
        planned,
        runs=planned.runs if arguments.runs is None else arguments.runs,
        seed=planned.seed if arguments.seed is None else arguments.seed,
        variations=(*(v for v in planned.variations if v.path not in again), *varied),
        overrides=(*planned.overrides, *overrides),
        controllers=tuple(arguments.controllers or planned.controllers),
    )
    if arguments.jobs is not None and arguments.jobs < 1:
        raise FtcmError(f"--jobs {arguments.jobs}: expected at least 1")
    campaign.chosen_engine(arguments.engine)
    folder = new_folder(arguments.output) if arguments.output is not None else None
    summary = campaign.run_campaign(
        planned, engine=arguments.engine, jobs=arguments.jobs, folder=folder, progress=_campaign_progress()
    )
    print(to_json(summary) if arguments.json else campaign.table(summary), flush=True)
    return 0


def _campaign_progress() -> Callable[[int, int], None]:
    """Return what shows how far a campaign is: a line that is rewritten, in a file one per tenth."""
    begin = time.monotonic()
    tenth = 0

    def show(done: int, total: int) -> None:
        nonlocal tenth
        passed = time.monotonic() - begin
        text = f"ftcm: {done}/{total} runs, {passed:.0f} s, about {passed / done * (total - done):.0f} s left"
        if sys.stderr is None:
            return
        if sys.stderr.isatty():
            print(f"\r{text}\033[K", end="\n" if done == total else "", file=sys.stderr, flush=True)
        elif 10 * done // total > tenth:
            tenth = 10 * done // total
            print(text, file=sys.stderr, flush=True)

    return show


def _list(arguments: argparse.Namespace) -> int:
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


def _describe(arguments: argparse.Namespace) -> int:
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
    if issubclass(cls, Controller):
        described["needs_observer"] = cls.needs_observer
    return described


def _description_text(cls: type[Component]) -> str:
    lines = [f"{cls.kind} {cls.type_name}", *textwrap.wrap(summary(cls), 100, initial_indent="  ")]
    if issubclass(cls, Controller) and cls.needs_observer:
        lines.append("  Needs an observer.")
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


def _sources(named: Sequence[str], overrides: list[str]) -> list[str]:
    """Scenarios of a command; those written after ``--set`` are taken out of the overrides."""
    if named:
        return list(named)
    found: list[str] = []
    while overrides and "=" not in overrides[-1]:
        found.insert(0, overrides.pop())
    return found


def _warn(jobs: Sequence[Job]) -> None:
    for text in dict.fromkeys(w for _, scenario in jobs for w in scenario.controller.warnings()):
        _note(f"warning: {text}")


def _note(text: str) -> None:
    if sys.stderr is not None:
        print(f"ftcm: {text}", file=sys.stderr, flush=True)


def _progress_line(done: int, last: int) -> None:
    end = "\r" if done + 1000 <= last else "\r\033[K"
    print(f"ftcm: {100 * done // max(1, last)} %", end=end, file=sys.stderr, flush=True)


def _fail(message: str, code: int) -> int:
    _note("error: " + " ".join(message.split()))
    return code


def _drop_stdout() -> None:
    """Give up on stdout, so that the interpreter does not complain about it when it exits."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    sys.exit(main())
