# SPDX-License-Identifier: Apache-2.0
"""Disturbances and faults: eqs 4, 43 and 47 at points worked out by hand, and that they see the command."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from ftcm_core.disturbances import Disturbance
from ftcm_core.disturbances.vo_kang_friction import VoKangFriction
from ftcm_core.faults import AdditiveFault
from ftcm_core.faults.timing import NEVER
from ftcm_core.faults.vo_kang_fault import VoKangFault
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import load, replace
from ftcm_core.signals import TrueDisturbance, Vector
from ftcm_core.simulation import simulate
from ftcm_core.simulation.stages import InjectorStage

ZERO = (0.0, 0.0, 0.0)
PI = math.pi
PUMA = Puma560()


def torque(fault: AdditiveFault, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
    """What an additive fault without memory adds, N·m."""
    return fault.step(PUMA, t, q, v, u, fault.init(3, 0.0))[0]


@pytest.mark.parametrize(
    ("t", "q", "v", "torque"),
    [
        (2.0, (1.0, 2.0, -1.0), (9.0, 9.0, 9.0), (-1.2, -8.8, 1.3)),
        (2.0 + PI / 2, ZERO, (1.0, -1.0, 1.0), (-1.5, 1.3, -2.5)),
        (2.0 + PI / 2, (1.0, 2.0, -1.0), (1.0, 1.0, 3.0), (-2.7, -10.1, 3.8)),
        (0.0, ZERO, (PI / 4, 0.0, PI / 12), (1.5, 0.0, 1.25)),
    ],
)
def test_friction_and_disturbance(t: float, q: Vector, v: Vector, torque: Vector) -> None:
    """Eq 43 acts against the torque: -(a sin((t-2) v) + b q³)."""
    assert VoKangFriction().torque(t, q, v, (7.0, 7.0, 7.0)) == pytest.approx(torque, rel=1e-14, abs=1e-14)


def test_friction_takes_per_joint_and_single_gains() -> None:
    """Eq 43 with other amplitudes."""
    friction = VoKangFriction(a=0.0, b=[1, 2, 3])
    assert friction.torque(5.0, (1.0, 1.0, 2.0), (1.0, 1.0, 1.0), ZERO) == (-1.0, -2.0, -24.0)


@pytest.mark.parametrize(
    ("t", "q", "v", "u", "omega"),
    [
        # sin(q1 q2) = 1/2, cos(v1 q2) = 1/2, cos(v1 v2) = -1; sin(t) = 1; sin(q3 q1) = -1/2
        (4.5 * PI, (PI / 6, 1.0, -1.0), (PI / 3, 3.0, 0.0), (1.0, 10.0, 1.0),
         (12.5 + 0.75 - 2.5, 3.0, -7.5 + 1.2 * math.cos(3.0) + 2.5)),
        # cos(v1 ·) = 1; sin(t) = -1; sin(q3 q1) = 1, cos(v2 q2) = 1/2, cos(v2 v3) = -1
        (5.5 * PI, (PI / 2, 1 / 3, 1.0), (0.0, PI, 1.0), (0.0, 20.0, 0.0),
         (12.5 + 4.0, -6.0, 15.0 + 0.6 - 2.5)),
        (4.0 * PI, ZERO, ZERO, (50.0, 50.0, 50.0), (4.0, 0.0, 3.7)),
    ],
)  # fmt: skip
def test_fault_torque(t: float, q: Vector, v: Vector, u: Vector, omega: Vector) -> None:
    """Eq 47, abrupt at 10 s; on joint 2 it is a share of the command there."""
    assert torque(VoKangFault(), t, q, v, u) == pytest.approx(omega, rel=1e-13, abs=1e-13)


@pytest.mark.parametrize(
    ("t", "profile", "rate", "psi"),
    [
        (9.0, "abrupt", 1.0, 0.0),
        (10.0, "abrupt", 1.0, 0.0),
        (math.nextafter(10.0, 11.0), "abrupt", 1e-9, 1.0),
        (10.0, "incipient", 1e9, 0.0),
        (10.0 + math.log(2.0), "incipient", 1.0, 0.5),
        (10.0 + math.log(4.0) / 5.0, "incipient", 5.0, 0.75),
        (1e9, "incipient", 1e300, 1.0),
    ],
)
def test_time_profile(t: float, profile: str, rate: float, psi: float) -> None:
    """Eq 4: nothing at t = T_f itself; then 1, or 1 - e^(-ν(t-T_f))."""
    fault = VoKangFault(start=10.0, profile=profile, rate=rate)
    assert fault.size(t, 10.0, NEVER, 0.0) == pytest.approx(psi, rel=1e-14, abs=0.0)


def test_profile_and_severity_scale_the_whole_fault() -> None:
    """ψ times severity times eq 47."""
    state = (12.0, (0.3, -0.4, 0.7), (0.5, -0.6, 0.8), (10.0, 20.0, 30.0))
    whole = np.array(torque(VoKangFault(), *state))
    assert np.abs(whole).min() > 0.5
    part = torque(VoKangFault(profile="incipient", rate=math.log(2.0) / 2.0, severity=3.0), *state)
    assert part == pytest.approx(1.5 * whole, rel=1e-14)


def test_injector_adds_all_sources_for_the_command() -> None:
    """Limits and delay are the drive's: what the injector adds depends on the command as it is."""
    t_ns, q, v, u = 14_137_166_941, (0.3, -0.4, 0.7), (0.5, -0.6, 0.8), (1.0, 1000.0, 2.0)
    friction, faults = VoKangFriction(), (VoKangFault(), VoKangFault(severity=2.0))
    free = replace(load("paper"), disturbances=(friction,), faults=faults)
    limited = replace(free, torque_limits=50.0, torque_rate_limits=10.0, torque_delay=3)
    found = InjectorStage(free).step(t_ns, q, v, u)
    assert found == InjectorStage(limited).step(t_ns, q, v, u)
    assert isinstance(found, TrueDisturbance)
    t = t_ns / 1e9
    alone = [friction.torque(t, q, v, u), *(torque(fault, t, q, v, u) for fault in faults)]
    assert found.torque == pytest.approx(np.sum(alone, axis=0), rel=1e-14)
    less = InjectorStage(free).step(t_ns, q, v, (1.0, 50.0, 2.0))
    assert found.torque[1] - less.torque[1] == pytest.approx(
        3 * 0.3 * math.sin(t_ns / 1e9) * 950.0, rel=1e-13
    )
    assert (found.torque[0], found.torque[2]) == (less.torque[0], less.torque[2])
    quiet = InjectorStage(replace(free, disturbances=(), faults=()))
    assert quiet.step(t_ns, q, v, u) == TrueDisturbance(ZERO)


def test_injector_gives_every_source_its_own_stream_and_keeps_its_state() -> None:
    """State from step to step, the tick length (of all skipped ticks), a key of its own each."""
    seen: list[tuple[float, float, float]] = []

    @dataclass(frozen=True, kw_only=True)
    class Counting(Disturbance):
        """Counts: torque = number of the step."""

        def init(self, joints: int, key: float) -> Any:
            return key, 0.0

        def step(self, t: float, dt: float, q: Vector, v: Vector, u: Vector, state: Any) -> Any:
            key, n = state
            seen.append((key, n, dt))
            return (n,) * len(q), (key, n + 1.0)

    scenario = replace(load("paper"), disturbances=(Counting(), Counting()), faults=())
    stage = InjectorStage(scenario)
    torques = [stage.step(k * 1_000_000, ZERO, ZERO, ZERO, ticks).torque[0] for k, ticks in ((0, 1), (3, 3))]
    assert torques == [0.0, 2.0]
    assert [n for _, n, _ in seen] == [0.0, 0.0, 1.0, 1.0]
    assert [dt for _, _, dt in seen] == [1e-3, 1e-3, 3e-3, 3e-3]
    keys = [key for key, _, _ in seen]
    assert keys[:2] == keys[2:]
    assert keys[0] != keys[1]
    other = InjectorStage(replace(scenario, seed=1))
    assert [state[0] for state in other.state.disturbances] != keys[:2]


def test_fault_begins_the_tick_after_its_onset() -> None:
    """In a run: at t = T_f the disturbance is that of a run without fault, one tick later it is not."""
    overrides = ["duration=0.2", "injection.disturbances=[]"]
    trace = simulate(load("paper", [*overrides, "injection.faults.0.start=0.1"]))
    assert not trace.disturbance[:101].any()
    assert (np.abs(trace.disturbance[101]) > 0.5).all()
    healthy = simulate(load("paper", [*overrides, "injection.faults=[]"]))
    assert np.array_equal(trace.command[:102], healthy.command[:102])
    assert not np.array_equal(trace.command[102], healthy.command[102])
