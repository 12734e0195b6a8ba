# SPDX-License-Identifier: Apache-2.0
"""The pages say what is there: folders, links, modules, code, and the template of a package."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from programs import program

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(
    [
        *DOCS.glob("*.md"), *DOCS.glob("tutorials/*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md",
        DOCS / "template/README.md",
    ]
)  # fmt: skip
PACKAGES = {name: ROOT / "src" / name / name for name in ("ftcm_core", "ftcm_ros")}
TOPS = ("src/ftcm_core", "src/ftcm_ros", "tools", "config", "docker", "test", "docs")
"""What the picture of the folders shows, with all folders in it."""
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def ids(page):
    return str(page.relative_to(ROOT))


# ---- folders ----


def pictured():
    """Return the folders and files of the picture in architecture.md."""
    section = (DOCS / "architecture.md").read_text("utf-8").partition("\n## Folders\n")[2]
    folders, files, above = set(), set(), []
    for line in BLOCK.search(section)[2].splitlines():
        name, text = re.fullmatch(r" *(\S+) {2,}(\S.*)|(?: *)(\S+)", line).group(1, 2)
        name = name or line.strip()
        depth = (len(line) - len(line.lstrip())) // 2
        above = [*above[:depth], name.rstrip("/")]
        (folders if name.endswith("/") else files).add("/".join(above))
        assert text or name in ("ftcm_core/", "ftcm_ros/"), f"{line}: expected a line about it"
    return folders, files


def there():
    """Return the folders of the workspace: what tools leave behind, and links, are left out."""
    found = set()
    for top in TOPS:
        found.add(top)
        for path in (ROOT / top).rglob("*/"):
            parts = path.relative_to(ROOT).parts
            left = any(p in ("__pycache__", "build") or p.endswith((".egg-info", "_cache")) for p in parts)
            if path.is_dir() and not path.is_symlink() and not left:
                found.add("/".join(parts))
    return found


def test_the_picture_shows_every_folder_that_there_is():
    folders, files = pictured()
    assert folders == there()
    assert [name for name in files if not (ROOT / name).is_file()] == []


# ---- links and names ----


def slug(heading):
    """Return the anchor that GitHub gives a heading."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_every_relative_link_leads_somewhere(page):
    broken = []
    text = BLOCK.sub("", page.read_text("utf-8"))
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        if not file.exists():
            broken.append(target)
        elif anchor:
            headings = re.findall(r"^#+ (.*)$", BLOCK.sub("", file.read_text("utf-8")), re.MULTILINE)
            if anchor not in map(slug, headings):
                broken.append(target)
    assert broken == []


def is_there(dotted):
    """Whether a dotted name is a module of ours, or of one a name that it has."""
    package, *rest = dotted.split(".")
    at = PACKAGES[package]
    while rest and (at / rest[0]).is_dir():
        at = at / rest.pop(0)
    if not rest:
        return True
    file = at / f"{rest.pop(0)}.py"
    if not file.is_file():
        file = at / "__init__.py"
        rest = dotted.split(".")[-1:]
    text = file.read_text("utf-8")
    return all(re.search(rf"\b{re.escape(name)}\b", text) for name in rest)


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_every_module_named_is_there(page):
    names = re.findall(r"\b(ftcm_(?:core|ros)(?:\.[a-z_]\w*)+)", page.read_text("utf-8"))
    assert [name for name in names if not is_there(name)] == []


FOLDERS = (ROOT, *(path.parent for path in PACKAGES.values()), *PACKAGES.values(), DOCS, DOCS / "template")
OF_THE_READER = re.compile(r"my|mine|scenario|faults|soak_|m\d|summary|policy|metadata|NODE|CONTROLLER")
"""Files whose names begin so are the reader's own, or written by a command."""


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_every_file_named_is_there(page):
    everywhere = {path.name for top in TOPS for path in (ROOT / top).rglob("*") if path.is_file()}
    missing = []
    for name in re.findall(r"`([\w./-]+\.(?:py|xml|toml|rst))`", page.read_text("utf-8")):
        if name.startswith("runs/"):
            continue
        if "/" in name:
            found = any((folder / name).is_file() for folder in (*FOLDERS, page.parent))
        else:
            found = name in everywhere or OF_THE_READER.match(name)
        if not found:
            missing.append(name)
    assert missing == []


def test_a_name_that_is_not_there_would_be_noticed():
    assert is_there("ftcm_core.simulation.loop")
    assert is_there("ftcm_core.faults")
    assert not is_there("ftcm_core.stages")
    assert not is_there("ftcm_core.simulation.loops")


# ---- code ----


def shown_files():
    """Return file and code of each block of extending.md that shows a file of the template."""
    text = (DOCS / "extending.md").read_text("utf-8")
    return dict(re.findall(r"^\[[^]]+\]\(template/([^)]+)\):\n\n```\w+\n(.*?)^```$", text, re.M | re.S))


def test_the_code_shown_is_that_of_the_template():
    found = shown_files()
    template = DOCS / "template"
    modules = {f"my_lab/{path.name}" for path in (template / "my_lab").glob("*.py")} - {"my_lab/__init__.py"}
    assert set(found) == {*modules, "scenario.yaml"}
    assert {name: (template / name).read_text("utf-8") for name in found} == found


def first_block(page, language, word):
    blocks = BLOCK.findall(page.read_text("utf-8"))
    return next(text for kind, text in blocks if kind == language and word in text)


def test_the_notebook_of_the_first_steps_runs():
    pytest.importorskip("matplotlib")
    pytest.importorskip("pandas", reason="pandas is not installed (pip install pandas)")
    found = {}
    exec(first_block(DOCS / "first_steps.md", "python", "simulate("), found)
    assert list(found["table"].index[[0, -1]]) == [0.0, 20.0]


# ---- the template ----


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The scenario of a copy of the template, installed, and the environment that finds it."""
    setuptools = importlib.import_module("setuptools").__version__
    if int(setuptools.split(".")[0]) < 71 and importlib.util.find_spec("wheel") is None:
        pytest.skip(f"setuptools {setuptools} builds no wheel without the package 'wheel'")
    folder = tmp_path_factory.mktemp("lab")
    unwanted = shutil.ignore_patterns("__pycache__", "*.egg-info", "build")
    shutil.copytree(DOCS / "template", folder / "copy", ignore=unwanted)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    run([*pip, "--target", folder / "site", folder / "copy"], folder, os.environ)
    sources = [str(path.parent) for path in PACKAGES.values()]  # behind the workspace, where that is sourced
    search = [str(folder / "site"), os.environ.get("PYTHONPATH", ""), *sources]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, search))}
    environment["FTCM_CACHE_DIR"] = str(folder / "cache")
    return folder / "copy" / "scenario.yaml", environment


def run(command, cwd, env):
    done = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def compare(code, installed, cwd):
    """Return columns, ticks, and the columns of the runs ``one`` and ``two`` that differ."""
    scenario, environment = installed
    script = f"""
import json, numpy
from ftcm_core import compiled
from ftcm_core.registry import plugins
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
scenario = load({str(scenario)!r})
one = simulate(scenario)
{code}
assert one.status == two.status == "completed"
assert plugins() == (), "it is found by its entry point"
assert list(one.columns) == list(two.columns)
differing = [name for name in one.columns if not same(one.columns[name], two.columns[name])]
print(json.dumps([len(one.columns), one.ticks, differing]))
"""
    return json.loads(run([sys.executable, "-c", script], cwd, environment))


pip_installs = pytest.mark.slow


@pip_installs
def test_every_component_of_the_template_is_found(installed, tmp_path):
    _, environment = installed
    listed = json.loads(run([sys.executable, "-m", "ftcm_core.cli", "list", "--json"], tmp_path, environment))
    mine = {kind for kind, names in listed.items() if any(name.startswith("my_") for name in names)}
    assert mine == {"controller", "observer", "detector", "fault", "sensor", "robot"}


@pip_installs
def test_the_template_runs_compiled_as_it_does_plainly(installed, tmp_path):
    pytest.importorskip("numba", reason="numba is not installed")
    code = "two = compiled.simulate(scenario)\nsame = lambda a, b: numpy.allclose(a, b, rtol=1e-9, atol=1e-9)"
    assert compare(code, installed, tmp_path) == [14, 4001, []]


@pip_installs
@pytest.mark.ros
def test_the_template_runs_over_the_graph_float_for_float(installed, tmp_path):
    pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")
    scenario, environment = installed
    options = ["--name", "test", "--no-figures"]
    run([*program("experiment"), str(scenario), *options], tmp_path, environment)
    code = """
from pathlib import Path
from ftcm_ros.bags.reader import read_bag
bag = read_bag(Path("runs/test/bags/my_pd_plus"))
assert bag.missing == {}
two, same = bag.trace, numpy.array_equal
"""
    assert compare(code, installed, tmp_path) == [14, 4001, []]
