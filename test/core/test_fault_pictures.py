# SPDX-License-Identifier: Apache-2.0
"""Pictures of faults: of the very class, at its site; small files; the page is that of the registry."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import faults_page as tool
from ftcm_core.cli import main
from ftcm_core.errors import FtcmError
from ftcm_core.faults import Fault, RobotFault
from ftcm_core.faults.loss_of_effectiveness import LossOfEffectiveness
from ftcm_core.faults.payload_pickup import PayloadPickup
from ftcm_core.faults.sensor_drift import SensorDrift
from ftcm_core.faults.vo_kang_fault import VoKangFault
from ftcm_core.registry import components
from ftcm_core.report.fault_pictures import Panel, Shown, shown_of, thinned, write_picture
from ftcm_core.robots import Robot

pytest.importorskip("matplotlib")
DOCS = Path(__file__).resolve().parents[2] / "docs"
LARGEST = 30_000
"""Of a picture on the page, bytes."""


def shown(name: str, **given: Any) -> Shown:
    """What a fault does, by its name."""
    fault: Any = components("fault")[name](**given)
    return shown_of(fault)


def curves(panel: Panel) -> list[np.ndarray]:
    """Values of a panel's curves."""
    return [x for _, x, _ in panel.curves]


@pytest.mark.parametrize("name", components("fault"))
def test_every_fault_shows_after_its_onset_and_not_before(name: str) -> None:
    """In the last row: a difference, an added torque, or a change of the motion."""
    found = shown(name)
    after = found.time > found.onset
    assert found.onset == 10.0
    assert np.array_equal(found.size > 0.0, after) or components("fault")[name].site == "dynamics"
    values = np.array([x for panel in found.rows[-1] for x in curves(panel)])
    assert not values[:, ~after].any()
    assert values[:, after].any()
    assert all(len(row) == len(found.rows[0]) for row in found.rows)


def test_an_actuator_of_the_joint_that_breaks() -> None:
    """Torque of the drive and on the joint, 70 % of it."""
    for joint in (0, 1, 3):
        found = shown_of(LossOfEffectiveness(loss=0.3, joint=joint))
        ((both,), (difference,)) = found.rows
        drive, on_joint = curves(both)
        share = np.where(found.time > 10.0, 0.7, 1.0)
        assert on_joint == pytest.approx(share * drive)
        assert np.array_equal(curves(difference)[0], on_joint - drive)
        assert np.abs(drive).max() > 50.0


def test_a_sensor_by_what_it_is_that_changes() -> None:
    """A bias is in the position alone; a drift in both. Sizes are those of the profile."""
    (bias,), _ = shown("sensor_bias").rows
    assert bias.title.startswith("position")
    found = shown_of(SensorDrift(drift=0.1, profile="ramp", rise=0.5, severity=2.0))
    assert len(found.rows[0]) == 2
    since = np.maximum(found.time - 10.0, 0.0)
    size = 2.0 * np.minimum(since / 0.5, 1.0)
    assert found.size == pytest.approx(size)
    assert curves(found.rows[1][0])[0] == pytest.approx(size * 0.1 * since)


def test_messages_by_number() -> None:
    """Sent and received; a delay is a difference in ticks."""
    found = shown("delayed_messages", delay=3)
    ((both,), (late,)) = found.rows
    assert found.stepped
    assert np.diff(curves(both)[0]) == pytest.approx(1.0)
    assert set(curves(late)[0][found.time > 10.0]) == {-3.0}


def test_a_torque_in_the_paper_s_run_and_a_robot_against_the_one_without_fault() -> None:
    """The added torque alone; what the payload changes, which the weight explains."""
    added = shown_of(VoKangFault(start=0.2, severity=2.0))
    half = shown_of(VoKangFault(start=0.2))
    first = int(np.argmax(added.time > 0.2))
    for one, other in zip(curves(added.rows[0][0]), curves(half.rows[0][0])):
        assert one[first] == pytest.approx(2.0 * other[first])
        assert other[first] != 0.0
    found = shown_of(PayloadPickup(start=0.2, mass=2.0))
    estimate = curves(found.rows[0][0])
    assert np.abs(estimate[1][-1]) > 5.0 * np.abs(estimate[0][-1])


def test_the_size_is_that_of_the_run() -> None:
    """Also where it is drawn at random: no torque where it is 0. The onset need not be a tick."""
    found = shown_of(VoKangFault(start=0.20025, profile="intermittent", period=0.05))
    torque = np.array(curves(found.rows[0][0])).any(axis=0)
    assert np.array_equal(found.size > 0.0, torque)
    assert 0.2 < torque.mean() < 0.6


def test_a_run_that_ends_early_is_shown_up_to_there() -> None:
    """And it is said."""
    found = shown_of(VoKangFault(start=0.2, severity=1e6))
    assert found.rows[0][0].title == "added torque, N·m (diverged)"
    assert len(found.time) == len(found.size) == len(curves(found.rows[0][0])[0])
    assert found.time[-1] < 1.0


def test_a_fault_that_needs_a_payload_gets_one() -> None:
    """What can only be dropped is there before."""

    class Drop(RobotFault):
        """Drops the payload: payload mass = 0."""

        type_name = "drop"

        def changed(self, robot: Robot) -> Robot:
            """Without payload."""
            return robot.unloaded()

    (estimate,), _ = shown_of(Drop(start=0.2)).rows
    assert np.abs(curves(estimate)[1][-1]) > 1.0


@pytest.mark.parametrize("trigger", ["condition", "hand"])
def test_faults_that_time_does_not_trigger(trigger: str) -> None:
    """By hand: in the middle of the picture; by a condition: when the test motion meets it."""
    found = shown(
        "sensor_bias", trigger=trigger, trigger_above=0.4, start=2.0, lifetime="timed", duration=0.2
    )
    (both,), (difference,) = found.rows
    true, _ = curves(both)
    acts = curves(difference)[0] != 0.0
    assert acts.sum() == pytest.approx(200, abs=1)
    if trigger == "hand":
        assert found.onset == 2.0
    else:
        assert true[int(np.argmax(acts)) - 1] == pytest.approx(0.4, abs=4e-3)


def test_a_short_pulse_is_shown_at_its_own_scale() -> None:
    """A pulse of 20 ms is a fourth of the picture."""
    found = shown_of(VoKangFault(start=0.2, profile="one_shot", period=0.02))
    assert found.time[-1] - found.time[0] == pytest.approx(4 * 0.02, abs=3e-3)


@settings(deadline=None)
@given(
    count=st.integers(2, 2000),
    seed=st.integers(0, 99),
    bins=st.integers(1, 50),
    onset=st.floats(-1.0, 2001.0),
)
def test_a_thinned_curve_keeps_its_extremes(count: int, seed: int, bins: int, onset: float) -> None:
    """Points are those of the curve, in order; smallest, largest, first and last are there, and few more."""
    time, x = np.arange(count, dtype=float), np.random.default_rng(seed).normal(size=count)
    t, found = thinned(time, x, onset, bins)
    assert (np.diff(t) > 0.0).all()
    assert np.array_equal(found, x[t.astype(int)])
    assert {x.min(), x.max(), x[0], x[-1]} <= set(found)
    assert len(t) <= 2 * bins + 4


@pytest.mark.parametrize("suffix", ["svg", "png", "pdf"])
def test_a_picture_is_what_its_suffix_says(suffix: str, tmp_path: Path) -> None:
    """An SVG can be read, is small, has every curve and no date."""
    file = tmp_path / f"a.{suffix}"
    write_picture(LossOfEffectiveness(), file)
    found = file.read_bytes()
    assert found.startswith({"svg": b"<?xml", "png": b"\x89PNG", "pdf": b"%PDF"}[suffix])
    if suffix == "svg":
        assert len(found) < LARGEST
        assert b"date" not in found
        root = ElementTree.fromstring(found)
        paths = [x.get("d", "") for x in root.iter("{http://www.w3.org/2000/svg}path")]
        assert len([d for d in paths if len(d) > 500]) == 3, "drive, joint, difference"
        assert "of the drive" in [x.text for x in root.iter("{http://www.w3.org/2000/svg}text")]


# The command.


def describe(*arguments: str) -> int:
    """Run ``ftcm describe``."""
    return main(["describe", *arguments])


def test_the_command_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Beside the description; other values make another picture."""
    one, other = tmp_path / "a.svg", tmp_path / "b.svg"
    assert describe("sensor_gain", "--picture", str(one)) == 0
    assert describe("sensor_gain", "--picture", str(other), "--set", "gain=[0.2, 0, 0]", "profile=ramp") == 0
    out = capsys.readouterr()
    assert out.out.count("fault sensor_gain\n") == 2
    assert out.err == f"ftcm: picture: {one}\nftcm: picture: {other}\n"
    assert one.read_bytes() != other.read_bytes()


PICTURE = "sensor_gain --picture x.svg --set "


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("ftcm --picture x.svg", "--picture: controller 'ftcm' is no fault; "),
        ("sensor_gain --picture x.jpg", "picture 'x.jpg': expected a name that ends with .svg, .png, .pdf"),
        ("sensor_gain --set gain=1", "--set: a description has no values to set; expected with --picture"),
        (PICTURE + "gian=1", "--set 'gian': unknown parameter; did you mean 'gain'?"),
        (PICTURE + "gain", "--set 'gain': expected parameter=value"),
        (PICTURE + "gain=much", "--set gain: 'much' is not a number"),
        (PICTURE + "gain=[1,2]", "gain: [1.0, 2.0] has 2 entries; expected one"),
        (PICTURE + "joint=4", "joint: 4 is out of range; expected 0 (all) to 3"),
        ("vo_kang_fault --picture x.svg --set start=101", "start: 101 s is too late for a picture"),
    ],
)
def test_a_mistake_is_one_line(
    arguments: str,
    expected: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Exit status 2, and no file."""
    monkeypatch.chdir(tmp_path)
    assert describe(*arguments.split()) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"ftcm: error: {expected}")
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_site_that_nothing_is_known_of_is_said() -> None:
    """One line."""

    class Strange(Fault):
        """Of no site."""

        type_name = "strange"

    with pytest.raises(FtcmError, match=r"^fault 'strange' is of no site that can be drawn$"):
        shown_of(Strange())


# The page.


def test_the_page_is_up_to_date(monkeypatch: pytest.MonkeyPatch) -> None:
    """``--check`` passes on the page in the repository; every fault is on it, by its site."""
    monkeypatch.setattr(sys, "argv", ["faults_page.py", "--check", str(DOCS)])
    assert tool.main() == 0
    headings = re.findall(r"^###? (.*)$", (DOCS / tool.FILE).read_text("utf-8"), re.MULTILINE)
    for name, cls in components("fault").items():
        before = headings[: headings.index(f"`{name}`")]
        site = [h for h in before if not h.startswith("`")][-1].lower()
        assert site in (cls.site, f"{cls.site}s")


def test_every_fault_has_its_picture_on_the_page_and_no_other_has() -> None:
    """Small ones: SVG without fonts."""
    files = {file.name: file for file in (DOCS / tool.PICTURES).iterdir()}
    assert set(files) == {f"{name}.svg" for name in [*components("fault"), "profiles"]}
    for file in files.values():
        assert file.stat().st_size < LARGEST, file.name
        assert "@font-face" not in file.read_text("utf-8")
