# SPDX-License-Identifier: Apache-2.0
"""Comparison tables in Markdown, made from the result objects of :func:`ftcm_core.recording.metrics.result`.

Every number but :data:`PUBLISHED` comes from the results.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from tabulate import tabulate

from ftcm_core.recording.detection import pooled_scores
from ftcm_core.recording.metrics import SETTLING_BAND
from ftcm_core.scenario import load, shipped_scenarios

PUBLISHED: dict[str, tuple[float, float, float]] = {
    "smc": (0.008021, 0.007490, 0.154244),
    "nftsmc": (0.019966, 0.005121, 0.004845),
    "ftcm": (0.002819, 0.002807, 0.002785),
}
"""Table 2 of Vo and Kang, "A novel fault-tolerant control method for robot manipulators based on non-singular
fast terminal sliding mode control and disturbance observer", IEEE Access 8 (2020),
doi:10.1109/ACCESS.2020.3001391: average control errors E1, E2, E3, rad."""

NOT_REPRODUCED = {("smc", 2), ("nftsmc", 0)}
"""Entries of Table 2, (controller, joint from 0), that no reading of the paper reproduces."""

ABSENT = "–"
Result = dict[str, Any]


def comparison_table(results: Sequence[Result]) -> str:
    """Compare runs: one line per run in each table (mean errors; their windows; peak and torque).

    Args:
        results: objects of :func:`ftcm_core.recording.metrics.result`, optionally with a ``label`` each.

    Returns:
        Markdown, with a line for every run that did not complete.
    """
    joints = max((_joints(r) for r in results), default=0)
    several = len({r["scenario"] for r in results}) > 1 and not all("label" in r for r in results)
    who = ["scenario", "controller"] if several else ["controller"]
    errors = [[*who, *(f"E{j + 1}" for j in range(joints)), "share of transient", "status"]]
    windows = [[*who, "transient", "before fault", "after fault"]]
    efforts = [[*who, "peak after fault, rad", "torque variation after transient, N·m/s"]]
    for result in results:
        name = ([str(result["scenario"])] if several else []) + [run_name(result)]
        whole = values(result, "whole", "mean_abs_error") or [None] * joints
        share = _cell(transient_share(result), lambda x: f"{100 * x:.2f} %")
        errors.append([*name, *(_number(x, 4) for x in whole), share, status(result)])
        means = (values(result, w, "mean_abs_error") for w in ("transient", "before_fault", "after_fault"))
        windows.append([*name, *map(_cell, means)])
        efforts.append(
            [
                *name,
                _cell(values(result, "after_fault", "max_abs_error")),
                _cell(values(result, "after_transient", "torque_total_variation"), large),
            ]
        )
    lines = [
        "Mean |e| over the whole run, rad, and the share of it that is the transient, joint by joint:",
        "",
        markdown(errors),
        "",
        f"Mean |e| in each window, rad. {_windows(results)}".rstrip(),
        "",
        markdown(windows),
        "",
        "Peak |e| after the fault, and total variation of the torque (chattering):",
        "",
        markdown(efforts),
    ]
    details = [f"- {run_name(r)}: {r['status']}: {_reason(r)}" for r in results if r["status"] != "completed"]
    if details:
        lines += ["", "Runs that ended early; their values cover only what was run:", "", *details]
    return "\n".join(lines) + "\n"


def settling_table(results: Sequence[Result]) -> str:
    """Measured settling time beside the law's bound, in Markdown."""
    rows = [["controller", "settled after, s", "bound, s"]]
    for result in results:
        measured = values(result, "whole", "settling_time")
        bound = result["settling_time_bound"]
        rows.append(
            [run_name(result), _cell(measured, lambda x: f"{x:.3f}"), _cell(bound, lambda x: f"{x:.3f}")]
        )
    return (
        f"Time until |e| stays within {SETTLING_BAND:g} rad, joint by joint. The bound (eq 15, or the law's\n"
        "own) is for the motion on the sliding surface, from the initial error to zero; the time to\n"
        "reach it comes on top.\n\n"
        f"{markdown(rows)}\n"
    )


def detection_table(results: Sequence[Result]) -> str:
    """Faults detected and missed, and false alarms, in Markdown; empty when no run has a detector."""
    having = [(run_name(r), r["detection"]) for r in results if r.get("detection")]
    if not having:
        return ""
    found = [
        ["run", "detector", "fault", "joint", "onset, s", "detected after, s", "alarm of joint", "verdict"]
    ]
    false = [["run", "detector", "false alarms", "exposure, s", "per hour", "share of it in alarm"]]
    for name, one in having:
        for f in one["faults"]:
            delay = _number(f["delay"]) if f["detected"] else "missed"
            if not f["detected"] and f["alarm_before"]:
                delay += ", alarm on before"
            joints = ", ".join(map(str, f["alarm_joints"])) or ABSENT
            joint = str(f["joint"] or "all")
            said = f["verdict"] or ABSENT
            if f["verdict_joint"]:
                said += f", joint {f['verdict_joint']}"
            found.append(
                [name, one["detector"], f["type"], joint, _number(f["onset"], 6), delay, joints, said]
            )
        rate, share = _cell([one["false_alarms_per_hour"]], large), _cell([one["false_share"]])
        false.append(
            [name, one["detector"], str(one["false_alarms"]), _number(one["exposure"], 6), rate, share]
        )
    lines = []
    if len(found) > 1:
        lines = ["Faults detected: an alarm begins while the fault acts.", "", markdown(found), ""]
    lines += [
        "False alarms: those that begin after the transient while no fault acts; the exposure is that time.",
        "",
        markdown(false),
    ]
    if len(having) > 1:
        lines += ["", pooled_text(pooled_scores([one for _, one in having]))]
    return "\n".join(lines) + "\n"


def accommodation_table(results: Sequence[Result]) -> str:
    """What policies did about faults, in Markdown; empty when no run has any."""
    having = [r for r in results if r["configuration"] and r["configuration"].get("policies")]
    if not having:
        return ""
    rows = [["run", "policy", "in force from, s", "tick", "told", "joint"]]
    for result in having:
        for d in result["decisions"]:
            t = _number(d["tick"] * result["configuration"]["dt"], 6)
            rows.append([run_name(result), d["policy"], t, str(d["tick"]), d["verdict"], str(d["joint"])])
        if not result["decisions"]:
            rows.append([run_name(result), "none", ABSENT, ABSENT, ABSENT, ABSENT])
    return f"Accommodation: what the policies did about what the detector told.\n\n{markdown(rows)}\n"


def pooled_text(total: Result) -> str:
    """Return what :func:`ftcm_core.recording.detection.pooled_scores` gives, in a sentence."""
    text = f"Together, {total['runs']} runs: "
    if total["faults"]:
        text += f"{total['missed']} of {total['faults']} faults missed; "
    if total["delay_median"] is not None:
        text += f"delay {total['delay_median']:.3g} s (median), {total['delay_q95']:.3g} s (95 %); "
    text += f"{total['false_alarms']} false alarms in {total['exposure']:.6g} s"
    if total["exposure"]:
        low, high = total["false_alarms_per_hour_95"]
        rate = total["false_alarms_per_hour"]
        text += f", {large(rate)} per hour (95 %: {large(low)} to {large(high)} if they come independently)"
    return text + "."


def paper_table(results: Sequence[Result]) -> str:
    """Compare runs of the paper's experiment with its Table 2.

    Args:
        results: objects of :func:`ftcm_core.recording.metrics.result`.

    Returns:
        Markdown; empty when no result is a run of the paper's experiment.
    """
    ours = {r["controller"]: r for r in results if is_paper_run(r)}
    ours = {name: ours[name] for name in PUBLISHED if name in ours}
    if not ours:
        return ""
    rows = [["controller", *(f"E{j} {what}" for j in (1, 2, 3) for what in ("published", "here", "ratio"))]]
    ratios: dict[tuple[str, int], float] = {}
    for name, result in ours.items():
        row = [name]
        for joint, mean in enumerate(values(result, "whole", "mean_abs_error") or []):
            published = PUBLISHED[name][joint]
            row += [
                f"{published:.6f}",
                _number(mean, 4),
                ABSENT if mean is None else f"{mean / published:.3f}",
            ]
            if mean is not None:
                ratios[name, joint] = mean / published
        rows.append(row)
    close = sum(abs(ratio - 1.0) <= 0.1 for ratio in ratios.values())
    text = [
        "Table 2 of the paper (published values, Vo and Kang 2020) beside these runs: mean |e|, rad.",
        "",
        markdown(rows),
        "",
        f"{close} of {len(ratios)} entries are within 10 % of the published ones.",
    ]
    known = sorted(NOT_REPRODUCED & set(ratios), reverse=True)
    if known:
        entries = " and ".join(f"{name.upper()} E{j + 1} (ratio {ratios[name, j]:.3g})" for name, j in known)
        verb = "does" if len(known) == 1 else "do"
        text.append(
            f"{entries} {verb} not reproduce: about 4,900 readings of the paper\n"
            "were tried; those that come near its SMC E3 are chaotic, a change of 1e-13 in the model moves\n"
            "the value between 0.008 and infinity."
        )
    share = transient_share(ours["ftcm"]) if "ftcm" in ours else None
    if share:
        after = values(ours["ftcm"], "after_fault", "mean_abs_error")
        text.append(
            f"The FTCM row is all initial transient: at least {100 * min(share):.4g} % of it arises in the "
            f"first {ours['ftcm']['configuration']['transient']:g} s;\n"
            f"after the fault its mean |e| is {_cell(after)} rad. Compare the windows, not only the mean."
        )
    return "\n".join(text) + "\n"


def is_paper_run(result: Result) -> bool:
    """Whether a result is the paper's experiment, completed, with one of its controllers as it has them."""
    configuration, controller = result["configuration"], result["controller"]
    if (
        not configuration
        or controller not in PUBLISHED
        or result["status"] != "completed"
        or result["changes"]
    ):
        return False
    paper = load(str(shipped_scenarios()["paper"]), controller=controller)
    ignored = {"name", "seed", "transient"}
    if not paper.controller.needs_observer:
        ignored.add("observer")
    expected = paper.to_mapping()
    return all(configuration.get(key) == value for key, value in expected.items() if key not in ignored)


def values(result: Result, window: str, metric: str) -> list[float | None] | None:
    """Return one metric of a window, per joint; None when the run does not have that window."""
    found = result["metrics"].get(window)
    return None if found is None else found[metric]


def transient_share(result: Result) -> list[float] | None:
    """Share of the whole run's mean |e| that arises in the transient window, per joint; None if unknown."""
    whole, transient = values(result, "whole", "iae"), values(result, "transient", "iae")
    if not whole or not transient:
        return None
    shares = [t / w for t, w in zip(transient, whole) if w and t is not None]
    return shares if len(shares) == len(whole) else None


def status(result: Result) -> str:
    """Return how a run ended and, unless it completed, when."""
    if result["status"] == "completed":
        return "completed"
    time = result["ended_at"]
    if time is None and result["configuration"]:
        time = result["ticks"] * result["configuration"]["dt"]
    return str(result["status"]) if time is None else f"{result['status']} at {time:g} s"


def run_name(result: Result) -> str:
    """Return what a run is called in tables: its label, or its controller and the swaps during the run."""
    if "label" in result:
        return str(result["label"])
    swaps = [f" → {c['type']} at tick {c['tick']}" for c in result["changes"] if c["kind"] == "controller"]
    return str(result["controller"] or "unknown") + "".join(swaps)


def _reason(result: Result) -> str:
    return result["detail"] or f"{result['ticks']} ticks recorded"


def _joints(result: Result) -> int:
    return len(result["first_torque"])


def _windows(results: Sequence[Result]) -> str:
    """One sentence that says what the windows are, if they are the same in all results."""
    found = set()
    for result in results:
        configuration = result["configuration"]
        if configuration is None:
            return ""
        onset = min((f["start"] for f in configuration["injection"]["faults"]), default=None)
        found.add((configuration["transient"], onset))
    if len(found) != 1:
        return ""
    transient, onset = found.pop()
    fault = "no fault" if onset is None else f"fault at {onset:g} s"
    return f"Transient: the first {transient:g} s; {fault}."


def _number(x: float | None, digits: int = 3) -> str:
    return ABSENT if x is None else f"{x:.{digits}g}"


def large(x: float) -> str:
    """Return a number that may be large, of three digits at least."""
    return f"{x:,.0f}" if x >= 100.0 else f"{x:.3g}"


def _cell(row: Sequence[float | None] | None, form: Any = _number) -> str:
    """Format one value per joint as ``a / b / c``."""
    known = [x if x is not None and math.isfinite(x) else None for x in row or ()]
    if all(x is None for x in known):
        return ABSENT
    return " / ".join(ABSENT if x is None else form(x) for x in known)


def markdown(rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table whose columns line up as plain text too; the first row is the heading."""
    count = len(rows[0])
    cells = [[*(c.replace("|", "\\|") for c in row), *[ABSENT] * (count - len(row))] for row in rows]
    text: str = tabulate(cells[1:], headers=cells[0], tablefmt="github", disable_numparse=True)
    return text
