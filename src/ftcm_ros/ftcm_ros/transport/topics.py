# SPDX-License-Identifier: Apache-2.0
"""The graph's topics: names, message types, who publishes and subscribes, in one place."""

from __future__ import annotations

from typing import NamedTuple

from ftcm_core.scenario import Scenario
from ftcm_core.signals import CHANNELS, COLUMNS, Channel, channels
from ftcm_ros.transport.codec import JOINT_STATE
from ftcm_ros.transport.float_array import FLOAT_ARRAY

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


def _data_topic(channel: Channel) -> Topic:
    """Topic of a channel of the core, which declares its writer, its readers and its arrays."""
    arrays = ("position", "velocity", "effort")
    said = [
        f"{array} {COLUMNS[name].unit}: {COLUMNS[name].meaning}"
        for array, name in zip(arrays, channel.columns)
        if name
    ]
    return Topic(
        channel.topic, JOINT_STATE, (channel.writer,), (*channel.readers, "recorder"), "; ".join(said)
    )


_BY_NAME = {channel.topic: _data_topic(channel) for channel in CHANNELS}
JOINT_STATES = _BY_NAME["joint_states"]
ESTIMATE = _BY_NAME["disturbance_estimate"]
TORQUES = _BY_NAME["joint_torques"]
DISTURBANCE = _BY_NAME["disturbance"]
REFERENCE = _BY_NAME["reference"]
TRUE_STATE = _BY_NAME["true_state"]
"""In every tick where something hides the true motion or torque (``Scenario.hidden``); else only after a tick
in which another disturbance acted than the one of that tick."""
DETECTION = _BY_NAME["detection"]
CHANGES = Topic(
    "component_changes",
    _ARRAY,
    ("controller", "observer", "detector"),
    ("recorder",),
    "the component in force and its parameters, or what a policy has decided, stamped with its first tick",
    latched=True,
    depth=100,
)
FAULTS = Topic(
    "faults",
    _ARRAY,
    ("plant", "injector", "controller"),
    ("injector", "recorder"),
    "ground truth: from when to when a fault acts, as soon as it is decided, stamped with that tick",
    latched=True,
    depth=1000,
)
FAULT_ORDERS = Topic(
    "fault_orders",
    "std_msgs/msg/String",
    ("injector",),
    ("plant", "controller"),
    "`arm LABEL` or `clear LABEL`: an order by hand, taken by the injector's services",
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
    ("plant", "observer", "controller", "injector", "detector", "recorder"),
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
COMMAND = Topic(
    "/effort_controller/commands",
    FLOAT_ARRAY,
    ("controller",),
    ("plant",),
    "torques N·m, one per joint in the order that both sides have agreed on; only with `command_interface: "
    "float64_multi_array`, under the name in `command_topic`",
    depth=10,
)
TRAJECTORY = Topic(
    "/joint_trajectory",
    "trajectory_msgs/msg/JointTrajectory",
    (),
    ("controller",),
    "a motion to follow from now on; only where `reference_topic` names the topic",
    depth=10,
)

EVENTS = (CHANGES, FAULTS, SCENARIO, DIAGNOSTICS)
"""Recorded besides the data topics."""
TOPICS = (*_BY_NAME.values(), *EVENTS, FAULT_ORDERS, RECORDED, CLOCK, COMMAND, TRAJECTORY)
"""All topics of the suite."""


def data_topics(scenario: Scenario | None) -> tuple[Topic, ...]:
    """Topics with one message per tick in a run of this scenario; if that is unknown, those of every run."""
    there = scenario.channels if scenario else channels(hidden=False, detector=False)
    return tuple(_BY_NAME[channel.topic] for channel in there)


def recorded_topics(scenario: Scenario) -> tuple[Topic, ...]:
    """Topics that the recorder subscribes."""
    events = [topic for topic in EVENTS if topic is not FAULTS or scenario.faults]
    return tuple(dict.fromkeys((*data_topics(scenario), TRUE_STATE, *events)))


def subscribers(topic: Topic, scenario: Scenario) -> tuple[str, ...]:
    """Nodes of the suite that subscribe a topic in a run of this scenario."""
    for channel in scenario.channels:
        if channel.topic == topic.name:
            return (*channel.readers, "recorder")
    if topic is FAULT_ORDERS:
        by_hand = (
            name
            for name in topic.subscribers
            for n in faults_at(scenario, name)
            if scenario.faults[n].by_hand
        )
        return tuple(dict.fromkeys(by_hand))
    return ("recorder",) if topic in (TRUE_STATE, DETECTION) else topic.subscribers


def faults_at(scenario: Scenario, node: str) -> tuple[int, ...]:
    """Faults that act in the stage of a node, by their place in the scenario's list."""
    return tuple(n for n, fault in enumerate(scenario.faults) if fault.stage == node)
