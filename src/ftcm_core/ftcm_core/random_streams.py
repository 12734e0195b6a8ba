# SPDX-License-Identifier: Apache-2.0
"""Random numbers without a generator: the n-th number of a named stream is a pure function.

A stream belongs to one component of one scenario. Adding a stream, or drawing more from one, never
shifts another, and a step that needs noise stays pure: its state is a counter.
"""

from __future__ import annotations

import hashlib
import math

_MASK = (1 << 64) - 1


def stream_key(seed: int, name: str) -> float:
    """Key of a stream: 53 bits of SHA-256 over seed and name, as a float that holds them exactly.

    Args:
        seed: the scenario's seed.
        name: what the stream is for, e.g. ``sensor.encoder``.
    """
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return float(int.from_bytes(digest[:8], "big") >> 11)


def uniform(key: float, counter: float) -> float:
    """Number ``counter`` of a stream, uniform in (0, 1): SplitMix64 (Steele, Lea, Flood 2014).

    Args:
        key: the stream.
        counter: a whole number below 2^53.
    """
    z = ((int(key) << 11) + (int(counter) + 1) * 0x9E3779B97F4A7C15) & _MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _MASK
    return (((z ^ (z >> 31)) >> 12) + 0.5) * 2.0**-52


def gaussian(key: float, counter: float) -> float:
    """Number ``counter`` of a stream, of mean 0 and standard deviation 1: Box and Muller (1958).

    Args:
        key: the stream; do not mix with :func:`uniform` on the same key.
        counter: a whole number below 2^52.
    """
    radius = math.sqrt(-2.0 * math.log(uniform(key, 2.0 * counter)))
    return radius * math.cos(2.0 * math.pi * uniform(key, 2.0 * counter + 1.0))


def gaussian_pair(key: float, counter: float) -> tuple[float, float]:
    """Two independent numbers as of :func:`gaussian`, of the same two uniform ones; the first is that one.

    Args:
        key: as of :func:`gaussian`.
        counter: as of :func:`gaussian`.
    """
    radius = math.sqrt(-2.0 * math.log(uniform(key, 2.0 * counter)))
    angle = 2.0 * math.pi * uniform(key, 2.0 * counter + 1.0)
    return radius * math.cos(angle), radius * math.sin(angle)


def happens(probability: float, key: float, counter: float) -> float:
    """1 with a probability, else 0, as number ``counter`` of a stream decides.

    Args:
        probability: 1 or more: always.
        key: as of :func:`uniform`.
        counter: as of :func:`uniform`.
    """
    return 1.0 if uniform(key, counter) < probability else 0.0
