# SPDX-License-Identifier: Apache-2.0
"""The verdict of a real-time run: deadlines missed, because of what, and what to try. No ROS."""

from __future__ import annotations

from collections.abc import Mapping

from ftcm_ros.analysis.timing import by_process

BUSY_SHARE = 0.8
"""Of all processors, or of a tick: with more than that there is no room for anything in between."""
_REASONS = {
    "late_torque": "the torque had not come at the deadline",
    "late_disturbance": "the disturbance had not come at the deadline",
    "plant_overrun": "the plant itself came more than a tick late",
}


def verdict(nodes: Mapping[str, Mapping[str, str]], dt: float, priority: int, processors: int) -> str:
    """Judge a run in real time.

    Args:
        nodes: the last diagnostics of each node.
        dt: length of a tick, s.
        priority: SCHED_FIFO priority that was asked for, 0 for none.
        processors: how many this machine has.

    Returns:
        Sentences for the user.
    """
    plant = nodes["plant"]
    missed, ticks = int(plant["missed_deadlines"]), int(plant["tick"]) + 1
    rate = f"{1 / dt:g} Hz"
    if not missed:
        return f"real time at {rate}: none of {ticks:,} deadlines missed"
    causes = sorted(((int(plant[cause]), cause) for cause in _REASONS), reverse=True)
    because = ", ".join(f"{count:,} × {_REASONS[cause]}" for count, cause in causes if count)
    seconds = max(float(plant["elapsed_seconds"]), dt)
    busy, waited = (sum(by_process(nodes, key).values()) for key in ("cpu_seconds", "waited_seconds"))
    work = float(plant.get("latency_p50_us", 0.0)) * 1e-6
    advice = []
    if work > BUSY_SHARE * dt:
        advice.append(f"a tick's work takes {1e3 * work:.2g} ms of {1e3 * dt:g}: a longer dt")
    if len({values.get("process", name) for name, values in nodes.items() if name != "recorder"}) > 1:
        advice.append("composed nodes (--composed)")
    if not priority:
        advice.append("real-time scheduling (--priority 50 --lock-memory)")
    elif "priority" in plant.get("not_permitted", ""):
        advice.append("to permit the priority that was asked for")
    if busy > BUSY_SHARE * processors * seconds:
        advice.append("a machine with more processors")
    else:
        advice.append("a machine with nothing else to do, with more processors or a real-time kernel")
    return (
        f"real time at {rate}: {missed:,} of {ticks:,} deadlines missed ({100 * missed / ticks:.2g} %): "
        f"{because}. The nodes used {busy / seconds:.2f} of {processors} processors, and were ready but "
        f"without one for {waited:.2g} of {seconds:.3g} s. Try: {'; '.join(advice)}"
    )
