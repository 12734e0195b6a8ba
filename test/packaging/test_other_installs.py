# SPDX-License-Identifier: Apache-2.0
"""The ways to install other than `colcon build`, tried on a copy of the workspace."""

import importlib
import importlib.util
import os
import shutil
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

FIND_SCENARIO = """
import importlib.resources, ftcm_core
config = importlib.resources.files("ftcm_core") / "config"
print((config / "scenarios" / "paper.yaml").read_text("utf-8"), end="")
"""


@pytest.fixture
def workspace(root, tmp_path):
    """Return a copy of src/ and config/, links kept."""
    unwanted = shutil.ignore_patterns("__pycache__", "*.egg-info", "build")
    for name in ("src", "config"):
        shutil.copytree(root / name, tmp_path / "ws" / name, symlinks=True, ignore=unwanted)
    return tmp_path / "ws"


def clean_environment(**extra):
    """Return the environment without what sourcing a workspace has set."""
    kept = {k: v for k, v in os.environ.items() if k not in {"PYTHONPATH", "AMENT_PREFIX_PATH"}}
    if "ROS_DISTRO" in os.environ:  # a sourced ROS is needed; its own entries come from outside the workspace
        kept = dict(os.environ)
    return {**kept, **extra}


def run(command, cwd, env):
    done = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_pip_install_brings_scenarios_and_commands(workspace, tmp_path):
    setuptools = importlib.import_module("setuptools").__version__
    if int(setuptools.split(".")[0]) < 71 and importlib.util.find_spec("wheel") is None:
        pytest.skip(f"setuptools {setuptools} builds no wheel without the package 'wheel'")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    core, ros = tmp_path / "core", tmp_path / "ros"
    run([*pip, "--target", core, "src/ftcm_core"], workspace, clean_environment())
    run([*pip, "--target", ros, "src/ftcm_ros"], workspace, clean_environment())
    shutil.rmtree(workspace)
    text = run([sys.executable, "-c", FIND_SCENARIO], tmp_path, clean_environment(PYTHONPATH=str(core)))
    assert text.strip()
    assert (core / "bin" / "ftcm").is_file()
    assert {"experiment", "plant"} <= {path.name for path in (ros / "bin").iterdir()}


def test_symlink_install_sees_the_workspace_files(workspace):
    colcon = "from colcon_core.command import main; raise SystemExit(main())"
    arguments = ["build", "--symlink-install", "--base-paths", "src"]
    quiet = clean_environment(PYTHONWARNINGS="ignore")
    run([sys.executable, "-c", colcon, "--log-base", "log", *arguments], workspace, quiet)
    assert (workspace / "install/ftcm_ros/lib/ftcm_ros/experiment").is_file()
    edited = workspace / "config" / "scenarios" / "paper.yaml"
    edited.write_text("edited: true\n", encoding="utf-8")
    find = f". install/setup.bash; command -v ftcm; exec '{sys.executable}' -c '{FIND_SCENARIO}'"
    lines = run(["bash", "-c", find], workspace, quiet).splitlines()
    assert lines == [str(workspace / "install/ftcm_core/bin/ftcm"), "edited: true"]
