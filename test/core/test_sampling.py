# SPDX-License-Identifier: Apache-2.0
"""How draws are spread: at random as ever, in Latin hypercubes, along Sobol sequences."""

import statistics

import pytest

from ftcm_core import campaign
from ftcm_core.campaign.sampling import draws
from ftcm_core.errors import FtcmError

pytestmark = pytest.mark.pure


def varied(*texts):
    return [campaign.parse_variation(text) for text in texts]


UNIT = varied("a=uniform(0, 1)", "b=uniform(0, 1)", "c=uniform(0, 1)")
BEFORE = [
    ("a.b=uniform(5, 15)", ["12.7418814578894", "6.707428590351498", "7.12704867207398"]),
    ("a.b=loguniform(1e-3, 1e3)", ["44.17015006373597", "0.010579305395726756", "0.018889880183391487"]),
    ("a.b=normal(10, 2)", ["10.683489219582576", "13.51194235098069", "7.183582365102005"]),
    ("a.b=integer(-2, 2)", ["1", "-2", "-1"]),
    ("a.b=choice(x, y, z)", ["z", "x", "x"]),
]
"""What the draws of seed 7 were before there was any other sampling."""


@pytest.mark.parametrize(("text", "expected"), BEFORE)
def test_random_draws_are_what_they_always_were(text, expected):
    assert [x["a.b"] for x in draws(varied(text), "random", 7, 3)] == expected


def test_a_latin_hypercube_has_one_draw_in_every_part():
    pytest.importorskip("scipy", reason="scipy is not installed")
    found = draws(UNIT, "latin_hypercube", 1, 50)
    for path in "abc":
        assert sorted(int(50 * float(x[path])) for x in found) == list(range(50))
    assert len({tuple(x.values()) for x in found}) == 50
    assert found != draws(UNIT, "latin_hypercube", 2, 50)


def test_one_more_variation_shifts_no_other_in_a_latin_hypercube():
    pytest.importorskip("scipy", reason="scipy is not installed")
    three, two = (draws(vary, "latin_hypercube", 1, 8) for vary in (UNIT, UNIT[1:]))
    assert [(x["b"], x["c"]) for x in three] == [(x["b"], x["c"]) for x in two]


def test_a_sobol_sequence_fills_the_square():
    """Of 16 points in the first two dimensions every box of 1/16 has one: 16 x 1, 8 x 2, 4 x 4, ..."""
    pytest.importorskip("scipy", reason="scipy is not installed")
    found = [(float(x["a"]), float(x["b"])) for x in draws(UNIT[:2], "sobol", 1, 16)]
    for across in (1, 2, 4, 8, 16):
        assert len({(int(across * a), int(16 / across * b)) for a, b in found}) == 16


def test_a_sobol_sequence_goes_on_where_a_shorter_one_ends():
    pytest.importorskip("scipy", reason="scipy is not installed")
    assert draws(UNIT, "sobol", 1, 21)[:13] == draws(UNIT, "sobol", 1, 13)
    assert len(draws(UNIT, "sobol", 1, 1)) == 1


@pytest.mark.parametrize("sampling", ["latin_hypercube", "sobol"])
def test_distributions_are_drawn_by_their_quantiles(sampling):
    """Of 64 even draws, each 64th part of a distribution has one, and equal choices have equally many."""
    pytest.importorskip("scipy", reason="scipy is not installed")
    vary = varied("n=normal(10, 2)", "l=loguniform(1, 100)", "i=integer(0, 3)", "c=choice(x, y, z, w)")
    found = draws(vary, sampling, 3, 64)
    for path, between in (("n", statistics.NormalDist(10, 2).inv_cdf), ("l", lambda share: 100.0**share)):
        values = sorted(float(x[path]) for x in found)
        for k in range(1, 64):
            assert values[k - 1] <= between(k / 64) <= values[k]
    for path, expected in (("i", "0123"), ("c", "xyzw")):
        assert all(sum(x[path] == value for x in found) == 16 for value in expected)


def test_what_is_no_sampling_is_refused():
    with pytest.raises(FtcmError, match="sampling: 'sobbol' is none; did you mean 'sobol'"):
        campaign.Campaign("paper", sampling="sobbol")


def test_without_scipy_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(FtcmError, match=r'sampling sobol needs scipy; pip install "ftcm_core\[statistics\]"'):
        draws(UNIT, "sobol", 1, 4)
    assert len(draws(UNIT, "random", 1, 4)) == 4
