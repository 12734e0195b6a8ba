# SPDX-License-Identifier: Apache-2.0
"""How a panel of a figure is drawn: envelopes of long columns, draw order, axis limits, marks, layout."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcm_core.errors import FtcmError
from ftcm_core.recording.trace import Array, Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BINS = 500
"""Intervals per panel; a panel is about as many pixels wide at print size."""
MISSING = "not recorded"
_FEW = 120
"""So few ticks are drawn one by one, even if they chatter."""
_NOTE = 48
"""Letters in a line of a note that fit the narrowest panel."""
_ONSET = "fault onset"
_DECISION = "accommodation"
_BAND = 0.02
"""A run whose envelope is wider than this share of the panel is drawn as a band."""

_RC = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 8.0,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "axes.formatter.limits": (-4, 4),
    "axes.formatter.use_mathtext": True,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "ftcm",
}


@contextlib.contextmanager
def styled() -> Iterator[None]:
    """Have figures look alike, whatever the user's own settings, which come back afterwards.

    Raises:
        FtcmError: matplotlib is not installed.
    """
    try:
        import matplotlib.style
    except ImportError:
        raise FtcmError('figures need matplotlib: pip install "ftcm_core[figures]"') from None
    # Runs that diverge may overflow.
    with matplotlib.style.context(["default", _RC]), np.errstate(over="ignore", invalid="ignore"):
        yield


@dataclasses.dataclass(frozen=True)
class Curve:
    """One line of a panel: a run's column of one joint.

    A run that ended early is drawn, but does not set the axes.
    """

    label: str
    time: Array
    values: Array
    colour: str
    dash: Any
    ended_early: bool


def envelope(time: Array, values: Array, bins: int = BINS) -> tuple[Array, Array, Array]:
    """Reduce a long column to its smallest and largest value in each of ``bins`` intervals.

    Args:
        time: stamps, s, shape (ticks,).
        values: one value per tick; values that are not finite count as absent.
        bins: number of intervals.

    Returns:
        Mid time, smallest and largest value of each interval; NaN where all are absent. A column of
        at most twice as many ticks is returned as it is.
    """
    finite = np.where(np.isfinite(values), values, np.nan)
    if len(time) <= 2 * bins:
        return time, finite, finite
    edges = np.linspace(0, len(time), bins + 1).astype(np.int64)[:-1]
    middle = np.add.reduceat(time, edges) / np.diff(np.append(edges, len(time)))
    return middle, np.fmin.reduceat(finite, edges), np.fmax.reduceat(finite, edges)


def _line(time: Array, values: Array, bins: int = BINS) -> tuple[Array, Array]:
    """The same envelope as one line: both extremes of each interval, in the order in which they are met."""
    t, smallest, largest = envelope(time, values, bins)
    if t is time:
        return t, smallest
    edges = np.linspace(0, len(time), bins + 1).astype(np.int64)
    rising = values[edges[1:] - 1] >= values[edges[:-1]]
    pairs = np.where(
        rising[:, None], np.column_stack([smallest, largest]), np.column_stack([largest, smallest])
    )
    return np.repeat(t, 2), pairs.ravel()


def panel(
    ax: Axes,
    curves: Sequence[Curve],
    span: tuple[float, float],
    marked: Sequence[Trace],
    *,
    step: bool = False,
    absent: str = MISSING,
) -> None:
    """Draw curves over a time span, the roughest first; scale the axis to the runs that completed."""
    drawn: list[tuple[Curve, Array, Array, Array]] = []
    gone: list[str] = []
    for curve in curves:
        rows = slice(*np.searchsorted(curve.time, [span[0] - 1e-9, span[1] + 1e-9]))
        part = dataclasses.replace(curve, time=curve.time[rows], values=curve.values[rows])
        if np.isfinite(part.values).any():
            bins = min(BINS, len(part.time) // 4) if len(part.time) > _FEW else BINS
            drawn.append((part, *envelope(part.time, part.values, bins)))
            _label(ax, curve)
        elif len(part.time):
            gone.append(curve.label)
    ax.set_xlim(*wider(*span))
    _mark_faults(ax, marked)
    if not drawn:
        _say(ax, absent if gone or not curves else "no run is as long as this")
        return
    if gone:
        ax.text(
            0.015, 0.04, textwrap.fill(f"{', '.join(gone)}: {absent}", _NOTE), transform=ax.transAxes,
            color="0.3", fontsize=6.5, zorder=5,
            bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.0},
        )  # fmt: skip
    low, high = _limits(drawn)
    ax.set_ylim(low, high)
    reach = 5.0 * (high - low)
    drawn.sort(key=lambda item: -_roughness(item[2], item[3]))
    for order, (curve, t, *extremes) in enumerate(drawn):
        smallest, largest = (np.clip(x, low - reach, high + reach) for x in extremes)
        look: dict[str, Any] = {"color": curve.colour, "zorder": 3.0 + 0.1 * order}
        if np.nanmedian(largest - smallest) > _BAND * (high - low):
            ax.fill_between(t, smallest, largest, alpha=0.4, linewidth=0.0, **look)
            for edge in (smallest, largest):
                ax.plot(t, edge, linewidth=0.7, linestyle=curve.dash, **look)
        else:
            style = "steps-post" if step else "default"
            t, value = _line(curve.time, curve.values)
            value = np.clip(value, low - reach, high + reach)
            ax.plot(t, value, linewidth=1.2, linestyle=curve.dash, drawstyle=style, **look)
        if curve.ended_early and curve.time[-1] < span[1]:
            ax.axvline(float(curve.time[-1]), linewidth=0.8, linestyle=(0, (1, 2)), **look)


def detail(ax: Axes, curves: Sequence[Curve], span: tuple[float, float]) -> None:
    """Draw a few ticks as they are held, with the time in ms from the begin of the detail."""
    panel(ax, curves, span, (), step=True)
    marks = np.linspace(0.0, span[1] - span[0], 4)
    ax.set_xticks(span[0] + marks)
    ax.set_xticklabels([f"{1e3 * x:.3g}" for x in marks])


def log_panel(ax: Axes, curves: Sequence[Curve], span: tuple[float, float], marked: Sequence[Trace]) -> None:
    """Draw the largest |value| of each interval on a logarithmic axis."""
    ax.set_xlim(*wider(*span))
    _mark_faults(ax, marked)
    drawn = []
    for curve in curves:
        t, _, largest = envelope(curve.time, np.abs(curve.values))
        largest = np.where(largest > 0.0, largest, np.nan)
        if np.isfinite(largest).any():
            drawn.append((curve, t, largest))
            _label(ax, curve)
    if not drawn:
        _say(ax, MISSING)
        return
    sound = [item for item in drawn if not item[0].ended_early]
    shown = np.concatenate([x[np.isfinite(x)] for _, _, x in sound or drawn])
    top = np.percentile(shown, 100.0 if sound else 90.0)
    bottom = max(1e-14, float(np.min(shown)), float(np.percentile(shown, 1.0)) / 30.0)
    low, high = 10.0 ** math.floor(math.log10(bottom) - 0.1), 2.0 * max(float(top), 2.0 * bottom)
    ax.set_yscale("log")
    ax.set_ylim(low, high)
    for curve, t, largest in drawn:
        ax.plot(
            t,
            np.clip(largest, low / 10.0, high * 10.0),
            color=curve.colour,
            linestyle=curve.dash,
            linewidth=1.2,
        )
        if curve.ended_early and curve.time[-1] < span[1]:
            ax.axvline(float(curve.time[-1]), color=curve.colour, linewidth=0.8, linestyle=(0, (1, 2)))


def _limits(drawn: Sequence[tuple[Curve, Array, Array, Array]]) -> tuple[float, float]:
    """Axis limits that hold every completed run; without one, most of the others."""
    sound = [item for item in drawn if not item[0].ended_early]
    shown = np.concatenate([x[np.isfinite(x)] for _, _, *pair in sound or drawn for x in pair])
    low, high = np.percentile(np.clip(shown, -1e12, 1e12), (0.0, 100.0) if sound else (10.0, 90.0)).tolist()
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 1e-6
    return low - margin, high + margin


def _roughness(smallest: Array, largest: Array) -> float:
    """How far a curve is from smooth: the usual height of its envelope, or of its step from tick to tick."""
    height = float(np.nanmedian(largest - smallest))
    steps = np.abs(np.diff(largest))
    steps = steps[np.isfinite(steps)]
    return max(height, float(np.median(steps)) if len(steps) else 0.0)


def wider(first: float, last: float) -> tuple[float, float]:
    """A span as it is, or 1 ms if it has no length."""
    return first, last if last > first else first + 1e-3


def _mark_faults(ax: Axes, traces: Sequence[Trace]) -> None:
    """Ground truth: a line where a fault begins, with its name, and grey up to where one of them ends."""
    first, last = ax.get_xlim()
    names: dict[float, dict[str, None]] = {}
    spans = set()
    for trace in traces:
        for number, onset, end in trace.fault_intervals:
            if trace.scenario is not None and first <= onset < last:
                names.setdefault(onset, {})[trace.scenario.fault_labels[number]] = None
                if end < last:
                    spans.add((onset, end))
    for onset, end in sorted(spans):
        ax.axvspan(onset, end, color="0.5", alpha=0.12, linewidth=0.0, zorder=0.5)
    mark_onsets(ax, names)
    for onset, labels in sorted(names.items()):
        ax.annotate(
            ", ".join(labels), (onset, 1.0), xycoords=("data", "axes fraction"), xytext=(1, -2),
            textcoords="offset points", rotation=90, ha="left", va="top", fontsize=4.5, color="0.35",
        )  # fmt: skip
    for t in sorted({d.tick * trace.dt for trace in traces for d in trace.decisions}):
        if first <= t < last:
            ax.axvline(t, color="C2", linewidth=0.9, linestyle=(0, (4, 1, 1, 1)), zorder=2.4, label=_DECISION)


def mark_onsets(ax: Axes, onsets: Iterable[float]) -> None:
    """Mark the onsets (s) that are within the axis."""
    first, last = ax.get_xlim()
    for onset in sorted(onsets):
        if first <= onset < last:
            ax.axvline(onset, color="0.35", linewidth=0.9, linestyle=(0, (2, 2)), zorder=2.5, label=_ONSET)


def _label(ax: Axes, curve: Curve) -> None:
    """Enter a curve in the legend, as a line, however it is drawn."""
    ax.plot([], [], color=curve.colour, linestyle=curve.dash, linewidth=1.6, label=curve.label)


def _say(ax: Axes, text: str) -> None:
    ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", va="center", color="0.4")
    ax.set_yticks([])


def grid(
    rows: int,
    columns: int,
    title: str,
    *,
    widths: Sequence[float] | None = None,
    heights: Sequence[float] | None = None,
    height: float = 1.75,
    hspace: float = 0.22,
) -> tuple[Figure, list[list[Axes]]]:
    """Make a figure as wide as the text of an A4 page with a grid of panels."""
    from matplotlib.figure import Figure

    columns = max(1, columns)
    tall = rows * height + 1.1
    figure = Figure(figsize=(7.1, tall))
    spacing = figure.add_gridspec(
        rows, columns, width_ratios=widths, height_ratios=heights,
        left=0.115, right=0.985, bottom=0.45 / tall, top=1.0 - 0.85 / tall,
        hspace=hspace, wspace=0.18 if columns > 1 else 0.0,
    )  # fmt: skip
    axes = [[figure.add_subplot(spacing[r, c]) for c in range(columns)] for r in range(rows)]
    for ax in axes[-1]:
        ax.set_xlabel("t, s")
    figure.suptitle(title, y=1.0 - 0.08 / tall, va="top", fontsize=10, fontweight="bold")
    return figure, axes


def legend(figure: Figure, axes: Sequence[Sequence[Axes]]) -> None:
    """One legend below the title, of everything drawn in any panel."""
    entries: dict[str, Any] = {}
    for ax in (ax for line in axes for ax in line):
        for handle, label in zip(*ax.get_legend_handles_labels()):
            entries.setdefault(label, handle)
    for mark in (_ONSET, _DECISION):
        if mark in entries:
            entries[mark] = entries.pop(mark)
    if entries:
        top = 1.0 - 0.27 / figure.get_figheight()
        figure.legend(
            list(entries.values()), list(entries), loc="upper center", bbox_to_anchor=(0.5, top),
            ncol=min(6, len(entries)), frameon=False, handlelength=2.8, columnspacing=1.4, borderaxespad=0.0,
        )  # fmt: skip
