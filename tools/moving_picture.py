# SPDX-License-Identifier: Apache-2.0
"""Makes the moving picture of the first page: ``python tools/moving_picture.py docs/images/arm.gif``.

The same robot, motion and fault under two laws, from two runs in this process. The fault sets in at 10 s.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.animation import FuncAnimation, PillowWriter

from ftcm_core.robots import Robot
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate

LAWS = {"pid": "PID", "ftcm": "FTCM (Vo & Kang, 2020)"}
FAULT = "injection.faults=[{type: loss_of_effectiveness, start: 10, loss: 0.8, joint: 2}]"
BEGIN, END, START = 8.0, 16.0, 10.0
"""What is shown, and when the fault sets in, s."""
FRAMES_PER_SECOND = 12
COLORS = {"pid": "#b3541e", "ftcm": "#1b6ca8"}
REFERENCE, FAULTY = "#9aa4b2", "#c0143c"


def places(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return base, joints and tip, one row of x, y, z each, m."""
    frames = robot.forward_kinematics(tuple(q.tolist())) or ()
    return np.array([(0.0, 0.0, -0.4), *(frame.origin for frame in frames)])


def main() -> None:
    """Run, draw, write."""
    parser = argparse.ArgumentParser(description="Makes the moving picture of the first page.")
    parser.add_argument("picture", type=Path, help="GIF file to write")
    options = parser.parse_args()
    changes = [f"duration={END}", FAULT]
    scenarios = {law: load("paper", changes, controller=law) for law in LAWS}
    traces = {law: simulate(scenario) for law, scenario in scenarios.items()}
    robot = next(iter(scenarios.values())).robot

    figure = plt.figure(figsize=(8.0, 4.6), dpi=80, layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=(2.6, 1))
    arms = {}
    for column, (law, name) in enumerate(LAWS.items()):
        axes = figure.add_subplot(grid[0, column], projection="3d", computed_zorder=False)
        axes.set_title(name, fontsize=11, color=COLORS[law])
        axes.set(xlim=(-0.1, 0.8), ylim=(-0.35, 0.55), zlim=(-0.42, 0.68))
        axes.set_box_aspect((0.9, 0.9, 1.1), zoom=1.55)
        axes.view_init(elev=18, azim=-60)
        axes.set_axis_off()
        (ghost,) = axes.plot([], [], [], color=REFERENCE, lw=9, alpha=0.55, solid_capstyle="round")
        (arm,) = axes.plot(
            [], [], [], color=COLORS[law], lw=6, solid_capstyle="round", marker="o", ms=9, mfc="white", mew=2
        )
        arms[law] = ghost, arm
    below = figure.add_subplot(grid[1, :])
    below.set(xlim=(BEGIN, END), yscale="log", xlabel="time, s", ylabel="largest |e|, rad")
    below.axvline(START, color=FAULTY, lw=1)
    below.grid(alpha=0.3)
    curves = {}
    for law, trace in traces.items():
        error = np.abs(trace.error).max(axis=1)
        (line,) = below.plot([], [], color=COLORS[law])
        shown = (trace.time >= BEGIN) & (trace.time <= END)
        curves[law] = line, trace.time[shown], np.maximum(error[shown], 1e-9)
    every = np.concatenate([curve[2] for curve in curves.values()])
    below.set_ylim(every.min() / 2, every.max() * 2)
    said = figure.text(0.5, 0.985, "", ha="center", va="top", color=FAULTY, weight="bold")
    times = np.arange(BEGIN, END, 1 / FRAMES_PER_SECOND)

    def draw(t: float) -> None:
        for law, (ghost, arm) in arms.items():
            k = int(np.searchsorted(traces[law].time, t))
            for line, q in ((ghost, traces[law].reference_position[k]), (arm, traces[law].position[k])):
                line.set_data_3d(*places(robot, q).T)
            line, x, y = curves[law]
            line.set_data(x[x <= t], y[x <= t])
        said.set_text("joint 2 has lost\n80 % of its torque" if t >= START else "")

    options.picture.parent.mkdir(parents=True, exist_ok=True)
    FuncAnimation(figure, draw, frames=times.tolist()).save(
        options.picture, writer=PillowWriter(fps=FRAMES_PER_SECOND)
    )
    print(f"{options.picture}: {options.picture.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
