# SPDX-License-Identifier: Apache-2.0
"""The graph's topics: names, message types, who publishes and subscribes, in one place."""

from __future__ import annotations

from typing import NamedTuple

from ftcm_core.scenario import Scenario
from ftcm_ros.transport.codec import JOINT_STATE

DEPTH = 4000
"""Queue depth of every data topic: four seconds at 1 kHz. The middleware keeps so many, read or not."""

_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"


class Topic(NamedTuple):
    """One topic of the suite."""

    name: str
    type: str
    publishers: tuple[str, ...]
    subscribers: tuple[str, ...]
    content: str
    latched: bool = False
    depth: int = DEPTH


JOINT_STATES = Topic(
    "joint_states",
    JOINT_STATE,
    ("plant",),
    ("observer", "controller", "injector", "recorder"),
    "position rad, velocity rad/s, effort N·m: the torque applied over the tick that ended at the stamp",
)
ESTIMATE = Topic(
    "disturbance_estimate",
    JOINT_STATE,
    ("observer",),
    ("controller", "recorder"),
    "effort N·m: the observer's estimate tau_hat = M(q) Δ̂",
)
TORQUES = Topic(
    "joint_torques",
    JOINT_STATE,
    ("controller",),
    ("plant", "injector", "recorder"),
    "effort N·m: the commanded torque u",
)
DISTURBANCE = Topic(
    "disturbance",
    JOINT_STATE,
    ("injector",),
    ("plant", "recorder"),
    "effort N·m: the torque added to the plant's input, faults minus friction and disturbance",
)
REFERENCE = Topic(
    "reference",
    JOINT_STATE,
    ("controller",),
    ("recorder",),
    "position rad, velocity rad/s: desired motion",
)
TRUE_STATE = Topic(
    "true_state",
    JOINT_STATE,
    ("plant",),
    ("injector", "recorder"),
    "position rad, velocity rad/s: the true motion; only where the scenario's sensor is not ideal",
)
CHANGES = Topic(
    "component_changes",
    _ARRAY,
    ("controller", "observer"),
    ("recorder",),
    "the component in force and its parameters, stamped with its first tick",
    latched=True,
    depth=100,
)
SCENARIO = Topic(
    "scenario",
    "std_msgs/msg/String",
    ("plant",),
    ("recorder",),
    "the complete scenario in YAML",
    latched=True,
    depth=100,
)
DIAGNOSTICS = Topic(
    "/diagnostics",
    _ARRAY,
    ("plant", "observer", "controller", "injector", "recorder"),
    ("recorder",),
    "health of each node, once a second",
    depth=100,
)
RECORDED = Topic(
    "recorded",
    "builtin_interfaces/msg/Time",
    ("recorder",),
    ("plant",),
    "stamp up to which every data topic is recorded",
    depth=10,
)
CLOCK = Topic(
    "/clock",
    "rosgraph_msgs/msg/Clock",
    ("plant",),
    (),
    "simulated time, 100 Hz; an output only",
    depth=10,
)

DATA = (JOINT_STATES, ESTIMATE, TORQUES, DISTURBANCE, REFERENCE)
"""One message per tick each."""
EVENTS = (CHANGES, SCENARIO, DIAGNOSTICS)
"""Recorded besides."""
TOPICS = (*DATA, TRUE_STATE, *EVENTS, RECORDED, CLOCK)
"""All topics of the suite."""


def data_topics(scenario: Scenario | None) -> tuple[Topic, ...]:
    """Topics with one message per tick in a run of this scenario."""
    return DATA if scenario is None or scenario.sensor.exact else (*DATA, TRUE_STATE)


def subscribers(topic: Topic, scenario: Scenario) -> tuple[str, ...]:
    """Nodes of the suite that subscribe a topic in a run of this scenario."""
    if topic is JOINT_STATES and not scenario.sensor.exact:  # the injector acts on the true motion
        return tuple(n for n in topic.subscribers if n != "injector")
    return topic.subscribers
