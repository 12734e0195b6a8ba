# SPDX-License-Identifier: Apache-2.0
"""When a fault acts, and how much of it: triggers, lifetimes and time profiles, on plain floats."""

from __future__ import annotations

import math

from ftcm_core.random_streams import uniform

NEVER = 1e12
"""A time after every run, s: onset of what has not happened, end of what does not end."""


def began(onset: float, t: float, start: float, value: float, above: float, below: float) -> float:
    """Onset of a fault that waits for a condition: once met, that stays.

    Args:
        onset: when it was met, s; :data:`NEVER` if it has not been.
        t: time, s.
        start: up to this it is not looked at, s.
        value: what is compared.
        above: it is met by more than that; infinite: by none.
        below: it is met by less than that; minus infinity: by none.
    """
    if onset < NEVER or t <= start or not (value > above or value < below):
        return onset
    return t


def acts(t: float, onset: float, end: float) -> float:
    """1 for onset < t <= end (s), else 0."""
    return 1.0 if onset < t <= end else 0.0


def incipient(since: float, rate: float) -> float:
    """1 - E^(-ν(t-T_f)) of eq 4.

    Args:
        since: time since the onset, s; up to 0 there is nothing.
        rate: evolution rate ν, 1/s.
    """
    return 0.0 if since <= 0.0 else 1.0 - math.exp(-rate * since)


def ramp(since: float, rise: float) -> float:
    """Growth in proportion to the time since the onset (s), up to 1 after ``rise`` (s)."""
    return 0.0 if since <= 0.0 else min(1.0, since / rise)


def periodic(since: float, period: float, duty: float) -> float:
    """1 for the first ``duty`` of each period (s), else 0."""
    return 1.0 if since > 0.0 and since - period * math.floor(since / period) < duty * period else 0.0


def intermittent(since: float, period: float, duty: float, key: float) -> float:
    """1 or 0, drawn for each period (s) anew: 1 with the probability ``duty``.

    Args:
        since: time since the onset, s.
        period: how long it stays as it is, s.
        duty: probability.
        key: the fault's stream of random numbers; uses those from 2^51 on.
    """
    if since <= 0.0:
        return 0.0
    return 1.0 if uniform(key, 2.0**51 + math.floor(since / period)) < duty else 0.0


def one_shot(since: float, period: float) -> float:
    """A single pulse sin²(π since / period) of ``period`` (s)."""
    if since <= 0.0 or since >= period:
        return 0.0
    x = math.sin(math.pi * since / period)
    return x * x


def tick_number(t: float, dt: float) -> float:
    """Which tick of length dt (s) is at t (s)."""
    return float(math.floor(t / dt + 0.5))


def scaled(psi: float, x: float) -> float:
    """ψ x; zero for ψ = 0, whatever x is."""
    return 0.0 if psi == 0.0 else psi * x


def shifted(psi: float, x: float, y: float) -> float:
    """Sum x + ψ y; x bit for bit for ψ = 0."""
    return x if psi == 0.0 else x + psi * y
