# SPDX-License-Identifier: Apache-2.0
"""The nodes' own parameters (those of components come from their declarations), declared once."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ftcm_core.errors import FtcmError, suggestion
from ftcm_core.scenario import Scenario

NODES = ("plant", "observer", "controller", "injector", "recorder")
"""Nodes of every run."""
ALL_NODES = (*NODES, "detector")
"""Nodes of the suite; a detector is there where the scenario has one."""


def nodes_of(scenario: Scenario) -> tuple[str, ...]:
    """Return the nodes of a run."""
    return ALL_NODES if scenario.detector else NODES


class Setting(NamedTuple):
    """One read-only node parameter."""

    name: str
    default: Any
    description: str
    choices: tuple[str, ...] = ()

    def check(self, value: Any) -> Any:
        """Return the value if it is one of the choices; a number of seconds, whole or not, as float.

        Raises:
            FtcmError: it is not; the message suggests one.
        """
        if self.choices and value not in self.choices:
            raise FtcmError(f"{self.name}: no {value!r}; {suggestion(str(value), self.choices)}")
        if isinstance(self.default, float):
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not (number and math.isfinite(value) and value >= 0):
                raise FtcmError(f"{self.name}: {value!r} is out of range; expected a number, at least 0")
            return float(value)
        return value


_COMMON = (
    Setting("scenario", "paper", "scenario file, or the name of a shipped scenario"),
    Setting(
        "plugins",
        "",
        "Python files or modules with components, separated by commas; loaded at start: this runs their code",
    ),
    Setting("autostart", True, "activate at start; false: wait for lifecycle transitions from outside"),
    Setting(
        "await_graph",
        False,
        "at activation, wait until every endpoint is matched with the suite's other nodes",
    ),
    Setting(
        "data_path",
        "listener",
        "how data messages are taken: by the middleware's receiving thread, by the main thread with a "
        "wait set, or by the ordinary executor",
        ("listener", "waitset", "executor"),
    ),
    Setting("priority", 0, "SCHED_FIFO priority of the process, 1 to 99; 0: ordinary scheduling"),
    Setting("lock_memory", False, "keep the process's memory from being paged out"),
    Setting("processors", "", "processors to run on, e.g. 0,1; empty: all"),
)

_TICK = (
    *_COMMON,
    Setting(
        "stages",
        "plain",
        "what does the node's part of a tick: plain Python, or machine code made of it at the start (numba)",
        ("plain", "compiled"),
    ),
)

_ACCOMMODATING = (
    *_TICK,
    Setting(
        "await_detection",
        False,
        "where the scenario has policies: wait in each tick for what the detector said of the one before, as "
        "lockstep needs; false: use what has come",
    ),
)

_STAMPS = Setting(
    "stamps",
    "run",
    "run: stamps of measurements are ticks of the run; free: they are of any clock, and ticks are counted",
    ("run", "free"),
)

_INTERFACE = (
    Setting("command_topic", "/effort_controller/commands", "topic of the Float64MultiArray"),
    Setting(
        "command_joints",
        "",
        "joints in the order of the numbers of the Float64MultiArray, separated by commas; empty: as in the "
        "robot",
    ),
)

SETTINGS: dict[str, tuple[Setting, ...]] = {
    "plant": (
        *_TICK,
        Setting(
            "mode",
            "real_time",
            "lockstep: wait for every tick's inputs; real_time: one tick per dt on the steady clock",
            ("lockstep", "real_time"),
        ),
        Setting("speed", 1.0, "real_time: seconds of the run in a second, e.g. 0.5: half as fast"),
        Setting(
            "recorder_window",
            0,
            "lockstep: ticks the plant may run ahead of the recorder; 0: it waits for none",
        ),
        Setting(
            "torque_timeout",
            100,
            "real_time: ticks without fresh torque after which the drives brake (safe stop); 0: never",
        ),
        Setting(
            "command_interface",
            "joint_state",
            "where the torque comes from: joint_state: joint_torques, tick by tick; float64_multi_array: the "
            "newest std_msgs/Float64MultiArray (real_time only), as a robot under ros2_control takes it; the "
            "plant then adds the scenario's disturbances and faults itself",
            ("joint_state", "float64_multi_array"),
        ),
        *_INTERFACE,
        Setting(
            "stamps",
            "run",
            "of joint_states: run: time of the tick; free: of the ROS clock at activation, and from there on "
            "by dt, with float64_multi_array only",
            ("run", "free"),
        ),
    ),
    "observer": (*_ACCOMMODATING, _STAMPS),
    "controller": (
        *_ACCOMMODATING,
        _STAMPS,
        Setting(
            "reference_topic",
            "",
            "topic with trajectory_msgs/JointTrajectory to follow in place of the scenario's reference; the "
            "robot is held where it is until the first one comes; empty: none",
        ),
        Setting(
            "command_interface",
            "joint_state",
            "where the torque goes: joint_state: joint_torques, to the suite's plant; float64_multi_array: "
            "besides, limited and watched, as std_msgs/Float64MultiArray to a robot; what follows in this "
            "table is for that",
            ("joint_state", "float64_multi_array"),
        ),
        *_INTERFACE,
        Setting("dry_run", False, "compute and report, but publish nothing on the command topic"),
        Setting(
            "measurement_timeout",
            0.1,
            "s without an answered measurement after which the controller stops for good; 0: never",
        ),
        Setting(
            "stop_command",
            "zero",
            "what is published last, once, when the controller stops: zero torque, the last torque again, or "
            "the model's gravity torque",
            ("zero", "hold", "gravity"),
        ),
        Setting(
            "start_ramp",
            2.0,
            "s over which the reference goes from the motion measured first to that of the scenario; 0: none",
        ),
        Setting(
            "stop_ramp",
            0.5,
            "s over which the torque goes to that of stop_command at deactivation; 0: none",
        ),
    ),
    "injector": _TICK,
    "detector": (*_TICK, _STAMPS),
    "recorder": (
        *_COMMON,
        Setting("bag", "", "folder of the bag to make, which must not exist; empty: ftcm-DATE-TIME"),
        Setting("storage", "mcap", "storage of the bag", ("mcap", "sqlite3")),
    ),
}
"""Parameters of each node."""


def setting(node: str, name: str) -> Setting:
    """Return one declared parameter of a node."""
    return next(s for s in SETTINGS[node] if s.name == name)
