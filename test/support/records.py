# SPDX-License-Identifier: Apache-2.0
"""Records of runs for the replay: of a run in process, and of one whose plant gets its inputs late."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from ftcm_core.recording.trace import Trace
from ftcm_core.replay import Record
from ftcm_core.replay.plant import Held
from ftcm_core.replay.record import Message, channels_of
from ftcm_core.scenario import Scenario
from ftcm_core.signals import TrueDisturbance
from ftcm_core.simulation import Loop

Lag = Callable[[int], int]
"""How many ticks late the message of a tick comes to the plant."""


def record_of(trace: Trace) -> Record:
    """Every tick of a run in process; it ended in the plant, if early."""
    scenario = trace.scenario
    assert scenario is not None
    said = {
        channel.topic: list(
            zip(*(map(tuple, trace.columns[name].tolist()) for name in channel.columns if name))
        )
        for channel in scenario.channels
    }
    parts = frozenset(("plant", "observer", "controller", "injector", "detector"))
    compiled = parts if trace.engine == "compiled" else frozenset()
    return Record(scenario, said, trace.changes, status=trace.status, compiled=compiled)


def late_run(
    scenario: Scenario, command_lag: Lag, disturbance_lag: Lag, timeout: int = 100
) -> tuple[Record, Held]:
    """A run in which the plant moves with the newest command and disturbance it has, as the node does.

    Args:
        scenario: what to run.
        command_lag: of ``joint_torques`` to the plant.
        disturbance_lag: of ``disturbance``.
        timeout: ticks without a fresh command after which it brakes.

    Returns:
        What is recorded, and in how many ticks the plant moved with other inputs than those of the tick.
    """
    loop, last = Loop(scenario), scenario.last_tick
    said: dict[str, list[Message | None]] = {topic: [None] * (last + 1) for topic in channels_of(scenario)}
    zeros = (0.0,) * scenario.robot.joints
    newest = {"joint_torques": (-1, zeros), "disturbance": (-1, zeros)}
    under_way = []
    held, reveal, k = Held(), scenario.hidden, 0
    for k in range(last + 1):
        plant, time_ns = loop.plant, k * scenario.dt_ns
        if reveal:
            said["true_state"][k] = (*plant.motion, plant.joint_torque)
        y = plant.measure()
        row, u, d = loop.act(time_ns)
        n = len(zeros)
        signals = dict(zip(scenario.columns, (row[i : i + n] for i in range(0, len(row), n))))
        for channel in scenario.channels:
            if channel.writer != "plant":
                said[channel.topic][k] = tuple(signals[name] for name in channel.columns if name)
        said["joint_states"][k] = tuple(y)
        under_way += [
            (k + command_lag(k), "joint_torques", k, u), (k + disturbance_lag(k), "disturbance", k, d.torque)
        ]  # fmt: skip
        for _, topic, tick, value in (message for message in under_way if message[0] <= k):
            newest[topic] = max(newest[topic], (tick, value), key=lambda input_: input_[0])
        under_way = [message for message in under_way if message[0] > k]
        if k == last:
            break
        (u_tick, command), (d_tick, disturbance) = newest.values()
        braking = k - u_tick > timeout
        held.safe_stop += braking
        held.command += u_tick < k and not braking
        held.disturbance += d_tick < k
        held.ticks += u_tick < k or d_tick < k
        acting = TrueDisturbance(disturbance)
        if braking:
            plant.safe_stop(time_ns, acting)
        else:
            plant.step(time_ns, command, acting)
        reveal = scenario.hidden or d_tick < k
        if plant.reason:
            break
    status = loop.plant.status if loop.plant.reason else "completed"
    record = Record(scenario, {t: s[: k + 1] for t, s in said.items()}, lockstep=False, status=status)
    return record, held


def changed(record: Record, topic: str, tick: int, array: int, joint: int, by: float) -> Record:
    """The same record with one number changed."""
    message = record.said[topic][tick]
    assert message is not None
    vectors = [list(vector) for vector in message]
    vectors[array][joint] += by
    return said_otherwise(record, {(topic, tick): tuple(map(tuple, vectors))})


def said_otherwise(record: Record, messages: dict[tuple[str, int], Message | None]) -> Record:
    """The same record with other messages at some ticks of some topics; None: lost."""
    said = {topic: list(column) for topic, column in record.said.items()}
    for (topic, tick), message in messages.items():
        said[topic][tick] = message
    return dataclasses.replace(record, said=said)
