# SPDX-License-Identifier: Apache-2.0
"""Who may import whom: the core nothing of ROS, and what only handles messages no rclpy."""

import os
import subprocess
import sys

import pytest

IMPORT_ALL = """
import importlib, importlib.abc, pkgutil, sys

class Blocked(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top in {blocked!r} or ({messages!r} and top.endswith(("_msgs", "_interfaces"))):
            raise ModuleNotFoundError(f"{{name}} is blocked in this test", name=name)

sys.meta_path.insert(0, Blocked())
package = importlib.import_module({package!r})
for module in pkgutil.walk_packages(getattr(package, "__path__", []), {package!r} + "."):
    importlib.import_module(module.name)
"""


def import_all(root, package, blocked, messages):
    """Import a source package, all of it, in a process of its own where some modules are missing."""
    code = IMPORT_ALL.format(package=package, blocked=blocked, messages=messages)
    sources = [str(root / "src" / "ftcm_core"), str(root / "src" / "ftcm_ros")]
    path = os.pathsep.join([*sources, os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_core_imports_nothing_of_ros(root):
    blocked = {"rclpy", "rosbags", "ament_index_python", "launch", "ros2cli", "ftcm_ros"}
    done = import_all(root, "ftcm_core", blocked, messages=True)
    assert done.returncode == 0, done.stderr


def test_core_works_without_its_extras(root):
    done = import_all(root, "ftcm_core", {"matplotlib", "numba"}, messages=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.ros
@pytest.mark.parametrize(
    "module", ["bags", "parameters.node_parameters", "timing", "transport.aligner", "transport.codec"]
)
def test_what_only_handles_messages_imports_without_rclpy(root, module):
    done = import_all(root, f"ftcm_ros.{module}", {"rclpy"}, messages=False)
    assert done.returncode == 0, done.stderr


def test_a_blocked_import_would_be_noticed(root):
    done = import_all(root, "ftcm_core", {"yaml", "numpy", "math", "dataclasses"}, messages=False)
    assert done.returncode != 0
    assert "is blocked in this test" in done.stderr
