# SPDX-License-Identifier: Apache-2.0
"""What ``ftcm doctor`` says of ROS, where it is there and where something of it is missing."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from ftcm_core.cli.doctor import MISSING, OK, WARNING, Finding
from ftcm_ros import doctor
from ftcm_ros.transport.topics import TOPICS

SETUP = Path(__file__).resolve().parents[2] / "src" / "ftcm_ros" / "setup.py"


def found(name: str) -> Finding:
    """What is said of one thing."""
    (finding,) = [finding for finding in doctor.examine() if finding.name == name]
    return finding


def test_what_is_needed_is_what_the_package_declares() -> None:
    (declared,) = re.findall(r"install_requires=\[(.*?)\]", SETUP.read_text("utf-8"), re.DOTALL)
    others = dict(re.findall(r'"(\w+)>=([\d.]+)', declared))
    del others["tqdm"]  # the core says it
    assert others == doctor.NEEDED


def test_every_package_of_messages_on_a_topic_is_tried() -> None:
    assert {topic.type.partition("/")[0] for topic in TOPICS} <= {*doctor.MESSAGES}


@pytest.mark.ros
def test_where_ros_is_there_it_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RMW_IMPLEMENTATION", raising=False)
    said = {finding.name: finding for finding in doctor.examine()}
    assert {name: said[name].status for name in ("ROS 2", "messages", "ftcm_ros")} == dict.fromkeys(
        ("ROS 2", "messages", "ftcm_ros"), OK
    )
    assert "rclpy" in said["ROS 2"].value
    assert "rmw_fastrtps_cpp" in said["middleware"].value
    assert not any(finding.needed for finding in said.values()), "a run in process needs no ROS"
    assert all(finding.advice for finding in said.values() if finding.status != OK)


def test_without_rclpy_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "importing", lambda modules: {"rclpy": "No module named 'rclpy'"})
    (finding,) = doctor.ros()
    assert finding.status == MISSING
    assert "No module named 'rclpy'" in finding.value
    assert "source /opt/ros/jazzy/setup.bash" in finding.advice


def test_messages_that_are_missing_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "importing", lambda modules: {"std_srvs.srv": "no", "sensor_msgs.msg": "no"})
    assert [f.status for f in doctor.ros()] == [OK, MISSING]
    assert doctor.ros()[1].value == "cannot be imported: sensor_msgs, std_srvs"


def test_which_world_ros_is_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "importing", lambda modules: {})
    monkeypatch.setattr(doctor, "version_of", lambda name: "7.1.6")
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    assert doctor.ros()[0].value == "jazzy from the package index, rclpy 7.1.6"
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    assert doctor.ros()[0] == Finding("ROS 2", OK, "sourced (jazzy), rclpy 7.1.6")
    monkeypatch.setenv("ROS_DISTRO", "kilted")
    assert doctor.ros()[0].status == WARNING


@pytest.mark.parametrize(
    ("wanted", "there", "status"),
    [
        ("", {"rmw_fastrtps_cpp"}, OK),
        ("", {"rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"}, OK),
        ("rmw_cyclonedds_cpp", {"rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"}, WARNING),
        ("rmw_cyclonedds_cpp", {"rmw_fastrtps_cpp"}, MISSING),
        ("", {"rmw_zenoh_cpp"}, WARNING),
        ("", set(), MISSING),
    ],
)
def test_the_middleware(monkeypatch: pytest.MonkeyPatch, wanted: str, there: set[str], status: str) -> None:
    monkeypatch.setenv("RMW_IMPLEMENTATION", wanted)
    monkeypatch.setattr(doctor, "middlewares", lambda: there)
    assert doctor.middleware().status == status


def test_whom_a_node_by_hand_reaches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    assert "ROS_DOMAIN_ID=42" in doctor.network().value
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET" in doctor.network().value
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE")
    assert "LOCALHOST (the nodes' default" in doctor.network().value


def test_the_command_line_of_ros_is_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    for where, reasons, status in (
        (None, {}, MISSING),
        ("/bin/ros2", {"ros2launch": "no"}, WARNING),
        ("/bin/ros2", {}, OK),
    ):
        monkeypatch.setattr(doctor.shutil, "which", lambda name, where=where: where)
        monkeypatch.setattr(doctor, "importing", lambda modules, reasons=reasons: reasons)
        assert doctor.command_line().status == status
