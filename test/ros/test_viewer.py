# SPDX-License-Identifier: Apache-2.0
"""``ftcm watch --web``: the arm, the history, the texts; a run in a browser; what the buttons do."""

from __future__ import annotations

import argparse
import math
import re
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import psutil
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from rclpy.node import Node

from browser import DESKTOP, PHONE, missing, opened
from ftcm_core.cli.watching import HOST, PORT, check_watch
from ftcm_core.errors import FtcmError
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.robots.serial_chain import Frame
from ftcm_core.robots.urdf import Urdf
from ftcm_core.robots.urdf_file import turned
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.parameters.node_parameters import ALL_NODES
from ftcm_ros.run.view import Sample, Values, View
from ftcm_ros.transport.topics import JOINT_STATES, REFERENCE, TRUE_STATE
from ftcm_ros.viewer import serving, tables
from ftcm_ros.viewer.arm import Mesh, drawing, drum_mesh, quaternion, rods_mesh, seen_from
from ftcm_ros.viewer.history import ROWS, History
from ftcm_ros.viewer.operating import PAUSE, Operator, fault_order, pause_order, swap_order
from ftcm_ros.viewer.page import ALL, Page
from plugins import ROBOTS
from traces import same
from urdf_arms import arm_text

pytestmark = pytest.mark.ros

HANG_SECONDS = 120.0
"""Generous ceiling that catches hangs."""
FAULTS = "injection.faults=[{type: external_torque, trigger: hand, joint: 3}]"
LABEL = "external_torque_0"


def need_browser() -> None:
    """Skip the test where there is nothing to show the page with."""
    pytest.importorskip("viser", reason="viser is not installed: pip install 'ftcm_core[web]'")
    if missing():
        pytest.skip(missing())


def free_port() -> int:
    """A port that nobody uses."""
    with socket.socket() as trial:
        trial.bind((HOST, 0))
        return int(trial.getsockname()[1])


# The arm.


def volume(mesh: Mesh) -> float:
    """What a closed mesh holds: negative if its faces look inwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


ARMS = {
    "puma560": lambda folder: Puma560(),
    "its file": lambda folder: Urdf(tip="tip"),
    "any arm": lambda folder: Urdf(file=str(folder / "arm.urdf")),
}


@pytest.mark.parametrize("name", ARMS)
def test_each_link_reaches_from_its_joint_to_the_next(name: str, tmp_path: Path) -> None:
    text = arm_text(["revolute", "prismatic", "fixed", "revolute", "continuous"], 3)
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    robot = ARMS[name](tmp_path)
    frames = robot.forward_kinematics((0.0,) * robot.joints)
    base, *bodies = drawing(robot).bodies
    assert len(bodies) == robot.joints
    for body, frame, after in zip(bodies, frames, frames[1:]):
        for end in ((0.0, 0.0, 0.0), seen_from(frame, after.origin)):
            near = np.linalg.norm(rods_mesh(body.rods).vertices - end, axis=1).min()
            assert near <= body.rods[0].radius * (1.0 + 1e-12), "an end is a radius away from the surface"
    for body in (base, *bodies):
        for mesh in (rods_mesh(body.rods), drum_mesh(body.drum)):
            assert volume(mesh) > 0.0
            assert mesh.faces.max() == len(mesh.vertices) - 1


def test_a_joint_is_a_drum_about_its_axis() -> None:
    drum = drawing(Puma560()).bodies[1].drum
    mesh = drum_mesh(drum)
    assert np.abs(mesh.vertices).max(axis=0) == pytest.approx([drum.radius, drum.radius, drum.half])
    whole = math.pi * drum.radius**2 * 2.0 * drum.half
    assert 0.9 * whole < volume(mesh) < whole, "its edges are broken, and it has corners"


def test_a_robot_that_does_not_say_where_its_joints_are_is_not_drawn() -> None:
    assert drawing(ROBOTS["pendulum"]) is None


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("angle", [0.0, 1.0, math.pi, -2.0])
def test_a_quaternion_turns_as_its_frame(axis: int, angle: float) -> None:
    rotation = turned(axis, angle)
    columns = [tuple(row[k] for row in rotation) for k in range(3)]
    w, *vector = quaternion(Frame((0.0, 0.0, 0.0), *columns))
    assert w >= 0.0
    for unit, column in zip(np.eye(3), columns):
        twice = 2.0 * np.cross(vector, unit)
        assert unit + w * twice + np.cross(vector, twice) == pytest.approx(column, abs=1e-12)


# What is kept and said.


def some(x: float) -> Values:
    """Values of a joint, all of them different."""
    return Values(*(x + k for k in range(len(Values._fields))))


def test_the_newest_rows_are_kept_and_those_of_another_run_are_not() -> None:
    history = History(2)
    for k in range(ROWS + 5):
        history.add(float(k), [some(k), some(-k)], [False, k > 10])
        history.add(float(k), [some(0.0), some(0.0)], [False, False])  # nothing new
    table = history.table()
    assert table.time.tolist() == [float(k) for k in range(5, ROWS + 5)]
    assert table.column("error", 0).tolist() == table.time.tolist()
    assert table.column("estimate", 1).tolist() == [4.0 - k for k in range(5, ROWS + 5)]
    assert table.column("alarm", 1).sum() == ROWS - 6
    history.add(1.0, [some(7.0), some(7.0)], [False, False])
    assert history.table().time.tolist() == [1.0]
    assert History(2).table().time.tolist() == []


def test_the_true_motion_is_drawn_where_a_sensor_hides_it() -> None:
    view = View()

    def hear(topic: Any, tick: int, q: float) -> None:
        view.hear_sample(topic.name, tick, Sample(("j",), (q,), (), ()))

    assert view.positions(JOINT_STATES) is None
    hear(JOINT_STATES, 100, 1.0)
    assert view.positions(TRUE_STATE, JOINT_STATES) == (1.0,)
    hear(TRUE_STATE, 100, 2.0)
    assert view.positions(TRUE_STATE, JOINT_STATES) == (2.0,)
    for tick in range(101, 200):
        hear(JOINT_STATES, tick, 3.0)
    assert view.positions(TRUE_STATE, JOINT_STATES) == (3.0,), "it has not been told since"
    hear(REFERENCE, 100, math.nan)
    assert view.positions(REFERENCE) is None


def test_which_joints_a_fault_acts_on() -> None:
    view = View()
    view.hear_sample(JOINT_STATES.name, 5 * 10**9, Sample(("a", "b", "c"), (), (), ()))
    view.hear_fault("payload_0", 1.0, 9.0)
    view.hear_fault("later_0", 6.0, 9.0, 1)
    assert view.faulty() == set()
    view.hear_fault("one_0", 1.0, 9.0, 2)
    assert view.faulty() == {"b"}
    view.hear_fault("all_0", 1.0, 9.0, 0)
    assert view.faulty() == {"a", "b", "c"}


def test_what_was_heard_is_no_markup() -> None:
    evil = "<script>alert(1)</script>"
    view = View()
    view.hear_health("plant", 1, evil, {"process": "1", "state": evil, "tick": evil, "last_tick": evil}, 0.0)
    view.hear_component(evil, evil)
    view.hear_fault(evil, 0.0, 1.0)
    view.hear_scenario(f"name: {evil}")
    view.hear_sample(JOINT_STATES.name, 5 * 10**8, Sample((evil,), (0.0,), (), (1.0,)))
    texts = (
        tables.run(view, evil), tables.nodes(view, 0.0), tables.faults(view), tables.joints(view),
        tables.answers([(evil, True)]), tables.note(evil),
    )  # fmt: skip
    for text in texts:
        assert "&lt;script&gt;" in text
        assert evil not in text


def page_of(view: View) -> tuple[Page, MagicMock]:
    """A page with somebody who looks at it, and viser's server, of which nothing is there."""
    server = MagicMock()
    server.gui.add_html.side_effect = lambda content: MagicMock(content=content)
    server.gui.add_dropdown.return_value.value = ALL
    camera = MagicMock(image_width=900, image_height=800)
    server.get_clients.return_value = {0: MagicMock(camera=camera)}
    return Page(server, view, "ROS_DOMAIN_ID=7"), server


def hear_run(view: View, ticks: range) -> None:
    """The begin of a run."""
    names = Puma560.joint_names
    view.hear_scenario(load("paper").to_yaml())
    for tick in ticks:
        for topic in (JOINT_STATES, REFERENCE):
            view.hear_sample(topic.name, tick * 10**6, Sample(names, (0.1, 0.2, 0.3), (), (1.0, 2.0, 3.0)))


def test_a_page_goes_on_with_the_next_run() -> None:
    view = View()
    page, server = page_of(view)
    page.show(0.0)
    for now, ticks in ((1.0, range(5)), (2.0, range(5, 10))):
        hear_run(view, ticks)
        page.show(now)
    assert server.gui.add_uplot.call_count == 2, "errors and torques; nobody tells of disturbances"
    (time_, *errors), _ = server.gui.add_uplot.call_args_list[0][0]
    assert (time_.tolist(), len(errors)) == ([0.004, 0.009], 3)
    meshes = server.scene.add_mesh_simple.call_count
    view.forget()
    page.show(3.0)
    assert server.scene.add_mesh_simple.call_count == meshes
    hear_run(view, range(3))
    page.show(4.0)
    assert server.scene.add_mesh_simple.call_count == 2 * meshes
    assert page._history.table().time.tolist() == [0.002]


def test_where_the_arm_cannot_be_drawn_the_page_says_why() -> None:
    view = View()
    page, server = page_of(view)
    hear_run(view, range(3))
    view.scenario["robot"] = {"type": "no_such_robot"}
    page.show(0.0)
    assert "No arm, no controls: " in page._note.content
    assert "no_such_robot" in page._note.content
    assert server.scene.add_mesh_simple.call_count == 0


@pytest.mark.parametrize(
    ("largest", "factor", "unit"),
    [(0.5, 1.0, "rad"), (2e-3, 1e3, "mrad"), (3e-7, 1e6, "µrad"), (0.0, 1e9, "nrad")],
)
def test_small_errors_have_a_small_unit(largest: float, factor: float, unit: str) -> None:
    view = View()
    page, server = page_of(view)
    hear_run(view, range(1))
    page.show(0.0)
    for k in range(3):
        page._history.add(k + 1.0, [Values(*[largest * (k == 1)] * 6)] * 3, [False] * 3)
    page._plots.show(page._history.table())
    ((_, error, *_), _), said = server.gui.add_uplot.call_args_list[0]
    assert error.max() == pytest.approx(factor * largest)
    assert said["title"] == f"tracking error, {unit}"


# What is refused.


def asked(**given: Any) -> argparse.Namespace:
    """Options of ``watch``."""
    plain = {"web": False, "control": False, "host": None, "port": None, "once": False, "health": False}
    return argparse.Namespace(**plain | given)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"control": True}, "--control is for a browser; expected --web beside it"),
        ({"host": "0.0.0.0"}, "--host is for a browser"),
        ({"port": 80}, "--port is for a browser"),
        ({"web": True, "once": True}, "--web and --once"),
        ({"web": True, "health": True}, "--web and --health"),
        ({"web": True, "port": 0}, "--port 0; expected 1 to 65535"),
    ],
)
def test_options_that_do_not_fit(given: dict[str, Any], said: str) -> None:
    with pytest.raises(FtcmError, match=re.escape(said)):
        check_watch(asked(**given))


def test_only_this_machine_reaches_it_unless_told() -> None:
    options = asked(web=True)
    check_watch(options)
    assert (options.host, options.port) == ("127.0.0.1", PORT)


def test_without_viser_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(FtcmError, match=r'--web needs viser; pip install "ftcm_core\[web\]"'):
        serving.open_server(HOST, free_port())


@pytest.mark.parametrize("host", [HOST, "192.0.2.1", "no such host"])
def test_an_address_that_is_not_to_be_had_is_one_line(monkeypatch: pytest.MonkeyPatch, host: str) -> None:
    monkeypatch.setattr(serving.importlib.util, "find_spec", lambda name: True)
    with socket.socket() as taken:
        taken.bind((HOST, 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(FtcmError, match=f"cannot serve at {host}:{port}: .*choose another") as told:
            serving.open_server(host, port)
    assert len(str(told.value).splitlines()) == 1


def test_pages_from_elsewhere_are_turned_away() -> None:
    pytest.importorskip("viser", reason="viser is not installed: pip install 'ftcm_core[web]'")
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    port = free_port()
    server = serving.open_server(HOST, port)
    try:
        for origin in (None, f"http://127.0.0.1:{port}", "http://localhost:1234"):
            connect(f"ws://{HOST}:{port}", origin=origin).close()
        for origin in ("https://example.org", "http://localhost.example.org", "null"):
            with pytest.raises(InvalidStatus, match="403"):
                connect(f"ws://{HOST}:{port}", origin=origin)
        assert server.request_share_url() is None, "there is no way out by viser's tunnel"
        with pytest.raises(FtcmError, match="in use"):
            serving.open_server(HOST, port)
    finally:
        server.stop()


# Of a run that is on.


@pytest.fixture
def operator(watcher: Any) -> Iterator[Operator]:
    """One in the watcher's domain."""
    node = Node("watch_control", context=watcher.context)
    made = Operator(node)
    yield made
    made.close()
    node.destroy_node()


@pytest.mark.slow
def test_what_the_buttons_do(live: Callable[..., Any], operator: Operator) -> None:
    run = live("paper", "--controllers", "smc", "--set", "duration=600", "--set", FAULTS)
    run.first_tick(("controller", "smc"), ("observer", "do"))

    def done(order: Any) -> tuple[str, bool]:
        operator.answers.clear()
        operator.ask(order)
        run.watcher.spin_until(lambda: operator.answers, order.text)
        return operator.answers[-1]

    assert done(fault_order("arm", LABEL)) == (
        f"arm {LABEL}: ordered; /faults tells from which tick on",
        True,
    )
    assert done(swap_order("controller", "ftcm")) == ("controller ftcm: done", True)
    run.until(lambda: ("controller", "ftcm") in run.announced, "another controller in force")
    text, taken = done(swap_order("controller", "no_such_law"))
    assert not taken
    assert "no_such_law" in text
    run.until(lambda: operator.offered(PAUSE), "a plant that can wait")
    for order, said in ((pause_order(True), "paused"), (pause_order(False), "goes on")):
        text, taken = done(order)
        assert taken
        assert re.fullmatch(rf"tick \d+: {said}", text)
    run.interrupt()


def test_without_a_run_it_is_said(operator: Operator, monkeypatch: pytest.MonkeyPatch, watcher: Any) -> None:
    monkeypatch.setattr("ftcm_ros.viewer.operating.WAIT_SECONDS", 0.2)
    assert not operator.offered(PAUSE)
    operator.ask(pause_order(True))
    watcher.spin_until(lambda: operator.answers, "an answer")
    assert tuple(operator.answers) == ((f"pause: no answer of {PAUSE}; is the run on?", False),)


UPLOTS = "Object.values((window.__viserTestpoints || {}).uplots || {})"
"""Of viser's page, the curves that are drawn."""


def chromiums() -> list[psutil.Process]:
    """The processes of the browser that this test has started."""
    return [one for one in psutil.Process().children(recursive=True) if "chrom" in one.name()]


@pytest.mark.nightly
@pytest.mark.slow
def test_a_browser_shows_a_run_that_is_on(live: Callable[..., Any], start: Callable[..., Any]) -> None:
    need_browser()
    port = free_port()
    viewer = start("run.watch", "--web", "--control", "--port", str(port))
    assert viewer.stdout
    assert f"http://127.0.0.1:{port}" in viewer.stdout.readline()
    changes = ("duration=600", "detector=residual_threshold", FAULTS)
    run = live("paper", "--controllers", "ftcm", *(word for x in changes for word in ("--set", x)))
    run.first_tick(("controller", "ftcm"), ("observer", "do"), ("detector", "residual_threshold"))
    asked: list[str] = []
    errors: list[str] = []
    with opened(f"http://127.0.0.1:{port}", DESKTOP) as page:
        page.on("request", lambda request: asked.append(request.url))
        page.on("websocket", lambda socket: asked.append(socket.url))
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.reload()
        moved = "parseFloat(document.body.innerText.match(/t = ([0-9.]+) s/)[1])"
        page.wait_for_function(f"{UPLOTS}.length === 4 && {UPLOTS}.every(u => u.chart.data[0].length > 20)")
        text = page.inner_text("body")
        for said in (*ALL_NODES, "joint1", "joint3", "ftcm", f"{LABEL} waits"):
            assert said in text
        page.wait_for_function(f"{moved} > {page.evaluate(moved)}")
        page.get_by_text("arm", exact=True).click()
        page.wait_for_function(f"document.body.innerText.includes('{LABEL} ACTS')")
    assert errors == []
    ours = (f"http://127.0.0.1:{port}", f"ws://127.0.0.1:{port}", "data:", "blob:")
    assert [address for address in asked if not address.startswith(ours)] == [], "it asks nobody else"
    with opened(f"http://127.0.0.1:{port}", PHONE) as page:
        page.wait_for_function(f"document.body.innerText.includes('{LABEL} ACTS')")
        run.interrupt()
        page.wait_for_function("document.body.innerText.includes('silent')")
    viewer.send_signal(signal.SIGINT)
    _, err = viewer.communicate(timeout=HANG_SECONDS)
    assert (viewer.returncode, err) == (0, "")


@pytest.mark.nightly
@pytest.mark.slow
def test_a_browser_that_hangs_changes_nothing(
    live: Callable[..., Any], start: Callable[..., Any], tmp_path: Path
) -> None:
    need_browser()
    port, changes = free_port(), ["duration=8", "sensor={type: encoder}"]
    viewer = start("run.watch", "--web", "--port", str(port))
    assert viewer.stdout
    assert viewer.stdout.readline()
    run = live("paper", "--controllers", "smc", *(word for change in changes for word in ("--set", change)))
    with opened(f"http://127.0.0.1:{port}", DESKTOP) as page:
        page.wait_for_function("/t = [0-9.]+ s/.test(document.body.innerText)")
        hung = chromiums()
        assert hung
        for process in hung:
            process.suspend()
        run.end()
        for process in hung:
            process.resume()
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "smc")
    assert (bag.missing, bag.damage) == ({}, "")
    assert same(bag.trace, simulate(load("paper", changes, controller="smc")))
