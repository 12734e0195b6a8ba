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
    if not module.name.endswith(".__main__"):  # which runs the command
        importlib.import_module(module.name)
print(*sorted(name for name in sys.modules if name.partition(".")[0] == {package!r}.partition(".")[0]))
"""


def import_all(root, package, blocked, messages):
    """Import a source package, all of it, in a process of its own where some modules are missing.

    What it prints are the names of its modules.
    """
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
    folder = root / "src" / "ftcm_core"
    files = {p.relative_to(folder).with_suffix("") for p in (folder / "ftcm_core").rglob("*.py")}
    names = {".".join(p.parts).removesuffix(".__init__") for p in files}
    assert set(done.stdout.split()) == names - {"ftcm_core.cli.__main__"}, "every module was tried"


def test_core_works_without_its_extras(root):
    extras = {"matplotlib", "numba", "scipy", "pyarrow", "optuna", "distributed"}
    done = import_all(root, "ftcm_core", extras, messages=False)
    assert done.returncode == 0, done.stderr


SIMULATE = """
import sys
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
simulate(load("paper", ["duration=0.01"]))
print(*sorted({name.partition(".")[0] for name in sys.modules}))
"""


def test_a_run_in_process_loads_neither_ros_nor_extras(root):
    path = os.pathsep.join([str(root / "src" / "ftcm_core"), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", SIMULATE],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not {"rclpy", "rosbags", "ftcm_ros", "numba", "matplotlib", "scipy"} & set(done.stdout.split())


@pytest.mark.ros
@pytest.mark.parametrize(
    "module",
    [
        "analysis", "bags", "parameters.node_parameters", "run.progress", "run.watchdog", "timing",
        "transport.aligner", "transport.codec", "transport.topics",
    ],
)  # fmt: skip
def test_what_only_handles_messages_imports_without_rclpy(root, module):
    done = import_all(root, f"ftcm_ros.{module}", {"rclpy"}, messages=False)
    assert done.returncode == 0, done.stderr


def test_a_blocked_import_would_be_noticed(root):
    done = import_all(root, "ftcm_core", {"yaml", "numpy", "math", "dataclasses"}, messages=False)
    assert done.returncode != 0
    assert "is blocked in this test" in done.stderr
