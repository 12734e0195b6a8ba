# SPDX-License-Identifier: Apache-2.0
"""The registry: a component is registered once, found by name, and validated at registration."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from ftcm_core.controllers.smc import SMC
from ftcm_core.errors import FtcmError
from ftcm_core.params import param
from ftcm_core.registry import KINDS, Component, components, find, register
from plugins import registry_kept


@pytest.fixture(autouse=True)
def _restore() -> Iterator[None]:
    """What a test registers is gone after it."""
    with registry_kept():
        yield


def test_one_file_per_component() -> None:
    """No module registers two, so that adding a component touches no other."""
    homes = [cls.__module__ for kind in KINDS for cls in components(kind).values()]
    assert len(homes) == len(set(homes))
    assert {home.rpartition(".")[0] for home in homes} == set(KINDS.values())


def test_components_are_sorted_and_found() -> None:
    """By name; the type name is the module's name, so that a reader finds the file."""
    for kind in KINDS:
        found = components(kind)
        assert found, kind
        assert list(found) == sorted(found)
        for name, cls in found.items():
            assert find(kind, name) is cls
            assert cls.__module__.rpartition(".")[2] == name
    assert find("controller", "smc") is SMC


@pytest.mark.parametrize(
    ("kind", "name", "message"),
    [
        ("controller", "scm", "no controller 'scm'; did you mean 'smc'?"),
        ("observer", "xyzzy", "no observer 'xyzzy'; known: "),
        ("fault", "vo_kang_friction", "no fault 'vo_kang_friction'; "),
        ("detector", "residual", "no detector 'residual'; did you mean 'residual_threshold'?"),
        ("plant", "rigidbody", "no plant 'rigidbody'; did you mean 'rigid_body'?"),
        ("contoller", "smc", "no component kind 'contoller'; did you mean 'controller'?"),
    ],
)
def test_unknown_names_get_a_suggestion(kind: str, name: str, message: str) -> None:
    """Kinds do not mix: a disturbance is no fault."""
    with pytest.raises(FtcmError) as error:
        find(kind, name)
    assert message in str(error.value)


def test_register_makes_a_frozen_record() -> None:
    """The decorator does what each file would otherwise repeat."""

    @register("observer", "made_up")
    class MadeUp(Component):
        """Made up."""

        gain: float = param(1.0, unit="-", doc="gain", source="chosen")

    assert find("observer", "made_up") is MadeUp
    assert MadeUp(gain=2).to_mapping() == {"type": "made_up", "gain": 2.0}
    assert MadeUp(gain=2) == MadeUp(gain=2.0)
    assert "made_up" not in components("controller")


def test_register_refuses_a_taken_name() -> None:
    """The message names both modules; the first stays."""
    with pytest.raises(
        FtcmError, match=r"controller 'smc' is registered twice: by .*\.smc and .*test_registry"
    ):

        @register("controller", "smc")
        class Other(Component):
            """Another."""

    assert find("controller", "smc") is SMC


def test_register_refuses_an_undeclared_field() -> None:
    """Every field carries unit, documentation and source."""
    with pytest.raises(FtcmError, match=r"observer 'vague': fields without param\(\.\.\.\): \['gain'\]"):

        @register("observer", "vague")
        class Vague(Component):
            """Vague."""

            gain: float = 1.0

    assert "vague" not in components("observer")


def test_register_refuses_an_unknown_kind() -> None:
    """With a suggestion."""
    with pytest.raises(FtcmError, match=r"no component kind 'observr'; did you mean 'observer'"):
        register("observr", "x")
    with pytest.raises(FtcmError, match=r"no component kind 'observr'"):
        components("observr")
