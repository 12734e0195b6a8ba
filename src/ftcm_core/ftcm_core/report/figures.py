# SPDX-License-Identifier: Apache-2.0
"""Figures of runs, one file per quantity, one panel per joint, all runs overlaid.

They show what Figs 2-7 of the paper show. Long runs are drawn as the smallest and largest value of each
short interval, so that chattering keeps its true height. The least smooth run is drawn first and none
hides another; line styles and lightness differ, for print in grey. Needs matplotlib, which is optional.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ftcm_core.errors import chosen
from ftcm_core.recording.trace import ENDED_EARLY, Array, Trace
from ftcm_core.report.panels import MISSING, Curve, detail, grid, legend, log_panel, panel, styled, wider

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Run = tuple[str, Trace]
"""A label and the run it names."""

DETAIL = 30
"""Length of the torque detail, ticks."""
_STYLES: tuple[tuple[str, Any], ...] = (
    ("#e69f00", (0, (1, 1))),
    ("#2f86c1", (0, (5, 1.5))),
    ("#17257a", "-"),
    ("#009e73", (0, (5, 1.5, 1, 1.5))),
    ("#cc79a7", (0, (3, 1, 1, 1, 1, 1))),
    ("#a63c00", (0, (8, 2))),
)
"""Colour (colour-blind safe, of differing lightness) and dashes, by position of the run."""


FORMATS = ("png", "svg", "pdf")
"""File formats of figures."""


def figure_formats(text: str) -> tuple[str, ...]:
    """Read formats of figures that are separated by commas.

    Raises:
        FtcmError: one is not known.
    """
    return chosen("--figure-format", text, FORMATS)


def write_figures(traces: Sequence[Run], folder: Path, formats: Sequence[str] = ("png",)) -> list[Path]:
    """Draw every figure and write it to a folder.

    Args:
        traces: the runs with their labels, in the order of the legend.
        folder: where to; it is made if it does not exist.
        formats: of :data:`FORMATS`.

    Returns:
        The files written.

    Raises:
        FtcmError: matplotlib is not installed.
    """
    written = []
    with styled():
        folder.mkdir(parents=True, exist_ok=True)
        for name, draw in FIGURES.items():
            figure = draw(traces)
            for suffix in formats:
                path = folder / f"{name}.{suffix}"
                figure.savefig(path, dpi=200)
                written.append(path)
    return written


def disturbance(traces: Sequence[Run]) -> Figure:
    """True and estimated lumped uncertainty Δ, rad/s² (Fig 2); a column per run that uses the estimate."""
    runs = _observed(traces)
    joints = _joints(traces)
    figure, axes = grid(joints, len(runs), "Lumped uncertainty Δ: true and estimated")
    for column, (label, trace) in enumerate(runs):
        for j in range(joints):
            curves = _estimate_curves(trace, j)
            panel(axes[j][column], curves, _span([(label, trace)]), [trace])
            if column == 0:
                axes[j][0].set_ylabel(f"{_joint(traces, j)}\nΔ, rad/s²")
        axes[0][column].set_title(_name(label, trace))
    legend(figure, axes)
    return figure


def positions(traces: Sequence[Run]) -> Figure:
    """Positions and the reference, rad (Fig 3)."""
    return _start_and_rest(
        traces,
        "Joint positions",
        "q, rad",
        lambda trace: trace.position,
        reference=lambda t: t.reference_position,
    )


def position_errors(traces: Sequence[Run]) -> Figure:
    """Tracking errors e = q - q_ref, rad (Fig 4)."""
    return _start_and_rest(traces, "Tracking error e = q − q_ref", "e, rad", lambda trace: trace.error)


def position_errors_log(traces: Sequence[Run]) -> Figure:
    """Tracking errors on a logarithmic scale: the largest |e| of each short interval, rad."""
    joints = _joints(traces)
    figure, axes = grid(joints, 1, "Tracking error, logarithmic: largest |e| in each interval")
    for j in range(joints):
        curves = _curves(traces, lambda trace: trace.error, j)
        log_panel(axes[j][0], curves, _span(traces), [t for _, t in traces])
        axes[j][0].set_ylabel(f"{_joint(traces, j)}\n|e|, rad")
    legend(figure, axes)
    return figure


def velocity_errors(traces: Sequence[Run]) -> Figure:
    """Velocity errors, rad/s (Fig 5)."""
    return _start_and_rest(traces, "Velocity error", "ė, rad/s", lambda trace: trace.velocity_error)


def sliding_variable(traces: Sequence[Run]) -> Figure:
    """Sliding variable σ of each law (Fig 6)."""
    return _start_and_rest(
        traces,
        "Sliding variable σ (rad/s; of nftsmc and its kin: rad)",
        "σ",
        lambda trace: trace.sliding_variable,
        absent="no sliding variable",
    )


def torque(traces: Sequence[Run]) -> Figure:
    """Commanded torques, N·m (Fig 7), and a detail of a few ticks."""
    joints = _joints(traces)
    figure, axes = grid(joints, 2, "Torque command", widths=(2.0, 1.0))
    span = _detail_span(traces)
    for j in range(joints):
        curves = _curves(traces, lambda trace: trace.command, j)
        panel(axes[j][0], curves, _span(traces), [t for _, t in traces])
        detail(axes[j][1], curves, span)
        axes[j][0].set_ylabel(f"{_joint(traces, j)}\nu, N·m")
    axes[0][0].set_title("whole run (bands: smallest to largest)")
    axes[0][1].set_title("detail")
    axes[-1][1].set_xlabel(f"ms after {span[0]:g} s")
    legend(figure, axes)
    return figure


def summary(traces: Sequence[Run]) -> Figure:
    """The last joint at a glance: error, torque and its detail, disturbance and estimate."""
    return glance(traces)


def glance(traces: Sequence[Run], joint: int | None = None) -> Figure:
    """One joint, by its number from 0 (the last one by default), at a glance, as of :func:`summary`."""
    j = _joints(traces) - 1 if joint is None else joint
    name = _joint(traces, j)
    figure, axes = grid(2, 2, f"{name}: error, torque, disturbance", height=2.2, hspace=0.42)
    every = [t for _, t in traces]
    errors = _curves(traces, lambda trace: trace.error, j)
    torques = _curves(traces, lambda trace: trace.command, j)
    observed = _observed(traces)[-1:]
    span = _detail_span(traces)
    log_panel(axes[0][0], errors, _span(traces), every)
    panel(axes[0][1], torques, _span(traces), every)
    panel(axes[1][0], [c for _, t in observed for c in _estimate_curves(t, j)], _span(traces), every)
    detail(axes[1][1], torques, span)
    axes[0][0].set_title("tracking error: largest |e|, rad")
    axes[0][1].set_title("torque command, N·m")
    axes[1][0].set_title(
        "lumped uncertainty Δ, rad/s²" + (f" ({_plain(observed[0][0])})" if observed else "")
    )
    axes[1][1].set_title("torque command, detail, N·m")
    axes[1][1].set_xlabel(f"ms after {span[0]:g} s")
    for ax in axes[0]:
        ax.set_xlabel("t, s")
    legend(figure, axes)
    return figure


FIGURES: dict[str, Callable[[Sequence[Run]], Figure]] = {
    "summary": summary,
    "disturbance": disturbance,
    "positions": positions,
    "position_errors": position_errors,
    "position_errors_log": position_errors_log,
    "velocity_errors": velocity_errors,
    "sliding_variable": sliding_variable,
    "torque": torque,
}
"""Every figure by the name of its file."""


def _start_and_rest(
    traces: Sequence[Run],
    title: str,
    unit: str,
    column: Callable[[Trace], Array],
    *,
    reference: Callable[[Trace], Array] | None = None,
    absent: str = MISSING,
) -> Figure:
    """Two columns of panels, each with its own scale: the start; the rest, or the whole with a reference."""
    joints = _joints(traces)
    first, last = _span(traces)
    settled = max((t.scenario.transient if t.scenario else 1.0 for _, t in traces), default=1.0)
    begin = first + (4.0 if last - first > 8.0 * settled else 1.0) * settled
    rest = first if reference or begin >= last else begin
    figure, axes = grid(joints, 2, title, widths=(1.0, 1.6))
    for j in range(joints):
        curves = _curves(traces, column, j)
        if reference:
            look: dict[str, Any] = {
                "label": "reference",
                "colour": "black",
                "dash": (0, (4, 2)),
                "ended_early": False,
            }
            curves += [dataclasses.replace(c, **look) for c in _curves(traces[:1], reference, j)]
        panel(axes[j][0], curves, (first, min(last, first + 2.0 * settled)), (), absent=absent)
        panel(axes[j][1], curves, (rest, last), [t for _, t in traces], absent=absent)
        axes[j][0].set_ylabel(f"{_joint(traces, j)}\n{unit}")
    axes[0][0].set_title("start")
    axes[0][1].set_title("whole run" if rest == first else f"after {rest:g} s, own scale")
    legend(figure, axes)
    return figure


def _curves(traces: Sequence[Run], column: Callable[[Trace], Array], joint: int) -> list[Curve]:
    found = []
    for i, (label, trace) in enumerate(traces):
        if joint >= len(trace.joint_names) or not trace.ticks:
            continue
        colour, dash = _STYLES[i % len(_STYLES)][0], _STYLES[(i + i // len(_STYLES)) % len(_STYLES)][1]
        ended = trace.status in ENDED_EARLY
        found.append(Curve(_name(label, trace), trace.time, column(trace)[:, joint], colour, dash, ended))
    return found


def _name(label: str, trace: Trace) -> str:
    label = _plain(label)
    return label if trace.status == "completed" else f"{label} ({trace.status})"


def _plain(label: str) -> str:
    """Return a label, which may be anything, as one line without formulas."""
    return "".join(c if c.isprintable() else "?" for c in label).replace("$", r"\$")


def _estimate_curves(trace: Trace, joint: int) -> list[Curve]:
    if joint >= len(trace.joint_names) or not trace.ticks:
        return []
    ended = trace.status in ENDED_EARLY
    pairs = (("true", trace.lumped_uncertainty, "#f0a830", "-"),
             ("estimate", trace.lumped_uncertainty_estimate, "#17257a", (0, (4, 2))))  # fmt: skip
    return [Curve(label, trace.time, x[:, joint], colour, dash, ended) for label, x, colour, dash in pairs]


def _observed(traces: Sequence[Run]) -> list[Run]:
    """The runs whose law uses the disturbance estimate; without any, all; at most three."""
    using = [(n, t) for n, t in traces if t.scenario and t.scenario.controller.needs_observer]
    return (using or list(traces))[:3]


def _joints(traces: Sequence[Run]) -> int:
    return max((len(t.joint_names) for _, t in traces), default=1)


def _joint(traces: Sequence[Run], joint: int) -> str:
    return next((t.joint_names[joint] for _, t in traces if joint < len(t.joint_names)), f"joint {joint + 1}")


def _span(traces: Sequence[Run]) -> tuple[float, float]:
    """First and last time of any run, s."""
    recorded = [t.time for _, t in traces if t.ticks]
    if not recorded:
        return 0.0, 1.0
    return min(float(t[0]) for t in recorded), max(float(t[-1]) for t in recorded)


def _detail_span(traces: Sequence[Run]) -> tuple[float, float]:
    """Begin and end of the torque detail: three quarters into the longest run, when all has settled."""
    first, last = _span(traces)
    length = DETAIL * max((t.dt for _, t in traces), default=1e-3)
    begin = max(first, round(first + 0.75 * (last - first) - length, 3))
    return wider(begin, min(begin + length, last))
