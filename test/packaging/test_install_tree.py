# SPDX-License-Identifier: Apache-2.0
"""What `colcon build` installs, seen from outside: by other processes, in another folder."""

import importlib.metadata
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from ftcm_ros.parameters.node_parameters import ALL_NODES

EXECUTABLES = {
    *ALL_NODES, "composed", "experiment", "analyse", "drive", "fault", "markers", "replay", "watch",
}  # fmt: skip
COMMANDS = {"doctor", "replay", "watch"}
"""What the package brings to the command `ftcm`."""


def prefix_of(package):
    """Find an installed package as `ros2 run` does: through the ament index."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix and Path(prefix, "share/ament_index/resource_index/packages", package).is_file():
            return Path(prefix)
    pytest.skip(f"{package} is not in AMENT_PREFIX_PATH: make build, then source install/setup.bash")


def run_installed(code, cwd):
    """Run Python code that sees the installed packages only; return what it prints as JSON."""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=cwd, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("package", ["ftcm_core", "ftcm_ros"])
def test_package_is_in_the_ament_index_with_its_manifest(package):
    prefix = prefix_of(package)
    assert (prefix / "share" / package / "package.xml").is_file()


def test_ros2_run_finds_every_executable():
    folder = prefix_of("ftcm_ros") / "lib" / "ftcm_ros"
    found = {path.name for path in folder.iterdir() if path.is_file() and os.access(path, os.X_OK)}
    assert found == EXECUTABLES


def test_ros2_launch_finds_every_launch_file(root):
    installed = prefix_of("ftcm_ros") / "share" / "ftcm_ros" / "launch"
    files = {path.name: path.read_text("utf-8") for path in (root / "src/ftcm_ros/launch").glob("*.py")}
    assert {path.name: path.read_text("utf-8") for path in installed.glob("*.py")} == files
    assert {*files} == {"experiment.launch.py", "node.launch.py", "viewer.launch.py"}


def test_ftcm_is_a_command_once_the_workspace_is_sourced(tmp_path):
    prefix = prefix_of("ftcm_core")
    local = prefix.parent / "setup.bash"
    found = subprocess.run(
        ["bash", "-c", f". '{local}'; command -v ftcm"],
        cwd=tmp_path,
        env={"PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert Path(found.stdout.strip()) == prefix / "bin" / "ftcm"


def test_config_files_are_installed_as_they_are_in_the_workspace(root, tmp_path):
    prefix_of("ftcm_core")
    code = """
import importlib.resources, json, pathlib
config = importlib.resources.files("ftcm_core") / "config"
with importlib.resources.as_file(config) as folder:
    patterns = ("*.yaml", "*.urdf", "layouts/*", "rviz/*")
    files = {str(p.relative_to(folder)): p.read_text("utf-8") for pattern in patterns
             for p in sorted(folder.rglob(pattern))}
print(json.dumps(files))
"""
    installed = run_installed(code, tmp_path)
    config = root / "config"
    there = [
        *config.rglob("*.yaml"),
        *config.rglob("*.urdf"),
        *config.glob("layouts/*"),
        *config.glob("rviz/*"),
    ]
    assert installed == {str(p.relative_to(config)): p.read_text("utf-8") for p in there}
    assert {"scenarios/paper.yaml", "robots/puma560.urdf"} <= set(installed)


def test_installed_core_tells_type_checkers_that_it_is_typed(tmp_path):
    prefix_of("ftcm_core")
    code = "import ftcm_core, json, os; print(json.dumps(os.listdir(os.path.dirname(ftcm_core.__file__))))"
    assert "py.typed" in run_installed(code, tmp_path)


def test_tools_are_not_installed(root):
    tools = {path.name for path in (root / "tools").glob("*.py")}
    assert tools
    for package in ("ftcm_core", "ftcm_ros"):
        installed = {path.name for path in prefix_of(package).rglob("*") if "__pycache__" not in path.parts}
        assert "setup.bash" in installed or "package.xml" in installed
        assert not installed & {*tools, "tools"}, package


@pytest.mark.ros
@pytest.mark.versions
@pytest.mark.parametrize("package", ["ftcm_core", "ftcm_ros"])
def test_every_entry_point_loads(package, tmp_path):
    prefix_of(package)
    code = f"""
import importlib.metadata, json
points = importlib.metadata.distribution({package!r}).entry_points
print(json.dumps([p.name for p in points if callable(p.load())]))
"""
    expected = {"ftcm"} if package == "ftcm_core" else EXECUTABLES | COMMANDS
    assert set(run_installed(code, tmp_path)) == expected


@pytest.mark.parametrize("package", ["ftcm_core", "ftcm_ros"])
def test_version_is_the_same_wherever_it_is_written(package, root):
    import ftcm_core

    folder = root / "src" / package
    manifest = re.search(r"<version>(.*?)</version>", (folder / "package.xml").read_text("utf-8"))
    setup = re.search(r'version="(.*?)"', (folder / "setup.py").read_text("utf-8"))
    assert manifest[1] == setup[1] == ftcm_core.__version__
    prefix_of(package)
    assert importlib.metadata.version(package) == ftcm_core.__version__


@pytest.mark.parametrize("name", ["fastdds.xml", "fastdds_viewer.xml"])
def test_middleware_settings_are_installed(tmp_path, name):
    prefix_of("ftcm_ros")
    code = f"""
import importlib.resources, json
file = importlib.resources.files("ftcm_ros.transport") / {name!r}
print(json.dumps(file.read_text("utf-8").count("participant")))
"""
    assert run_installed(code, tmp_path) > 0
