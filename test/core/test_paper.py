# SPDX-License-Identifier: Apache-2.0
"""The paper's experiment in full: three 40 s runs, what of Table 2 reproduces, and what does not.

Our own numbers hold to 1e-3 across machines: sliding modes amplify the last bit, means do not.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ftcm_core.recording.metrics import result
from ftcm_core.recording.trace import Trace
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate

TABLE_2 = {
    "smc": (0.008021, 0.007490, 0.154244),
    "nftsmc": (0.019966, 0.005121, 0.004845),
    "ftcm": (0.002819, 0.002807, 0.002785),
}
OURS = {
    "smc": (0.008648, 0.007383, 0.010490),
    "nftsmc": (0.004876, 0.004795, 0.004982),
    "ftcm": (0.002608, 0.002609, 0.002604),
}
RATIOS = {
    "smc": ("1.08", "0.99", "0.068"),
    "nftsmc": ("0.24", "0.94", "1.03"),
    "ftcm": ("0.93", "0.93", "0.94"),
}
NOT_REPRODUCED = {("smc", 2), ("nftsmc", 0)}
LAWS = pytest.mark.parametrize("law", list(TABLE_2))


@pytest.fixture(scope="module")
def runs() -> dict[str, tuple[Trace, dict[str, Any]]]:
    """Trace and result of each law."""
    traces = {law: simulate(load("paper", controller=law)) for law in TABLE_2}
    return {law: (trace, result(trace)) for law, trace in traces.items()}


def agrees(value: float, text: str) -> bool:
    """Whether a number rounds to the one stated, give or take the 1e-3 that machines may differ by."""
    digits, _, exponent = text.partition("e")
    half_a_digit = 0.5 * 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))
    return abs(value - float(text)) <= half_a_digit + 1e-3 * abs(value)


def all_agree(values: Any, texts: list[str]) -> bool:
    """The same for one number per joint."""
    return all(agrees(float(value), text) for value, text in zip(values, texts))


def table_row(runs: dict[str, Any], law: str) -> list[float]:
    """Mean of |e| over the whole run, rad: the "average control error" of Table 2."""
    return list(runs[law][1]["metrics"]["whole"]["mean_abs_error"])


@LAWS
def test_runs_complete(runs: dict[str, Any], law: str) -> None:
    """40 s at 1 kHz, from the files' defaults alone."""
    trace, found = runs[law]
    assert (found["status"], found["controller"], found["observer"]) == ("completed", law, "do")
    assert trace.ticks == 40_001
    assert trace.time_ns[-1] == 40_000_000_000


@LAWS
def test_mean_errors(runs: dict[str, Any], law: str) -> None:
    """Our row of Table 2."""
    assert table_row(runs, law) == pytest.approx(OURS[law], rel=1e-3)


@LAWS
def test_table_2_as_far_as_it_reproduces(runs: dict[str, Any], law: str) -> None:
    """Seven of nine are within 8 %; SMC's E3 and NFTSMC's E1 are off by factors of 15 and 4."""
    for joint, (ours, paper, ratio) in enumerate(zip(table_row(runs, law), TABLE_2[law], RATIOS[law])):
        assert agrees(ours / paper, ratio)
        if (law, joint) in NOT_REPRODUCED:
            assert not 0.5 < ours / paper < 2.0
        else:
            assert abs(ours / paper - 1.0) < 0.08


def test_ranking_of_the_paper_holds(runs: dict[str, Any]) -> None:
    """The proposed law has the smallest mean error on every joint, as the paper says."""
    ftcm, nftsmc, smc = (np.array(table_row(runs, law)) for law in ("ftcm", "nftsmc", "smc"))
    assert (ftcm < nftsmc).all()
    assert (nftsmc < smc).all()


def test_table_2_is_all_transient_for_ftcm(runs: dict[str, Any]) -> None:
    """The first second makes up the whole of the mean."""
    error = np.abs(runs["ftcm"][0].error)
    assert (error[:1000].sum(axis=0) / error.sum(axis=0)).min() > 0.999


@pytest.mark.parametrize(
    ("law", "mean"),
    [
        ("ftcm", ["8.1e-8", "1.1e-7", "1.5e-7"]),
        ("nftsmc", ["1.1e-4", "2.4e-5", "2.8e-4"]),
        ("smc", ["2.6e-3", "5.2e-4", "5.0e-3"]),
    ],
)
def test_mean_error_after_the_fault(runs: dict[str, Any], law: str, mean: list[str]) -> None:
    """Over 10 to 40 s, rad."""
    assert all_agree(runs[law][1]["metrics"]["after_fault"]["mean_abs_error"], mean)


def test_peak_after_the_fault(runs: dict[str, Any]) -> None:
    """FTCM: 1.2e-4 rad, on joint 3."""
    peaks = runs["ftcm"][1]["metrics"]["after_fault"]["max_abs_error"]
    assert agrees(peaks[2], "1.2e-4")
    assert max(peaks) == peaks[2]


@pytest.mark.parametrize(
    ("law", "variation"),
    [("smc", (122343, 253542, 30366)), ("nftsmc", (107589, 222577, 28150)), ("ftcm", (951, 1798, 344))],
)
def test_torque_variation(runs: dict[str, Any], law: str, variation: tuple[float, ...]) -> None:
    """After 1 s, N·m/s: the chattering that the means hide; FTCM's is a hundredth of the others'."""
    found = runs[law][1]["metrics"]["after_transient"]["torque_total_variation"]
    assert found == pytest.approx(variation, rel=1e-3, abs=0.5)


def test_observer_error(runs: dict[str, Any]) -> None:
    """RMS of Δ - Δ̂ from 1 to 10 s under FTCM, rad/s²."""
    found = runs["ftcm"][1]["metrics"]["before_fault"]["observer_rms_error"]
    assert all_agree(found, ["3.5e-4", "1.8e-4", "2.0e-3"])


@pytest.mark.parametrize(
    ("law", "torque"),
    [
        ("ftcm", (92.634475422, 138.797617516, 34.269263113)),
        ("smc", (73.680662995, 102.837934950, 27.308423934)),
        ("nftsmc", (73.680662995, 102.837934950, 27.308423934)),
    ],
)
def test_first_torque(runs: dict[str, Any], law: str, torque: tuple[float, ...]) -> None:
    """u(0), N·m."""
    assert runs[law][1]["first_torque"] == pytest.approx(torque, abs=1e-9)


def test_lumped_uncertainty_is_within_the_switching_gain(runs: dict[str, Any]) -> None:
    """The largest |Δ| under FTCM, rad/s²: the 20.01 of SMC and NFTSMC is just enough."""
    largest = np.abs(runs["ftcm"][0].lumped_uncertainty).max(axis=0)
    assert all_agree(largest, ["11.9", "2.5", "19.4"])


@pytest.mark.parametrize(
    ("law", "joint_2"), [("ftcm", (0.0, 0.0)), ("smc", (0.06, 0.085)), ("nftsmc", (0.06, 0.085))]
)
def test_torque_within_the_robots_limits(
    runs: dict[str, Any], law: str, joint_2: tuple[float, float]
) -> None:
    """FTCM never reaches the robot's limits; the switching laws exceed joint 2's in 6 to 8 % of the ticks."""
    beyond = (np.abs(runs[law][0].command) >= (97.6, 186.4, 89.4)).mean(axis=0)
    assert joint_2[0] <= beyond[1] <= joint_2[1]
    if law == "ftcm":
        assert not beyond.any()
