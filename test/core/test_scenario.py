# SPDX-License-Identifier: Apache-2.0
"""Scenario files: what is read, what is written, and what a mistake is told, in one line with its place."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from ftcm_core.controllers.ftcm import FTCM
from ftcm_core.controllers.smc import SMC
from ftcm_core.errors import ScenarioError
from ftcm_core.limits import Limits
from ftcm_core.params import specs
from ftcm_core.registry import Component
from ftcm_core.scenario import (
    Scenario,
    apply_override,
    from_mapping,
    load,
    parse_yaml,
    replace,
    shipped_scenarios,
)
from ftcm_core.scenario.reading import MAX_FILE_BYTES

TEXT = """\
robot: {type: puma560}
reference: {type: vo_kang_cosine}
controller: {type: ftcm}
observer: {type: do, k1: 20000, k2: 200}
initial_state: {position: 0.0, velocity: 0.0}
injection:
  disturbances:
    - {type: vo_kang_friction}
  faults:
    - type: vo_kang_fault
      start: 10
dt: 0.001
duration: 1
"""
FAULT = "    - type: vo_kang_fault\n      start: 10\n"


def write(folder: Path, text: str | bytes, name: str = "mine.yaml") -> str:
    """Write a scenario file; its path."""
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return str(path)


def edited(old: str, new: str) -> str:
    """The text with one part replaced."""
    assert TEXT.count(old) == 1
    return TEXT.replace(old, new)


def refused(source: str, overrides: list[str] | None = None) -> str:
    """The message a scenario is refused with: one line, and not a long one."""
    with pytest.raises(ScenarioError) as error:
        load(source, overrides or [])
    message = str(error.value)
    assert len(message.splitlines()) == 1
    assert len(message) < 500
    return message


# What is read.


def test_file_is_read_with_defaults(tmp_path: Path) -> None:
    """What is left out has its default; the name is the file's."""
    scenario = load(write(tmp_path, TEXT))
    assert (scenario.name, scenario.dt, scenario.duration, scenario.seed) == ("mine", 0.001, 1.0, 0)
    assert scenario.controller == FTCM()
    assert scenario.observer.values == {"k1": 20000.0, "k2": 200.0}
    assert (scenario.limits, scenario.transient) == (Limits(), 1.0)
    assert (scenario.dt_ns, scenario.last_tick) == (1_000_000, 1000)


def test_shipped_scenarios_load_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From anywhere; a file of that name in the working folder comes first."""
    assert "paper" in shipped_scenarios()
    monkeypatch.chdir(tmp_path)
    for name in shipped_scenarios():
        assert load(name).name == name
    paper = load("paper")
    assert (paper.duration, paper.dt, paper.torque_limits) == (40.0, 0.001, None)
    used = {p.type_name for _, p in paper.parts() if isinstance(p, Component)}
    assert used > {"puma560", "vo_kang_cosine", "ftcm", "do", "vo_kang_friction", "vo_kang_fault"}
    write(tmp_path, TEXT, "paper")
    assert load("paper").duration == 1.0


def test_short_and_missing_parts() -> None:
    """A component may be its name alone; injection and initial state may be left out or null."""
    data: dict[str, Any] = dict(robot="puma560", reference="constant", controller="smc", observer="none")
    short = from_mapping(data)
    assert (short.disturbances, short.faults, short.name) == ((), (), "unnamed")
    assert from_mapping({**data, "injection": None, "initial_state": None}) == short
    assert from_mapping({**data, "injection": {"faults": None, "disturbances": []}}) == short


def test_input_is_left_as_it_is() -> None:
    """Building a scenario does not change the mapping."""
    data = yaml.safe_load(TEXT)
    from_mapping(data)
    assert data == yaml.safe_load(TEXT)


def test_with_controller_and_replace() -> None:
    """Another law has its defaults; the same law is left alone; the whole is validated again."""
    scenario = load("paper", ["controller.upsilon1=10"])
    assert scenario.with_controller("ftcm") is scenario
    assert scenario.with_controller("smc").controller == SMC()
    assert replace(scenario, duration=2).duration == 2.0
    with pytest.raises(ScenarioError, match=r"duration: 0\.0015 s is not a whole number of ticks"):
        replace(scenario, duration=0.0015)
    with pytest.raises(ScenarioError, match="uses the disturbance estimate"):
        load("paper", ["controller=smc", "observer=none"]).with_controller("ftcm")


# What is written.


@pytest.mark.parametrize(
    "overrides",
    [
        [],
        ["controller=pid", "torque_limits=[97.6, 186.4, 89.4]", "seed=9223372036854775807"],
        ["controller={type: nftsmc, varpi: [1, 2, 3]}", "observer=none", "dt=1e-5", "duration=0.1"],
        [
            "reference={type: sine, frequency: 1e-300, amplitude: 1e300}",
            "initial_state.position=[-0.0, 1e-7, 100]",
        ],
        [
            "injection.faults.0={type: vo_kang_fault, profile: incipient, rate: 1e16}",
            "injection.disturbances=[]",
        ],
    ],
)
def test_round_trip(tmp_path: Path, overrides: list[str]) -> None:
    """The file written reads back to an equal scenario, and so does its plain data."""
    scenario = load("paper", overrides)
    text = scenario.to_yaml()
    again = load(write(tmp_path, text))
    assert again == scenario
    assert again.to_yaml() == text
    assert [line.partition(":")[0] for line in text.splitlines()[:2]] == ["name", "robot"]  # as people read
    assert from_mapping(scenario.to_mapping()) == scenario


@pytest.mark.parametrize(
    "name",
    [
        "1e4", "-1e5", ".5e3", "1:30", "0x1", "1_000", "2020-01-01", "yes", "y", "null", "~", "=", "<<",
        "!!int", "&a", "*a", "%", "@", "-", "é", "'", '"', "", "a: b", "# no", "a\nb", " padded ", "\ud800",
        "\u0007", "\u2028",
    ],
)  # fmt: skip
def test_any_name_round_trips(name: str) -> None:
    """Also one that looks like something else in YAML."""
    scenario = replace(load("paper"), name=name)
    data, _ = parse_yaml(scenario.to_yaml(), "written")
    assert data["name"] == name
    assert from_mapping(data) == scenario


def test_written_scenario_has_every_default() -> None:
    """Every parameter of every part, so that a later default changes nothing."""
    mapping = load("paper").to_mapping()
    assert mapping["controller"] == FTCM().to_mapping()
    assert mapping["controller"]["epsilon"] == 1e-4
    assert mapping["torque_limits"] is None
    parts = {"robot", "model", "plant", "reference", "controller", "observer", "detector", "sensor"}
    assert set(mapping) == parts | {"initial_state", "injection", "policies"} | set(specs(Scenario))
    assert mapping["model"] == mapping["robot"]
    assert mapping["plant"] == {"type": "rigid_body", "integrator": "rk4", "substeps": 1}
    assert mapping["detector"] is None


# Mistakes in a file.


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("{type: ftcm}", "{type: fctm}", ":3: controller.type: no controller 'fctm'; did you mean 'ftcm'?"),
        ("{type: ftcm}", "fctm", ":3: controller.type: no controller 'fctm'; did you mean 'ftcm'?"),
        ("{type: ftcm}", "{typ: ftcm}", ":3: controller: has no 'type'; expected e.g. {type: ftcm}"),
        ("{type: ftcm}", "{type: [ftcm]}", ":3: controller.type: ['ftcm'] is not a name"),
        ("{type: ftcm}", "[ftcm]", ":3: controller: ['ftcm'] is not a component; expected a mapping"),
        ("{type: ftcm}", "3", ":3: controller: 3 is not a component"),
        ("controller: {type: ftcm}\n", "", ": controller: is missing; expected e.g. {type: ftcm}"),
        ("controller: {", "contoller: {", ":3: contoller: unknown key; did you mean 'controller'?"),
        ("{type: ftcm}", "null", "controller: is missing"),
        ("{type: ftcm}", "{type: ftcm, upsilon_1: 3}",
         ":3: controller.upsilon_1: unknown key; did you mean 'upsilon1'?"),
        ("{type: ftcm}", "{type: ftcm, 1: 3}", ":3: controller.1: unknown key"),
        ("{type: ftcm}", "{type: ftcm, alpha: 1.5}",
         ":3: controller.alpha: 1.5 is out of range; expected a number or a list with one number per joint "
         "in (0, 1)"),
        ("{type: ftcm}", "{type: ftcm, alpha: .nan}", ":3: controller.alpha: nan is not finite"),
        ("{type: ftcm}", "{type: ftcm, alpha: fast}", ":3: controller.alpha: 'fast' is not a number"),
        ("{type: ftcm}", "{type: ftcm, gamma1: [1, 2]}",
         ":3: controller.gamma1: [1.0, 2.0] has 2 entries; expected one"),
        ("{type: ftcm}", "{type: nftsmc, l: 9}", ":3: controller.l: "),
        ("{type: ftcm}", "{type: nftsmc, l: 4}", ":3: controller.l: 4 is even; expected an odd whole number"),
        ("{type: ftcm}", "{type: nftsmc, l: 4.5}", ":3: controller.l: 4.5 is not a whole number"),
        ("k1: 20000", "k1: 0", ":4: observer.k1: 0 is out of range; expected"),
        ("k1: 20000", "k1: 20 000", ":4: observer.k1: '20 000' is not a number"),
        ("{type: do, k1: 20000, k2: 200}", "none",
         "observer: none, but controller 'ftcm' uses the disturbance estimate; choose an observer, e.g. do"),
        ("position: 0.0", "position: 101", ":5: initial_state.position: 101 is out of range"),
        ("position: 0.0", "positon: 1", ":5: initial_state.positon: unknown key; did you mean 'position'?"),
        ("{position: 0.0, velocity: 0.0}", "[0, 0, 0]", ":5: initial_state: [0, 0, 0] is not a mapping"),
        ("{position: 0.0, velocity: 0.0}", "{position: [0, 0]}", ":5: initial_state.position: "),
        ("  faults:", "  fault:", ":9: injection.fault: unknown key; did you mean 'faults'?"),
        ("      start: 10", "      start: -1", ":11: injection.faults.0.start: -1 is out of range"),
        ("      start: 10", "      begin: 10", ":11: injection.faults.0.begin: unknown key"),
        ("      start: 10", "      profile: abrubt",
         ":11: injection.faults.0.profile: 'abrubt' is not one of abrupt, incipient, ramp, periodic, "
         "intermittent, one_shot; did you mean 'abrupt'?"),
        ("type: vo_kang_fault", "type: vo_kang_friction",
         ":10: injection.faults.0.type: no fault 'vo_kang_friction'; did you mean 'vo_kang_fault'?"),
        ("{type: vo_kang_friction}", "{type: vo_kang_friction, a: [1]}", ":8: injection.disturbances.0.a: "),
        ("    - {type: vo_kang_friction}", "    {type: vo_kang_friction}",
         "injection.disturbances: {'type': 'vo_kang_friction'} is not a list of components"),
        ("    - {type: vo_kang_friction}", "    - 7", ":8: injection.disturbances.0: 7 is not a component"),
        ("dt: 0.001", "dt: 0.2", ":12: dt: 0.2 is out of range; expected a number in [1e-05, 0.1] (s)"),
        ("dt: 0.001", "dt: 0.00123456789", ":12: dt: 0.00123456789 s is not a whole number of nanoseconds"),
        ("dt: 0.001", "dt: 1ms", ":12: dt: '1ms' is not a number in [1e-05, 0.1] (s)"),
        ("dt: 0.001", "dt: 0.0003", ":13: duration: 1 s is not a whole number of ticks of 0.0003 s"),
        ("duration: 1", "duration: 0.0004", ":13: duration: 0.0004 s is not a whole number of ticks"),
        ("duration: 1", "duration: 1e-12", ":13: duration: 1e-12 s is not a whole number of ticks"),
        ("duration: 1", "duration: 100000", ":13: duration: 1e+08 ticks; expected at most 10000000"),
        ("duration: 1", "duration: yes", ":13: duration: True is not a number"),
        ("duration: 1", "duration: 1\nseed: 1.5", ":14: seed: 1.5 is not a whole number"),
        ("duration: 1", "duration: 1\nseed: 9223372036854775808", ":14: seed: "),
        ("duration: 1", "duration: 1\ntorque_limits: [1, 2]", ":14: torque_limits: [1.0, 2.0] has 2 entries"),
        ("duration: 1", "duration: 1\ntorque_limits: none", ":14: torque_limits: 'none' is not a number"),
        ("duration: 1", "duration: 1\nname: 7", ":14: name: 7 is not a text"),
        ("duration: 1", 'duration: 1\n"two\\nlines": 7', ":14: "),
    ],
)  # fmt: skip
def test_mistake_in_a_file(tmp_path: Path, old: str, new: str, message: str) -> None:
    """Place, value, what was expected, and the nearest name."""
    found = refused(write(tmp_path, edited(old, new)))
    assert found.startswith("mine.yaml:")
    assert message in found


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", ": expected a mapping with keys such as robot"),
        ("# nothing yet\n", ": expected a mapping"),
        ("just text", ": expected a mapping"),
        ("- robot: puma560", ": expected a mapping"),
        ("{}", ": robot: is missing"),
        ("? " + "k" * 5000 + "\n: 1", "kkk"),
        ("robot: {type: puma560\ndt: 1\n", ":2: not valid YAML: "),
        ("robot: a\n\trobot: b\n", ":2: not valid YAML: "),
        ("robot: a: b", ":1: not valid YAML: "),
        ("a: 1\n---\nb: 2\n", ":2: not valid YAML: but found another document"),
        ("dt: 1\nrobot: x\ndt: 2\n", ":3: not valid YAML: the key 'dt' is given twice"),
        ("a: 1\nrobot: {type: x, k: 1, k: 1}\n", ":2: not valid YAML: the key 'k' is given twice"),
        ("a: 1\nb: *missing\n", ":2: not valid YAML: found undefined alias 'missing'"),
        ("a: 1\nb: !!python/object/apply:os.getcwd []\n", ":2: not valid YAML: could not determine"),
        ("a: 1\nb: !!python/name:os.getcwd ''\n", ":2: not valid YAML: could not determine"),
        ("a: !mine 3\n", ":1: not valid YAML: could not determine a constructor for the tag '!mine'"),
        ("a: 2020-13-45\n", ""),
        ("? [a, b]\n: c\n", ":1: not valid YAML: "),
        ("a: !!timestamp soon\n", ""),
        ("a: !!int ''\n", ""),
        ("a: !!float ''\n", ""),
        ("a: !!bool perhaps\n", ""),
        ("a: !!map [1]\n", ""),
        ("a: " + ":".join(["1"] + ["00"] * 200) + ".5\n", ""),
        ("robot: 0x" + "f" * 5000, ""),
        ("robot: " + "7" * 5000, ""),
        ("robot: " + "[" * 5000, ": not valid YAML: maximum recursion depth"),
        ("robot: " + "[" * 400 + "]" * 400, ""),
        ("robot: &r [*r]", ":1: robot: [["),
        ("robot: &r {type: *r}", ":1: robot.type: "),
        ("robot: &r {<<: *r}", ""),
        ("robot: x\n\x00", ": not valid YAML: "),
        ("x" * (MAX_FILE_BYTES + 1), f"larger than {MAX_FILE_BYTES} bytes; expected a scenario file"),
        (b"\xff\xfe\x00\x01binary\x80", "not a text file in UTF-8; expected a scenario in YAML"),
        (TEXT.encode("utf-16"), "not a text file in UTF-8"),
    ],
)  # fmt: skip
def test_no_scenario_at_all(tmp_path: Path, text: str | bytes, message: str) -> None:
    """Whatever a file contains, the answer is one short line."""
    found = refused(write(tmp_path, text))
    assert "mine.yaml:" in found
    assert message in found


def test_unreadable_sources(tmp_path: Path) -> None:
    """No such file, a folder, names that cannot be files."""
    assert "no scenario file 'papr'" in refused("papr")
    assert "did you mean 'paper'?" in refused("papr")
    assert "cannot be read" in refused(str(tmp_path))
    for source in ("", "a\0b", "x" * 5000, str(tmp_path / "a\nb")):
        assert repr(source)[:20] in refused(source)[:40]


@pytest.mark.parametrize("levels", [4, 6])
def test_alias_bombs_cost_no_more_than_their_text(tmp_path: Path, levels: int) -> None:
    """Ten lists of ten aliases, nested: neither the places nor the message grow with what they stand for."""
    text = "robot:\n- &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
    for i in range(1, levels):
        text += f"- &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n"
    _, lines = parse_yaml(text, "bomb")
    assert len(lines) <= 2 * len(text)
    assert "mine.yaml:1: robot: [" in refused(write(tmp_path, text))


@pytest.mark.parametrize(
    "value",
    ["[" + "1, " * 5000 + "x]", "{" + ", ".join(f"k{i}: 1" for i in range(5000)) + "}"],
    ids=["list", "mapping"],
)
def test_a_huge_value_is_not_repeated_in_full(tmp_path: Path, value: str) -> None:
    """``refused`` checks the length."""
    assert "mine.yaml:4: observer.k1: " in refused(write(tmp_path, edited("20000", value)))
    assert "mine.yaml:1: robot" in refused(write(tmp_path, edited("{type: puma560}", value)))


def test_suggested_values_are_accepted(tmp_path: Path) -> None:
    """``choose e.g.`` names a value that works."""
    for text in (
        edited("duration: 1", "duration: 1000").replace("dt: 0.001", "dt: 0.0003"),
        edited("duration: 1", "duration: 1234.5679").replace("dt: 0.001", "dt: 0.0003"),
        edited("duration: 1", "duration: 0.00002"),
        edited("dt: 0.001", "dt: 0.0000123456789"),
        edited("dt: 0.001", "dt: 0.00123456789"),
    ):
        message = refused(write(tmp_path, text))
        key, suggested = re.search(r": (\w+): .* choose e.g. (\S+)$", message).groups()  # type: ignore[union-attr]
        fixed = re.sub(rf"(?m)^{key}: .*$", f"{key}: {suggested}", text)
        if key == "dt":
            fixed = re.sub(r"(?m)^duration: .*$", f"duration: {float(suggested) * 1000!r}", fixed)
        load(write(tmp_path, fixed))


@pytest.mark.parametrize("dt", [1e-5, 0.0003, 0.001, 0.0123, 1 / 1024, 0.1])
def test_dt_is_whole_nanoseconds(dt: float) -> None:
    """What the run integrates with is what its stamps say; rounding of the decimal is no matter."""
    data = {**yaml.safe_load(TEXT), "dt": dt, "duration": dt * 100}
    if round(dt * 1e9) == pytest.approx(dt * 1e9, rel=1e-12):
        scenario = from_mapping(data)
        assert scenario.dt_ns / 1e9 == pytest.approx(scenario.dt, rel=1e-15)
        assert scenario.last_tick == 100
    else:
        with pytest.raises(ScenarioError, match="is not a whole number of nanoseconds"):
            from_mapping(data)


# YAML.


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e4", 10000.0),
        ("-1E-3", -0.001),
        ("+.5e1", 5.0),
        ("2.e2", 200.0),
        ("1.0e+4", 10000.0),
        ("1_000", 1000),
        ("0x10", 16),
        ("'1e4'", "1e4"),
        ("1e", "1e"),
        ("e4", "e4"),
        ("1e4s", "1e4s"),
        ("~", None),
        ("[1, 2e0]", [1, 2.0]),
    ],
)
def test_yaml_values(text: str, value: Any) -> None:
    """Numbers as people write them."""
    found, _ = parse_yaml(text, "text")
    assert found == value
    assert type(found) is type(value)


def test_yaml_aliases_and_merge_keys(tmp_path: Path) -> None:
    """One definition may serve twice, and be amended."""
    text = edited(FAULT, "    - &f {type: vo_kang_fault, start: 10}\n    - {<<: *f, start: 20}\n    - *f\n")
    assert [f.start for f in load(write(tmp_path, text)).faults] == [10.0, 20.0, 10.0]


def test_override_of_an_alias_changes_one_place(tmp_path: Path) -> None:
    """The other entry keeps what the file says."""
    text = edited(
        "    - type: vo_kang_fault\n      start: 10\n",
        "    - &f {type: vo_kang_fault, start: 10}\n    - *f\n",
    )
    scenario = load(write(tmp_path, text), ["injection.faults.0.start=5"])
    assert [f.start for f in scenario.faults] == [5.0, 10.0]


def test_places() -> None:
    """Every dotted path has the line its key is on, or its list entry begins on."""
    _, lines = parse_yaml(TEXT, "text")
    assert lines["observer.k2"] == 4
    assert lines["injection.faults"] == 9
    assert lines["injection.faults.0"] == 10
    assert lines["injection.faults.0.start"] == 11


def test_byte_order_mark(tmp_path: Path) -> None:
    """Some editors write one."""
    assert load(write(tmp_path, TEXT.encode("utf-8-sig"))).duration == 1.0


# Overrides.


@pytest.mark.parametrize(
    ("override", "path", "value"),
    [
        ("observer.k1=1e4", "observer.k1", 10000.0),
        (" observer.k1 =10000", "observer.k1", 10000.0),
        ("duration=2", "duration", 2.0),
        ("torque_limits=[1, 2, 3]", "torque_limits", (1.0, 2.0, 3.0)),
        ("torque_limits=null", "torque_limits", None),
        ("controller.gamma1=[1, 2, 3]", "controller.gamma1", (1.0, 2.0, 3.0)),
        ("name=a=b", "name", "a=b"),
        ("initial_state.position=0.5", "initial_state.position", 0.5),
        ("initial_state={velocity: 1}", "initial_state.velocity", 1.0),
        ("injection.faults.0.start=5", "faults.0.start", 5.0),
        ("injection.disturbances.0.a=0", "disturbances.0.a", 0.0),
        ("injection.faults=[]", "faults", ()),
        ("injection.faults.0=vo_kang_fault", "faults.0.start", 10.0),
        ("reference=sine", "reference.frequency", 0.1),
    ],
)
def test_override(override: str, path: str, value: Any) -> None:
    """The dotted paths of the file address its values."""
    found: Any = load("paper", [override])
    for key in path.split("."):
        found = found[int(key)] if key.isdecimal() else getattr(found, key)
    assert found == value


def test_override_of_what_is_not_in_the_file(tmp_path: Path) -> None:
    """Parts in short form or left out can be set too."""
    text = edited("{type: ftcm}", "ftcm").replace("initial_state: {position: 0.0, velocity: 0.0}\n", "")
    scenario = load(write(tmp_path, text), ["controller.pi=0.3", "initial_state.velocity=1", "seed=3"])
    assert scenario.controller == FTCM(pi=0.3)
    assert (scenario.initial_state.velocity, scenario.seed) == (1.0, 3)


def test_setting_another_type_drops_the_parameters_of_the_old() -> None:
    """The same type keeps them; later overrides add to the new type's defaults."""
    kept = load("paper", ["observer.k1=5", "observer.type=do"]).observer
    assert kept.values == {"k1": 5.0, "k2": 200.0}
    smc = load("paper", ["controller.upsilon1=3", "controller.type=smc", "observer.type=none"])
    assert (smc.controller, smc.observer.type_name) == (SMC(), "none")
    assert load("paper", ["controller.type=smc", "controller.c=3"]).controller == SMC(c=3)
    assert load("paper", ["controller.c=3"], controller="smc").controller == SMC(c=3)
    assert load("paper", ["controller.pi=0.3"], controller="ftcm").controller == FTCM(pi=0.3)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("observer.k1", "--set 'observer.k1': expected path=value, e.g. observer.k1=10000"),
        ("", "--set '': expected path=value"),
        ("=3", "--set '=3': expected path=value"),
        ("observer..k1=3", "--set 'observer..k1=3': expected path=value"),
        ("observer.k1=0", "--set: observer.k1: 0 is out of range"),
        ("observer.k3=0", "--set: observer.k3: unknown key; did you mean 'k"),
        ("observer.k1=[1, 2", "--set observer.k1:1: not valid YAML: "),
        ("observer.k1=", "--set: observer.k1: None is not a number"),
        ("controler.c=3", "--set: controler: unknown key; did you mean 'controller'?"),
        ("controller.type=scm", "--set: controller.type: no controller 'scm'; did you mean 'smc'?"),
        ("controller=scm", "--set: controller.type: no controller 'scm'; did you mean 'smc'?"),
        ("type=smc", "type: unknown key"),
        ("injection.faults.1.start=3", "injection.faults has 1 entries, numbered from 0; '1' is not one"),
        ("injection.faults.-1.start=3", "'-1' is not one"),
        ("injection.faults.x=3", "'x' is not one"),
        ("injection.faults." + "9" * 5000 + "=3", "is not one"),
        ("dt.x=3", "--set dt.x: dt is a single value; it has no 'x' inside"),
        ("torque_limits.0=3", "torque_limits is null; set it as a whole first"),
        ("a\nb=3", "unknown key"),
        ("a\nb.c=3", "unknown key"),
        ("observer.k1=0x" + "f" * 5000, "observer.k1"),
        ("duration=0.0015", "--set: duration: 0.0015 s is not a whole number of ticks of 0.001 s"),
    ],
)  # fmt: skip
def test_mistake_in_an_override(override: str, message: str) -> None:
    """Says that it is --set and which path."""
    assert message in refused("paper", [override])


def test_bad_controller_name() -> None:
    """The controller asked for on the command line."""
    for name in ("scm", "[", "", "a: b", "null", "a\nb"):
        with pytest.raises(ScenarioError) as error:
            load("paper", controller=name)
        assert "controller" in str(error.value)
        assert len(str(error.value).splitlines()) == 1


def test_apply_override_in_place() -> None:
    """On plain data."""
    data: dict[str, Any] = {"observer": "do", "list": [{"a": 1}]}
    apply_override(data, "observer.k1=3")
    apply_override(data, "list.0.a=2")
    assert data == {"observer": {"type": "do", "k1": 3}, "list": [{"a": 2}]}


def test_scenarios_are_values() -> None:
    """Equal, hashable, frozen."""
    one, other = load("paper"), load("paper")
    assert one == other
    assert hash(one) == hash(other)
    assert isinstance(one, Scenario)
    with pytest.raises(AttributeError):
        one.dt = 1.0  # type: ignore[misc]
