# SPDX-License-Identifier: Apache-2.0
"""Values drawn at random: the distributions, and how they are written.

Every varied path has a random stream of its own, seeded from (campaign seed, path), and run n takes its
n-th number: a further variation shifts no other. Samples that are spread evenly
(:mod:`ftcm_core.campaign.sampling`) take the values of their quantiles instead.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from statistics import NormalDist

from ftcm_core.errors import FtcmError, shown, suggestion
from ftcm_core.random_streams import gaussian, stream_key, uniform


@dataclass(frozen=True)
class Variation:
    """One varied value of the scenario."""

    path: str
    """Dotted path, as of ``--set``."""
    kind: str
    """One of :data:`DISTRIBUTIONS`."""
    arguments: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.path}={self.kind}({', '.join(self.arguments)})"

    def draw(self, seed: int, run: int) -> str:
        """Return the value of one run as YAML.

        Args:
            seed: the campaign's.
            run: number of the run, from 0.
        """
        key = stream_key(seed, f"campaign.{self.path}")
        if self.kind == "normal":
            mean, deviation = map(float, self.arguments)
            return repr(mean + deviation * gaussian(key, run))
        return self.quantile(uniform(key, run))

    def quantile(self, share: float) -> str:
        """Return the value that a share of all draws lies below, as YAML; choices have equal shares.

        Args:
            share: in (0, 1).
        """
        return DISTRIBUTIONS[self.kind][1](self.arguments, share)


def _uniform(arguments: Sequence[str], share: float) -> str:
    low, high = map(float, arguments)
    return repr(low + (high - low) * share)


def _loguniform(arguments: Sequence[str], share: float) -> str:
    low, high = (math.log(float(x)) for x in arguments)
    return repr(math.exp(low + (high - low) * share))


def _normal(arguments: Sequence[str], share: float) -> str:
    mean, deviation = map(float, arguments)
    return repr(mean + deviation * NormalDist().inv_cdf(share))


def _integer(arguments: Sequence[str], share: float) -> str:
    low, high = map(int, arguments)
    return str(min(high, low + int((high - low + 1) * share)))


def _choice(arguments: Sequence[str], share: float) -> str:
    return arguments[min(len(arguments) - 1, int(len(arguments) * share))]


DISTRIBUTIONS: dict[str, tuple[str, Callable[[Sequence[str], float], str]]] = {
    "uniform": ("uniform(LOW, HIGH)", _uniform),
    "loguniform": ("loguniform(LOW, HIGH), LOW > 0", _loguniform),
    "normal": ("normal(MEAN, DEVIATION), DEVIATION >= 0", _normal),
    "integer": ("integer(LOW, HIGH), both included", _integer),
    "choice": ("choice(VALUE, VALUE, ...)", _choice),
}
"""Distributions by name: how to write one, and its quantile function."""


def parse_variation(text: str) -> Variation:
    """Parse ``path=distribution(...)``.

    Raises:
        FtcmError: it is not one, with what was expected.
    """
    path, equals, rest = text.partition("=")
    match = re.fullmatch(r"\s*([A-Za-z_]+)\s*\((.*)\)\s*", rest, re.DOTALL)
    if not equals or not path.strip() or match is None:
        raise FtcmError(
            f"--vary {shown(text)}: expected path=distribution(...), e.g. observer.k1=uniform(1e4, 2e4)"
        )
    kind, inner = match[1], match[2]
    if kind not in DISTRIBUTIONS:
        raise FtcmError(f"--vary {path}: no distribution {shown(kind)}; {suggestion(kind, DISTRIBUTIONS)}")
    arguments = tuple(_split(inner))
    variation = Variation(path.strip(), kind, arguments)
    if not _fits(kind, arguments):
        raise FtcmError(f"--vary {path}: {shown(rest.strip())} is not {DISTRIBUTIONS[kind][0]}")
    return variation


def _split(text: str) -> Iterator[str]:
    """Arguments between commas that are in no bracket."""
    depth, begin = 0, 0
    for i, character in enumerate(text + ","):
        depth += (character in "([{") - (character in ")]}")
        if character == "," and depth == 0:
            yield text[begin:i].strip()
            begin = i + 1


def _fits(kind: str, arguments: Sequence[str]) -> bool:
    if kind == "choice":
        return len(arguments) > 0 and all(arguments)
    try:
        first, second = (int(x) if kind == "integer" else float(x) for x in arguments)
    except ValueError:
        return False
    if not (math.isfinite(first) and math.isfinite(second)) or abs(first) > 2**52 or abs(second) > 2**52:
        return False
    if kind == "normal":
        return second >= 0.0
    return first <= second and (kind != "loguniform" or first > 0.0)
