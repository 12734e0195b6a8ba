# SPDX-License-Identifier: Apache-2.0
"""How the draws of a campaign are spread: at random, or evenly over the space of what varies.

- ``random``: independent draws.
- ``latin_hypercube``: of N runs, each N-th part of each variation's distribution has one (McKay, Beckman,
  Conover 1979). Every variation has a random stream of its own, so that a further one shifts no other.
- ``sobol``: the first N points of a scrambled Sobol sequence (Owen 1998), spread evenly over all variations
  together. Its dimensions are the variations in their order, so that a further one changes all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ftcm_core.campaign.variation import Variation
from ftcm_core.extras import need
from ftcm_core.random_streams import stream_key
from ftcm_core.recording.trace import Array

SAMPLINGS = ("random", "latin_hypercube", "sobol")
_EDGE = 2.0**-53
"""So near a share comes to 0 and 1, where a quantile may be infinite."""


def draws(variations: Sequence[Variation], sampling: str, seed: int, runs: int) -> list[dict[str, str]]:
    """Return what is drawn for every run: path to value, as YAML.

    Args:
        variations: what varies.
        sampling: one of :data:`SAMPLINGS`.
        seed: the campaign's.
        runs: how many.

    Raises:
        FtcmError: scipy is needed and not installed.
    """
    if sampling == "random" or not variations:
        return [{v.path: v.draw(seed, number) for v in variations} for number in range(runs)]
    need("scipy", "statistics", f"sampling {sampling}")
    shares = (_latin_hypercube if sampling == "latin_hypercube" else _sobol)(variations, seed, runs)
    return [
        {v.path: v.quantile(share) for v, share in zip(variations, row)}
        for row in np.clip(shares, _EDGE, 1.0 - _EDGE).tolist()
    ]


def _latin_hypercube(variations: Sequence[Variation], seed: int, runs: int) -> Array:
    """Shares of shape (runs, variations)."""
    from scipy.stats import qmc

    streams = [_stream(seed, v.path) for v in variations]
    return np.hstack([qmc.LatinHypercube(1, seed=stream).random(runs) for stream in streams])


def _sobol(variations: Sequence[Variation], seed: int, runs: int) -> Array:
    """Shares of shape (runs, variations)."""
    from scipy.stats import qmc

    points: Array = qmc.Sobol(len(variations), seed=_stream(seed, "sobol")).random_base2(
        (runs - 1).bit_length()
    )
    return points[:runs]


def _stream(seed: int, name: str) -> np.random.Generator:
    return np.random.default_rng(int(stream_key(seed, f"campaign.{name}")))
