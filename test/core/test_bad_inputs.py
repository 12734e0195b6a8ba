# SPDX-License-Identifier: Apache-2.0
"""At least 10,000 bad inputs: each is refused in one short line that says where and what, and nothing else
happens."""

from __future__ import annotations

import contextlib
import copy
import functools
import importlib.util
import io
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import strategies as st

from ftcm_core import campaign, cli
from ftcm_core.campaign import plan
from ftcm_core.errors import FtcmError, ParameterError, ScenarioError, shown
from ftcm_core.params import ParamSpec, specs
from ftcm_core.registry import KINDS, components
from ftcm_core.scenario import InitialState, Scenario, apply_override, from_mapping, load, parse_yaml
from ftcm_core.scenario.reading import MAX_FILE_BYTES
from ftcm_core.scenario.yaml_text import _Dumper
from inputs import NOT_BAD, inputs, promised

JOINTS = 3
ENVIRONMENT = {
    **os.environ, "PYTHONPATH": os.pathsep.join(x for x in sys.path if x), "PYTHONDONTWRITEBYTECODE": "1"
}  # fmt: skip
"""In which a child finds the sources."""
PAPER = load("paper", ["detector=residual_threshold", "policies=[safe_stop]"]).to_mapping()
TEXT = """\
robot: puma560
reference: {type: vo_kang_cosine}
controller: {type: ftcm, gamma1: [1.0, 2.0, 3.0]}
observer: {type: do, k1: 20000, k2: 200}
initial_state: {position: 0.5}
injection:
  disturbances:
    - {type: vo_kang_friction}
  faults:
    - type: vo_kang_fault
      start: 10
dt: 0.001
duration: 1
seed: 7
"""
LINES = TEXT.splitlines(keepends=True)

# ---- what an input may not do ----

WATCHED = {
    "open", "os.system", "os.exec", "os.fork", "os.posix_spawn", "os.spawn", "subprocess.Popen", "os.mkdir",
    "os.remove", "os.rename", "os.link", "os.symlink", "os.chmod", "socket.connect", "exec",
}  # fmt: skip
_done: list[str] | None = None


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    if _done is not None and event in WATCHED:
        _done.append(f"{event} {arguments}")


sys.addaudithook(_watch)


@contextlib.contextmanager
def only_read() -> Iterator[None]:
    """Fail if anything is opened, executed, made or connected to."""
    global _done
    _done = done = []
    try:
        yield
    finally:
        _done = None
    assert done == []


def refusal(data: Any, *where: str) -> str:
    """The line that plain data are refused with; it names the place."""
    with pytest.raises(ScenarioError) as error:
        from_mapping(data)
    return one_line(error.value, *where)


def one_line(error: FtcmError, *parts: str) -> str:
    """Check and return what a user gets to read."""
    message = str(error)
    assert len(message.splitlines()) == 1
    assert len(message) < 500
    for part in parts:
        assert part in message
    return message


def placed(data: Any, path: tuple[Any, ...], value: Any) -> Any:
    """A copy of plain data with one value replaced or added."""
    data = node = copy.deepcopy(data)
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    return data


# ---- values ----


def scenario_with(kind: str, name: str) -> tuple[tuple[Any, ...], dict[str, Any]]:
    """A good scenario with a component in it, written in full, and where that is."""
    path: tuple[Any, ...] = (kind,)
    if kind in ("disturbance", "fault"):
        path = ("injection", f"{kind}s", 0)
    elif kind == "policy":
        path = ("policies", 0)
    simple = {**PAPER, "controller": {"type": "ctc"}}
    if kind != "policy":
        simple |= {"detector": None, "policies": []}
    if kind == "plant":
        simple |= {"robot": "urdf"}  # one that tells its links
    data = placed(simple, path, {"type": name})
    return path, from_mapping(data).to_mapping()


def declared() -> list[tuple[dict[str, Any], tuple[Any, ...], ParamSpec]]:
    """Every parameter of every component, and of the scenario itself."""
    found = [
        (PAPER, (*path, name), spec)
        for path, cls in (((), Scenario), (("initial_state",), InitialState))
        for name, spec in specs(cls).items()
    ]
    for kind in KINDS:
        for name, cls in components(kind).items():
            if name == "mujoco" and not importlib.util.find_spec("mujoco"):
                continue
            if kind == "controller" and cls.needs_observer:
                path, data = ("controller",), {**PAPER, "controller": cls().to_mapping()}
            else:
                path, data = scenario_with(kind, name)
            found += [(data, (*path, p), spec) for p, spec in specs(cls).items()]
    robot = components("robot")["puma560"]
    return found + [(PAPER, ("model", p), spec) for p, spec in specs(robot).items()]


NOT_NUMBERS = st.one_of(
    st.text(max_size=8),
    st.booleans(),
    st.dates(),
    st.binary(max_size=4),
    st.just({}),
    st.just([]),
    st.sampled_from(["1e4", "1,5", "10 000", "0x", "NaN", "٣", "١٢", [[1.0, 2.0, 3.0]], {"value": 1.0}]),
)
NOT_FINITE = st.sampled_from([math.nan, math.inf, -math.inf, 10**400, -(10**400)])


@functools.cache  # here and below: else made anew for every input
def wrong(spec: ParamSpec) -> st.SearchStrategy[Any]:
    """Values that a parameter does not take."""
    if spec.kind == "str":
        others = [NOT_NUMBERS.filter(lambda v: not isinstance(v, str)), NOT_FINITE]
        others += [] if spec.optional else [st.none()]
        return st.one_of(*others, *([st.text().filter(lambda s: s not in spec.choices)] * bool(spec.choices)))
    bad = [NOT_NUMBERS, NOT_FINITE]
    if spec.kind == "bool":
        bad[0] = NOT_NUMBERS.filter(lambda v: not isinstance(v, bool))
    if math.isfinite(spec.lower):
        bad.append(
            st.integers(max_value=math.ceil(spec.lower) - 1)
            if spec.kind == "int"
            else st.floats(max_value=spec.lower, exclude_max=not spec.lower_open, allow_infinity=False)
        )
    if math.isfinite(spec.upper):
        bad.append(
            st.integers(min_value=math.floor(spec.upper) + 1)
            if spec.kind == "int"
            else st.floats(min_value=spec.upper, exclude_min=not spec.upper_open, allow_infinity=False)
        )
    if spec.kind == "int":
        bad.append(st.floats(0.01, 0.99).map(lambda x: 1 + x))
    first = spec.default[0] if isinstance(spec.default, tuple) else spec.default
    lengths = st.integers(1, 9) if not spec.per_joint else st.integers(1, 200).filter(lambda n: n != JOINTS)
    bad.append(lengths.map(lambda n: [1.0 if first is None else first] * n))
    if spec.per_joint:
        position = st.integers(0, JOINTS - 1)
        bad.append(
            st.builds(lambda i, v: [*[first] * i, v, *[first] * (2 - i)], position, st.one_of(bad[:2]))
        )
    if not spec.optional:
        bad.append(st.none())
    return st.one_of(bad)


def names_the_value(message: str, value: Any) -> bool:
    """Whether a message shows the value, or the entry of a list that is wrong."""
    forms = [shown(value)]
    if isinstance(value, (int, float)):
        with contextlib.suppress(OverflowError):
            forms.append(f"{value:g}")
    if isinstance(value, list):
        forms += [shown(v) for v in value]
    return any(" ".join(form.splitlines()) in message for form in forms)


wrong_values = st.sampled_from(declared()).flatmap(lambda place: st.tuples(st.just(place), wrong(place[2])))


@pytest.mark.pure
@inputs(2500, drawn=wrong_values)
def test_a_value_that_a_parameter_does_not_take(drawn: Any) -> None:
    """Wrong type, not finite, out of bounds, wrong length: by path and value."""
    (data, path, _), value = drawn
    message = refusal(placed(data, path, value), f"{'.'.join(map(str, path))}: ")
    assert names_the_value(message, value)
    assert "expected" in message or "is not" in message


def overridden(data: Any, dotted: str, text: str) -> Scenario:
    """The scenario with a value set as on the command line."""
    data = copy.deepcopy(data)
    apply_override(data, f"{dotted}={text}")
    return from_mapping(data, places={dotted: "--set"})


@inputs(1500, drawn=wrong_values)
def test_a_value_that_a_parameter_does_not_take_set_on_the_command_line(drawn: Any) -> None:
    """The same through YAML and ``--set``."""
    (data, path, _), value = drawn
    dotted = ".".join(map(str, path))
    text = yaml.dump(value, Dumper=_Dumper, default_flow_style=True, width=10**9, allow_unicode=True)
    with pytest.raises(ScenarioError) as error:
        overridden(data, dotted, text)
    one_line(error.value, "--set", dotted)


@pytest.mark.pure
@inputs(
    700,
    drawn=st.sampled_from(
        [(c, s) for k in KINDS for c in components(k).values() for s in specs(c).values()]
    ).flatmap(lambda p: st.tuples(st.just(p), wrong(p[1]))),
)
def test_a_value_that_a_parameter_does_not_take_given_in_python(drawn: Any) -> None:
    """Whoever makes a component in a program is told the same."""
    (cls, spec), value = drawn
    with pytest.raises(ParameterError) as error:
        cls(**{spec.name: value}).check_joints(JOINTS)
    one_line(error.value, f"{spec.name}: ")


# ---- names and structure ----

MAPPINGS: list[tuple[Any, ...]] = [
    (),
    ("robot",),
    ("reference",),
    ("controller",),
    ("observer",),
    ("model",),
    ("plant",),
    ("detector",),
    ("sensor",),
    ("initial_state",),
    ("injection",),
    ("injection", "disturbances", 0),
    ("injection", "faults", 0),
    ("policies", 0),
]
COMPONENTS = [p for p in MAPPINGS if p and p[-1] not in ("initial_state", "injection")]


def at(data: Any, path: tuple[Any, ...]) -> Any:
    """What plain data have at a path."""
    for key in path:
        data = data[key]
    return data


HUGE = st.just(5000).map(lambda digits: 10**digits)  # which Python itself refuses to print
ODD_KEYS = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.dates(), HUGE, st.just(b"k1"))


@functools.cache
def misspelt(word: str) -> st.SearchStrategy[str]:
    """A word with a letter left out, doubled, changed or in capitals."""
    return st.integers(0, len(word) - 1).flatmap(
        lambda i: st.sampled_from(
            [
                word[:i] + word[i + 1 :],
                word[:i] + word[i] + word[i:],
                word[:i] + "_" + word[i + 1 :],
                word[:i] + word[i].upper() + word[i + 1 :],
                word + " ",
                " " + word,
            ]
        )
    )


@functools.cache
def unknown_key(path: tuple[Any, ...]) -> st.SearchStrategy[tuple[tuple[Any, ...], Any]]:
    """The place, and a key that is not known there."""
    known = list(at(PAPER, path))
    keys = st.one_of(ODD_KEYS, st.text(max_size=80), *map(misspelt, known))
    return st.tuples(st.just(path), keys.filter(lambda key: key not in known))


@pytest.mark.pure
@inputs(1000, drawn=st.sampled_from(MAPPINGS).flatmap(unknown_key), examples=({"drawn": ((), 10**5000)},))
def test_a_key_that_is_not_known(drawn: Any) -> None:
    """By path and name."""
    path, key = drawn
    message = refusal(placed(PAPER, (*path, key), 1), ".".join(map(str, path)), "unknown key; ")
    name = key if isinstance(key, str) and len(key) <= 60 else shown(key)
    assert " ".join(name.splitlines()) in message


@functools.cache
def unknown_type(path: tuple[Any, ...]) -> st.SearchStrategy[tuple[tuple[Any, ...], Any]]:
    """The place, and what is no component's name there."""
    kinds = {"disturbances": "disturbance", "faults": "fault", "policies": "policy", "model": "robot"}
    kind = kinds.get(path[-2] if len(path) > 1 else path[0], path[0])
    others = [name for k in KINDS for name in components(k)]
    names = st.one_of(
        st.text(max_size=80),
        NOT_NUMBERS,
        NOT_FINITE,
        st.sampled_from(others),
        *map(misspelt, components(kind)),
    )
    other = names.filter(lambda name: not isinstance(name, str) or name not in components(kind))
    return st.tuples(st.just(path), other)


@pytest.mark.pure
@inputs(800, drawn=st.sampled_from(COMPONENTS).flatmap(unknown_type))
def test_a_component_that_does_not_exist(drawn: Any) -> None:
    """By path and name, in both forms."""
    path, name = drawn
    where = ".".join(map(str, path))
    refusal(placed(PAPER, (*path, "type"), name), f"{where}.type: ")
    if isinstance(name, str):
        refusal(placed(PAPER, path, name), f"{where}.type: no ")


@inputs(
    250,
    of=350,
    drawn=st.tuples(
        st.sampled_from(
            [
                *COMPONENTS,
                ("initial_state",),
                ("injection",),
                ("injection", "faults"),
                ("injection", "disturbances"),
                ("policies",),
            ]
        ),
        st.one_of(NOT_NUMBERS, NOT_FINITE, st.integers(), st.lists(st.integers(), min_size=1)),
    ),
    examples=tuple({"drawn": (("injection", "faults"), v)} for v in (0, False, "", {}, 0.0)),
)
def test_a_part_of_another_shape(drawn: Any) -> object:
    """A component, record or list that is something else; nothing that is false counts as left out."""
    path, value = drawn
    if (value == [] and path[-1] in ("faults", "disturbances", "policies")) or (
        # A plant without a type is the default one, a model without values the true robot.
        value == {} and path[-1] in ("initial_state", "injection", "plant", "model")
    ):
        return NOT_BAD
    return refusal(placed(PAPER, path, value), ".".join(map(str, path)))


@pytest.mark.parametrize("path", COMPONENTS[:4])
def test_a_part_left_out(path: tuple[Any, ...]) -> None:
    """Robot, reference, controller and observer must be said, and so must a component's type."""
    data = copy.deepcopy(PAPER)
    del data[path[0]]
    assert f"{path[0]}: is missing" in refusal(data)
    assert f"{path[0]}: has no 'type'" in refusal(placed(PAPER, path, {}))


@pytest.mark.parametrize("data", [None, 3, "paper", [], [PAPER], {1, 2}, math.nan])
def test_no_mapping_at_all(data: Any) -> None:
    """Also from a program, or from the text that a bag carries."""
    refusal(data, "is not a mapping")


garbage = st.recursive(
    st.one_of(st.none(), st.integers(), st.floats(), NOT_NUMBERS, st.sampled_from(["type", "ftcm"]), HUGE),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.one_of(st.sampled_from(["type", "k1", "start"]), ODD_KEYS), inner, max_size=4),
    ),
    max_leaves=8,
)


@inputs(
    400,
    data=st.dictionaries(
        st.one_of(st.sampled_from(list(PAPER)), st.text(max_size=4), ODD_KEYS), garbage, max_size=6
    ),
)
def test_nested_nonsense(data: dict[Any, Any]) -> None:
    """Never all four required components."""
    refusal(data)


# ---- YAML ----


def read(text: str) -> Scenario:
    """The scenario of a file's text."""
    data, lines = parse_yaml(text, "mine.yaml")
    return from_mapping(data, origin="mine.yaml", places={k: f"mine.yaml:{n}" for k, n in lines.items()})


assert read(TEXT).faults


def refused_text(text: str) -> str:
    """The line that a file's text is refused with; nothing else happens."""
    with pytest.raises(ScenarioError) as error, only_read():
        read(text)
    message = one_line(error.value)
    assert message.startswith("mine.yaml")
    return message


BAD_VALUES = [
    "!!python/object/apply:os.system ['touch escaped']", "!!python/object/new:os.system ['touch escaped']",
    "!!python/object:subprocess.Popen {args: [touch, escaped]}", "!!python/name:os.system",
    "!!python/module:os", "!!python/object/apply:builtins.open ['escaped', 'w']",
    "!!python/tuple [1, 2, 3]", "!!python/dict {a: 1}", "!include escaped.yaml", "!mine 3", "!!nothing 1",
    "!!int ''", "!!float ''", "!!float x", "!!bool maybe", "!!null 1", "!!timestamp soon", "!!binary 'é'",
    "!!map [1]", "!!seq {a: 1}", "!!set [1]", "!!omap {a: 1}", "!!pairs [1]", "*nowhere", "&a [*a]",
    "&a {b: *a}", "&a {<<: *a}", "{<<: 3}", "{<<: [3]}", "[1, 2", "{a: 1", "'open", '"open', '"\\q"', "@a",
    "`a`", "%a", "1: 2", "- 1", "{a: 1, a: 2}", "{[1]: 2}", "{{a: 1}: 2}", "{? [1] : 2}", "1:30",
    "-1:30:00", "1:30.5", "010", "-0777", "0_7", "2020-01-01", "2020-13-45", "2020-01-01T00:00:00Z", "0x",
    "0b", "0o17", "08x", "1e400", "-1e400", ".nan", ".inf", "-.INF", "on", "off", "no", "yes", "y", "~",
    "null", "''", "=", "<<", "٣", "1٫5", "1,5", "1 000", "1ms", "0.5 # s\n  x", "|\n  1", ">\n  1",
    "0x" + "f" * 5000, "7" * 5000, "1" + ":00" * 5000, "[" * 5000, "{a: " * 3000, "[" * 300 + "]" * 300,
    "- " * 3000, "!!int " * 3000 + "1", "x" * 50_000,
]  # fmt: skip
VALUED = [  # lines of the text that end with a number, and what is before it
    (i, line[: line.rindex(": ") + 2]) for i, line in enumerate(LINES) if line.rstrip()[-1].isdigit() and i
]


@inputs(350, of=400, value=st.sampled_from(BAD_VALUES), where=st.sampled_from(VALUED))
def test_yaml_that_is_no_number(value: str, where: tuple[int, str]) -> None:
    """Tags, aliases, dates, base 8 and 60, other truths, open brackets, depth: in place of a number."""
    line, before = where
    refused_text("".join([*LINES[:line], before + value + "\n", *LINES[line + 1 :]]))


CONTROL = [
    chr(c) for c in (*range(9), 11, 12, *range(14, 32), 127, 0x80, 0x9F, 0xFFFE, 0xFFFF, 0xD800, 0xDFFF)
]


@inputs(500, place=st.integers(0, len(TEXT)), character=st.sampled_from(CONTROL))
def test_a_control_character_anywhere(place: int, character: str) -> None:
    """Also in a comment or a name."""
    assert "special characters are not allowed" in refused_text(TEXT[:place] + character + TEXT[place:])


@inputs(130, of=250, source=st.integers(0, len(LINES) - 1), target=st.integers(0, len(LINES)))
def test_a_line_written_twice(source: int, target: int) -> object:
    """Whatever a second copy of a line becomes where it stands, it never silently counts."""
    if LINES[source].lstrip().startswith("- "):  # one more entry of a list is a good one
        return NOT_BAD
    return refused_text("".join([*LINES[:target], LINES[source], *LINES[target:]]))


@inputs(
    50,
    place=st.integers(1, len(LINES) - 1),
    more=st.sampled_from(["---\n", "...\n---\n", "--- x\n", "...\nx\n"]),
)
def test_a_second_document(place: int, more: str) -> None:
    """A file is one scenario."""
    refused_text("".join([*LINES[:place], more, *LINES[place:]]))


@inputs(50, place=st.integers(1, len(LINES) - 1), indent=st.sampled_from(["\t", " \t", "\t\t", "   \t "]))
def test_indentation_with_tabs(place: int, indent: str) -> None:
    """YAML has none."""
    refused_text("".join([*LINES[:place], indent + LINES[place].lstrip(), *LINES[place + 1 :]]))


def multiplying(levels: int, width: int, merge: bool) -> str:
    """Aliases of aliases: a text of some lines that stands for width**levels values."""
    before, after = ("{<<: [", "]}") if merge else ("[", "]")
    lines = ["a0: &a0 " + ("{x: 1, y: 2}" if merge else "[1, 2]")]
    lines += [f"a{i}: &a{i} {before}{', '.join([f'*a{i - 1}'] * width)}{after}" for i in range(1, levels)]
    return "\n".join([*lines, f"robot: *a{levels - 1}\n"])


@inputs(60, levels=st.integers(2, 200), width=st.integers(2, 50), merge=st.booleans())
def test_aliases_that_multiply(levels: int, width: int, merge: bool) -> None:
    """Cost no more than their text."""
    refused_text(multiplying(levels, width, merge))


def test_one_merge_of_much() -> None:
    """Many entries, merged many times in one place."""
    names = ", ".join(f"k{i}: 1" for i in range(4000))
    assert "merge keys bring in more than" in refused_text(
        f"a: &a {{{names}}}\nb: {{<<: [{', '.join(['*a'] * 9000)}]}}\n"
    )


def agree(written: Any, kept: Any) -> bool:
    """Whether everything that was written is in what was kept."""
    if isinstance(written, dict):
        return all(key in kept and agree(value, kept[key]) for key, value in written.items())
    if isinstance(written, list):
        return len(written) == len(kept) and all(map(agree, written, kept))
    if isinstance(kept, dict):  # a component by its name alone; or a part left out
        return written is None or kept["type"] == written
    if isinstance(kept, float):
        return float(written) == kept
    return written == kept or (written is None and kept == [])


edits = st.lists(
    st.tuples(
        st.sampled_from(["delete", "insert", "replace", "swap"]),
        st.integers(0, len(TEXT) - 2),
        st.one_of(st.sampled_from("{}[]:,-?&*!|>'\"%@#~=<. \n\t0123456789eE_"), st.characters()),
    ),
    min_size=1,
    max_size=4,
)


@inputs(900, of=1500, changes=edits)
def test_a_text_with_slips(changes: list[tuple[str, int, str]]) -> object:
    """Refused, or read as an ordinary YAML reader reads it, every value of it."""
    text = TEXT
    for what, i, character in changes:
        if what == "delete":
            text = text[:i] + text[i + 1 :]
        elif what == "swap":
            text = text[:i] + text[i + 1 : i + 2] + text[i : i + 1] + text[i + 2 :]
        else:
            text = text[:i] + character + text[i + (what == "replace") :]
    try:
        with only_read():
            scenario = read(text)
    except ScenarioError as error:
        return one_line(error)
    assert agree(yaml.safe_load(text), scenario.to_mapping())
    return NOT_BAD


SYNTAX = [
    "{", "}", "[", "]", ":", ",", "- ", "? ", "&a ", "*a", "<<", "!", "|", ">", "'", '"', "\\", "#", "%",
    "@", "`", "---", "...", "~", "=", "!!int ", "!!float ", "!!bool ", "!!timestamp ", "!!map ", "!!set ",
    "!!omap ", "!x ", "!!binary ", "1e4", "0x1f", "1:30", "2020-13-01", "2020-01-01", ".nan", "-.inf",
    "robot", "type", "ftcm", "k1",
]  # fmt: skip
SPACE = ["\n", "\n  ", " ", ": ", ", ", "\t", "\0", "\x85", "\u2028", "\ufeff"]
words = st.sampled_from([*SYNTAX, *SPACE, *SPACE[:5]])
texts = st.one_of(st.text(max_size=30), st.lists(words, max_size=15).map("".join))


@inputs(
    700,
    text=texts,
    examples=tuple(
        {"text": t}
        for t in (
            "a: !!timestamp soon",
            "!!int ''",
            "? [a]\n: b",
            "!!set {a: b}",
            "? 0x" + "f" * 5000 + "\n: 3",
        )
    ),
)
def test_garbage_for_yaml(text: str) -> None:
    """Never a scenario."""
    refused_text(text)


# ---- files ----


@inputs(
    250,
    data=st.one_of(
        st.binary(max_size=60),
        st.tuples(
            st.integers(0, len(TEXT)),
            st.sampled_from([b"\xff", b"\x80", b"\xc0\x80", b"\xed\xa0\x80", b"\xf8", b"\0"]),
        ).map(lambda p: TEXT[: p[0]].encode() + p[1] + TEXT[p[0] :].encode()),
    ),
)
def test_bytes_for_a_file(data: bytes) -> None:
    """Any bytes; a good scenario with a byte that is not UTF-8."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mine.yaml"
        path.write_bytes(data)
        with pytest.raises(ScenarioError) as error:
            load(str(path))
    one_line(error.value, "mine.yaml")


def odd_files(folder: Path) -> dict[str, tuple[Path, str]]:
    """Things that are not a scenario file, and what is said of them."""
    (folder / "folder").mkdir()
    os.mkfifo(folder / "pipe")
    (folder / "loop").symlink_to(folder / "loop")
    (folder / "zeros").symlink_to("/dev/zero")
    (folder / "big").write_text("# " + "x" * 10_000_000)
    (folder / "sparse").write_bytes(b"")
    os.truncate(folder / "sparse", 1 << 40)
    (folder / "binary").write_bytes(bytes(range(256)) * 100)
    (folder / "empty").write_bytes(b"")
    regular, large = "not a regular file", f"larger than {MAX_FILE_BYTES} bytes"
    return {
        "folder": (folder / "folder", regular),
        "pipe": (folder / "pipe", regular),
        "endless device": (Path("/dev/zero"), regular),
        "empty device": (Path("/dev/null"), regular),
        "link to a device": (folder / "zeros", regular),
        "link to itself": (folder / "loop", "Too many levels"),
        "ten megabytes": (folder / "big", large),
        "a terabyte": (folder / "sparse", large),
        "binary": (folder / "binary", "not a text file in UTF-8"),
        "empty": (folder / "empty", "expected a mapping"),
        "missing": (folder / "missing", "no scenario file"),
        "in a file": (folder / "empty" / "x", "Not a directory"),
        "too long": (folder / ("x" * 300), "File name too long"),
    }


def test_files_that_are_none(tmp_path: Path) -> None:
    """One line each, in a process of its own that would hang, or fill its memory, with a second thought."""
    cases = odd_files(tmp_path)
    program = (
        "import resource, sys\n"
        "from ftcm_core.cli import main\n"
        "resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))\n"
        "for path in sys.argv[1:]: main(['simulate', path]); main(['campaign', path])\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", program, *(str(path) for path, _ in cases.values())],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        env=ENVIRONMENT,
    )
    lines = run.stderr.splitlines()
    assert len(lines) == 2 * len(cases)
    for line, (_, text) in zip(lines, [case for case in cases.values() for _ in range(2)]):
        assert line.startswith("ftcm: error: ")
        assert text in line


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
def test_a_file_one_may_not_read(tmp_path: Path) -> None:
    """Says so."""
    path = tmp_path / "mine.yaml"
    path.write_text(TEXT)
    path.chmod(0)
    with pytest.raises(ScenarioError, match="Permission denied"):
        load(str(path))


# ---- the command line ----

words_of_a_path = st.one_of(
    st.sampled_from(
        ["observer", "k1", "controller", "type", "injection", "faults", "0", "start", "torque_limits"]
    ),
    st.text(max_size=3),
    st.just("9" * 5000),
)
paths = st.lists(words_of_a_path, max_size=4).map(".".join)


@inputs(
    500,
    of=700,
    overrides=st.lists(st.one_of(texts, st.builds("{}={}".format, paths, texts)), min_size=1, max_size=3),
    examples=tuple(
        {"overrides": o}
        for o in (
            ["injection.faults." + "9" * 5000 + "=3"],
            ["observer.k1=!!int ''"],
            ["a\nb=1"],
            ["k" * 5000 + "=1", "k" * 5000 + ".x=1"],
            ["k" * 5000 + "=", "k" * 5000 + ".x=1"],
        )
    ),
)
def test_garbage_overrides(overrides: list[str]) -> object:
    """One to three --set texts on a good scenario."""
    data = copy.deepcopy(PAPER)
    try:
        for text in overrides:
            apply_override(data, text)
        scenario = from_mapping(data)
    except FtcmError as error:
        return one_line(error)
    assert from_mapping(scenario.to_mapping()) == scenario
    return NOT_BAD


def run_command(arguments: list[str]) -> tuple[Any, str, str]:
    """Exit status, stdout and stderr of a command, run in an empty folder."""
    out, err = io.StringIO(), io.StringIO()
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                status: Any = cli.main(arguments)
        except SystemExit as end:  # argparse
            status = end.code
        finally:
            os.chdir(before)
        assert os.listdir(folder) == []
    return status, out.getvalue(), err.getvalue()


no_name = (
    st.text(max_size=10)
    .filter(lambda s: s.strip() != "" and s not in ("paper", *KINDS, "scenario"))
    .map("zz".__add__)
)
no_override = st.one_of(
    st.sampled_from(
        ["observer.k1=x", "dt=0", "duration=-1", "x=1", "robot=", "seed=1.5", "name=7", "=", "observer.k1"]
    ),
    no_name.map(lambda s: s.replace("=", "") + "=1"),
)
no_variation = st.one_of(
    no_name,
    no_name.map("observer.k1={}".format),
    st.sampled_from(
        [
            "observer.k1=uniform(2, 1)",
            "observer.k1=uniform(nan, 1)",
            "observer.k1=uniform(1)",
            "x=uniform(1, 2)",
            "observer.k1=uniform(-2, -1)",
            "observer.k1=loguniform(0, 1)",
            "observer.k1=normal(1, -1)",
            "=uniform(1, 2)",
            "observer.k1=integer(0.5, 1)",
            "observer.k1=choice()",
            "observer.k1=choice([)",
            "observer.k1=choice(1, )",
            "observer.k1=uniform(" + "9" * 5000 + ", 1)",
            "observer.k1=uniform(0, 1e999)",
            "observer.k1=cauchy(0, 1)",
        ]
    ),
)
no_folder = st.sampled_from(["", ".", "/", "/proc/x", "a\0b", "/dev/null/x", "x" * 300])
commands = st.one_of(
    st.lists(no_name, max_size=3),
    st.builds(
        lambda c, s: [c, s], st.sampled_from(["simulate", "compare", "campaign", "list", "describe"]), no_name
    ),
    st.builds(
        lambda c, s: [c, "paper", "--set", s],
        st.sampled_from(["simulate", "compare", "campaign"]),
        no_override,
    ),
    st.builds(
        lambda c, s: [c, "paper", "--output", s],
        st.sampled_from(["simulate", "compare", "campaign"]),
        no_folder,
    ),
    st.builds(lambda s: ["simulate", "paper", "--controller", s], no_name),
    st.builds(lambda s: ["simulate", "paper", "--observer", s], no_name),
    st.builds(lambda s: ["simulate", "paper", "--engine", s], no_name),
    st.builds(lambda s: ["compare", "paper", "--controllers", "smc", s], no_name),
    st.builds(lambda s: ["campaign", "paper", "--vary", s], no_variation),
    st.builds(
        lambda o, s: ["campaign", "paper", o, s],
        st.sampled_from(["--runs", "--seed", "--jobs"]),
        st.one_of(no_name, st.sampled_from(["", "-1", "1.5", "9" * 5000, "1e3", "nan"])),
    ),
    st.builds(lambda s: ["describe", s], st.sampled_from(["", "/", "ftcm/x", "controller/", "a\0b"])),
    st.builds(lambda c, s: [c, f"--{s}"], st.sampled_from(["simulate", "list", "reproduce"]), no_name),
)


@pytest.mark.pure
@inputs(900, arguments=commands)
def test_commands_that_make_no_sense(arguments: list[str]) -> None:
    """Status 2, nothing on stdout, one line with the mistake (after the usage, if any), no files."""
    status, out, err = run_command(arguments)
    assert (status, out) == (2, "")
    *usage, line = err.rstrip("\n").split("\n")
    assert ": error: " in line or ": error: " in err
    assert not usage or usage[0].startswith(("usage: ", "ftcm: left out: "))


campaign_files = st.fixed_dictionaries(
    {"scenario": st.just("paper")},
    optional={"runs": garbage, "seed": garbage, "vary": garbage, "set": garbage, "controllers": garbage},
)


@inputs(
    300,
    of=450,
    data=st.one_of(
        campaign_files,
        st.fixed_dictionaries({"scenario": garbage}),
        st.builds(lambda k: {"scenario": "paper", k: 1}, st.one_of(ODD_KEYS, st.text())),
    ),
    examples=(
        {"data": {"scenario": "paper", 10**5000: 1}},
        {"data": {"scenario": "paper", "vary": {10**5000: "uniform(1, 2)"}}},
        {"data": {"scenario": "x" * 5000}},
        {"data": {"scenario": None}},
        {"data": {"scenario": "a\0b"}},
    ),
)
def test_campaign_files(data: dict[Any, Any]) -> object:
    """Refused, or a campaign whose first run is a scenario."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            plan,
            "read_mapping",
            lambda source: (copy.deepcopy(data), {}, "mine.yaml") if source == "mine.yaml" else READ(source),
        )
        try:
            planned = campaign.from_file("mine.yaml")
            planned.scenario(planned.run_list()[0] if planned.runs < 100 else campaign.Run(0, "", {}))
        except FtcmError as error:
            return one_line(error)
    return NOT_BAD


READ = plan.read_mapping


# ---- what a scenario may reach ----

HOSTILE = """\
name: "../../escaped/$\\\\bad{$ <script> \\a | `touch escaped`"
robot: puma560
reference: constant
controller: smc
observer: do
duration: 0.02
"""


@pytest.mark.slow
def test_a_run_writes_only_into_its_folder(tmp_path: Path) -> None:
    """Every file opened for writing, every folder made is in the output, whatever the scenario is called."""
    work = tmp_path / "a" / "b" / "c"
    work.mkdir(parents=True)
    (work / "mine.yaml").write_text(HOSTILE)
    (work / "other.yaml").write_text(HOSTILE.replace("smc", "pid"))
    program = (
        "import os, sys\n"
        "import ftcm_core.cli, matplotlib.backends.backend_agg, matplotlib.figure, matplotlib.font_manager\n"
        "def watch(event, given):\n"
        "    writes = event == 'open' and (given[2] or 0) & (os.O_WRONLY | os.O_RDWR)\n"
        f"    if writes and isinstance(given[0], str) or event in {sorted(WATCHED - {'open', 'exec'})}:\n"
        "        print('DID', event, given[0], flush=True)\n"
        "sys.addaudithook(watch)\n"
        "sys.exit(ftcm_core.cli.main(sys.argv[1:]))\n"
    )
    for command in (
        ["simulate", "mine.yaml", "--output", "simulated"],
        ["compare", "mine.yaml", "other.yaml", "--controllers", "smc", "--output", "compared"],
        ["campaign", "mine.yaml", "--runs", "2", "--jobs", "1", "--engine", "plain", "--output", "drawn"],
    ):
        run = subprocess.run(
            [sys.executable, "-c", program, *command],
            capture_output=True,
            text=True,
            timeout=120,
            cwd=work,
            env=ENVIRONMENT,
        )
        assert run.returncode == 0, run.stderr
        did = [line.split(" ", 2)[1:] for line in run.stdout.splitlines() if line.startswith("DID")]
        assert any(event == "open" for event, _ in did)
        for event, what in did:
            assert event in ("open", "os.mkdir", "os.rename", "subprocess.Popen"), what
            if event == "subprocess.Popen":  # for the provenance: versions and machine
                assert what in ("git", "uname")
            else:
                assert (work / what).resolve().is_relative_to(work / command[-1]) or what == os.devnull
    found = {p.relative_to(tmp_path).parts[:4] for p in tmp_path.rglob("*")}
    top = {parts[3] for parts in found if len(parts) == 4}
    assert top == {"mine.yaml", "other.yaml", "simulated", "compared", "drawn"}
    assert {p.name for p in tmp_path.iterdir()} == {"a"}


def test_ten_thousand_bad_inputs() -> None:
    """Each of the tests above fails if it has had fewer than it says."""
    assert promised(globals()) >= 10_000
