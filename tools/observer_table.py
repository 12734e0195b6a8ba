# SPDX-License-Identifier: Apache-2.0
"""The table of docs/observers.md: every observer in the paper's experiment, with FTCM.

``python tools/observer_table.py`` runs the rows and prints them; it takes a minute or two.
"""

from __future__ import annotations

import math

import numpy as np

from ftcm_core.recording.trace import Array, Trace
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate

IMPLICIT = "observer.discretisation=implicit"
ROWS = (
    "observer=do",
    "observer=ndo",
    "observer=momentum",
    "observer=eso",
    "observer=kalman",
    "observer=super_twisting",
    f"observer=super_twisting {IMPLICIT}",
    f"observer=super_twisting {IMPLICIT} observer.lipschitz=2000",
    "observer=third_order_smo",
    f"observer=third_order_smo {IMPLICIT}",
    "observer=levant",
    f"observer=levant {IMPLICIT}",
)
"""What to ``--set`` in each row."""
COLUMNS = (
    "error before", "error after", "delay", "error before, encoder", "mean e after", "mean e after, encoder",
)  # fmt: skip
SETTLED, AFTER = 1.0, 11.0
"""Begin of the windows before and after the fault, s: a second after the start, and after the onset."""


def measure(text: str) -> list[list[float]]:
    """Return the columns of a row, each with one number per joint.

    Args:
        text: overrides, separated by spaces.
    """
    exact = simulate(load("paper", text.split()))
    encoder = simulate(load("paper", [*text.split(), "sensor=encoder"]))
    onset = rows(exact, exact.fault_intervals[0].onset)
    settled, after = rows(exact, SETTLED), rows(exact, AFTER)
    found = [
        rms_error(exact, slice(settled, onset)),
        rms_error(exact, slice(after, exact.ticks)),
        delay(exact, onset + 1),
        rms_error(encoder, slice(settled, onset)),
        np.mean(np.abs(exact.error[onset:]), axis=0),
        np.mean(np.abs(encoder.error[onset:]), axis=0),
    ]
    return [column.tolist() for column in found]


def rows(trace: Trace, t: float) -> int:
    """Number of the row at a time, s."""
    return int(np.searchsorted(trace.time_ns, round(t * 1e9)))


def rms_error(trace: Trace, window: slice) -> Array:
    """Root mean square of Δ̂ - Δ, rad/s²."""
    off = trace.lumped_uncertainty_estimate[window] - trace.lumped_uncertainty[window]
    return np.asarray(np.sqrt(np.mean(off**2, axis=0)))


def delay(trace: Trace, first: int) -> Array:
    """Ticks until Δ̂ has made 90 % of the jump of Δ at the fault's onset, ms; NaN if it takes over 0.1 s.

    Args:
        trace: a run.
        first: the first row in which the fault acts; its torque is first seen in the next.
    """
    true, estimate = trace.lumped_uncertainty, trace.lumped_uncertainty_estimate
    before, jump = true[first - 1], true[first] - true[first - 1]
    there = (estimate[first : first + round(0.1 / trace.dt)] - before) / jump >= 0.9
    ticks = np.where(there.any(axis=0), np.argmax(there, axis=0), np.nan)
    return np.asarray(1e3 * trace.dt * ticks)


def markdown(text: str, columns: list[list[float]]) -> str:
    """One row of the page."""
    cells = [" ".join("-" if math.isnan(x) else f"{x:.3g}" for x in column) for column in columns]
    return f"| `{text}` | " + " | ".join(cells) + " |"


def main() -> None:
    """Print the table."""
    print("| `--set` | " + " | ".join(COLUMNS) + " |")
    print("|---" * (len(COLUMNS) + 1) + "|")
    for text in ROWS:
        print(markdown(text, measure(text)), flush=True)


if __name__ == "__main__":
    main()
