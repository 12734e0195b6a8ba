# SPDX-License-Identifier: Apache-2.0
"""What a real-time run says about its missed deadlines."""

from __future__ import annotations

from ftcm_ros.run.verdict import verdict

NAMES = ("plant", "observer", "controller", "injector")


def nodes(processes: int, cpu: float = 1.0, **plant: str) -> dict[str, dict[str, str]]:
    """Diagnostics of a run of 10 s that missed nothing, but for what is said."""
    common = {"cpu_seconds": str(cpu), "waited_seconds": "0.25"}
    found = {name: {**common, "process": str(i % processes)} for i, name in enumerate(NAMES)}
    found["plant"].update(
        missed_deadlines="0", tick="9999", elapsed_seconds="10.0", late_torque="0", late_disturbance="0",
        plant_overrun="0", latency_p50_us="120.0",
    )  # fmt: skip
    found["plant"].update(plant)
    return {**found, "recorder": {**common, "process": "recorder"}}


def test_nothing_missed() -> None:
    assert verdict(nodes(1), 0.001, 0, 2) == "real time at 1000 Hz: none of 10,000 deadlines missed"


def test_processes_are_told_to_be_composed_and_the_causes_are_in_order() -> None:
    said = verdict(nodes(4, missed_deadlines="50", late_disturbance="10", late_torque="40"), 0.001, 0, 2)
    assert said.startswith(
        "real time at 1000 Hz: 50 of 10,000 deadlines missed (0.5 %): 40 × the torque had not come at the "
        "deadline, 10 × the disturbance had not come at the deadline. The nodes used 0.50 of 2 processors, "
        "and were ready but without one for 1.2 of 10 s. Try: composed nodes (--composed); real-time "
        "scheduling"
    )


def test_a_run_that_ended_before_the_others_had_reported() -> None:
    early = nodes(4, missed_deadlines="3", late_torque="3", elapsed_seconds="0.0", tick="5")
    assert "3 of 6 deadlines missed (50 %)" in verdict({"plant": early["plant"]}, 0.001, 0, 2)


def test_composed_nodes_that_come_late_themselves() -> None:
    said = verdict(nodes(1, missed_deadlines="1", plant_overrun="1"), 0.001, 50, 2)
    assert "1 of 10,000 deadlines missed (0.01 %): 1 × the plant itself came more than a tick late. " in said
    assert "The nodes used 0.20 of 2 processors, and were ready but without one for 0.5 of 10 s" in said
    assert said.endswith("Try: a machine with nothing else to do, with more processors or a real-time kernel")


def test_a_priority_that_was_not_permitted() -> None:
    refused = {"not_permitted": "priority 50 is not permitted; ordinary scheduling is used"}
    said = verdict(nodes(1, missed_deadlines="1", plant_overrun="1", **refused), 0.001, 50, 2)
    assert "Try: to permit the priority that was asked for; a machine" in said


def test_a_tick_that_is_too_short_and_processors_that_are_all_busy() -> None:
    late = {"missed_deadlines": "9000", "plant_overrun": "9000", "latency_p50_us": "230.0"}
    said = verdict(nodes(4, 5.0, **late), 0.00025, 50, 2)
    assert "a tick's work takes 0.23 ms of 0.25: a longer dt" in said
    assert said.endswith("; a machine with more processors")
