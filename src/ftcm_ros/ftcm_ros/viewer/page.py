# SPDX-License-Identifier: Apache-2.0
"""The page in the browser: the arm in the middle, what is said on the left, plots on the right."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ftcm_core.errors import FtcmError
from ftcm_core.registry import components
from ftcm_core.robots import Robot
from ftcm_core.scenario import Scenario, from_mapping
from ftcm_ros.run.view import View
from ftcm_ros.transport.topics import JOINT_STATES, REFERENCE, TRUE_STATE
from ftcm_ros.viewer import tables
from ftcm_ros.viewer.arm import Drawing, drawing, drum_mesh, quaternion, rods_mesh
from ftcm_ros.viewer.history import History, Table
from ftcm_ros.viewer.operating import PAUSE, Operator, fault_order, pause_order, swap_order

PLOT_SECONDS, TEXT_SECONDS = 0.2, 0.5
"""How often plots and texts are sent anew, s; the arm goes with every look."""
PLOT_HEIGHT, AXES = 125, ((26, 50), (58, 18))
"""Of a plot; of its two axes the size, and between two numbers there, px."""
SIDE_WIDTH, PLOTS_WIDTH = 350, 430
"""px"""
PHONE, SHEET = 0.58, 0.45
"""Width by height of what is a phone; the share of its height that viser's sheet at the bottom may have."""
STYLE = (
    "<style>@media (max-width: 36em) {"
    ' [style*="width: 20em"] { width: 100% !important }'
    f' [style*="max-height: 60%"] {{ max-height: {100 * SHEET:g}% !important }}'
    " }</style>"
)
"""Makes viser's sheet as wide as the phone, and leaves more of the arm to be seen."""
VIEW_ANGLE, SEEN = math.radians(45.0), 0.75
"""Of the camera, rad; and how much it shows on each side of the arm's axis, which is 1 long."""
ALL = "all"
LINK, GHOST = (205, 213, 224), (37, 99, 235)
"""Colours of the arm, and of the reference."""
GHOST_OPACITY, GHOST_THICKNESS = 0.3, 0.85
"""Of the reference: it stands in the arm, and is seen where the arm is not."""
WAIT, GO_ON = "pause", "go on"
LEGEND = "Solid: the robot. Blue, see-through: the reference. Orange: a fault acts. Red: alarm."
SWAPPED = ("controller", "observer", "detector")


class Line(NamedTuple):
    """One curve per joint."""

    field: str
    dashed: bool = False


class Plot(NamedTuple):
    """A plot of some signals."""

    title: str
    """With the unit in the place of ``{}``."""
    unit: str
    lines: tuple[Line, ...]
    detector: bool = False
    """Whether only a run with a detector has it; alarms are then shaded."""


PLOTS = (
    Plot("tracking error, {}", "rad", (Line("error"),)),
    Plot("torque, {}: command, dashed: drive", "N·m", (Line("command"), Line("drive", dashed=True))),
    Plot(
        "disturbance, {}: estimate, dashed: true", "N·m", (Line("estimate"), Line("disturbance", dashed=True))
    ),
    Plot("residual, shaded: alarm", "", (Line("residual"),), detector=True),
)


PREFIXES = ((1e-1, 1.0, ""), (1e-4, 1e3, "m"), (1e-7, 1e6, "µ"), (0.0, 1e9, "n"))
"""From which largest value on a factor and its prefix are used; a plot cannot name very small numbers."""


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue of ``#rrggbb``."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


class Arm:
    """An arm in the scene, which moves and changes its colours."""

    def __init__(self, scene: Any, name: str, robot: Robot, shape: Drawing, *, ghost: bool = False) -> None:
        """Draw it.

        Args:
            scene: viser's.
            name: of its place there.
            robot: whose kinematics it has.
            shape: what it looks like.
            ghost: whether it can be seen through, of one colour.
        """
        self._robot, self._ghost = robot, ghost
        look = {"opacity": GHOST_OPACITY, "cast_shadow": False} if ghost else {}
        self._frames: list[Any] = []
        self._links: list[Any] = []
        self._drums: list[Any] = []
        for j, body in enumerate(shape.bodies):
            place = f"{name}/{j}"
            self._frames.append(scene.add_frame(place, show_axes=False))
            if ghost and not j:
                continue  # the base stands where the arm's does
            parts = (
                ("link", rods_mesh(body.rods), self._links),
                ("joint", drum_mesh(body.drum), self._drums),
            )
            for part, mesh, kept in parts:
                shade = GHOST if ghost else LINK
                kept.append(
                    scene.add_mesh_simple(f"{place}/{part}", mesh.vertices, mesh.faces, color=shade, **look)
                )
        self.roots = self._frames
        """With which all of it is removed."""
        self._shown: list[tuple[int, int, int]] = []

    def move(self, q: Sequence[float]) -> None:
        """Move it to joint positions, rad."""
        for handle, frame in zip(self._frames[1:], self._robot.forward_kinematics(tuple(q)) or ()):
            handle.position, handle.wxyz = frame.origin, quaternion(frame)

    def paint(self, marks: Sequence[str]) -> None:
        """Give each joint a colour, and its link too where it is not the joint's own."""
        shown = [rgb(mark or tables.colour(j)) for j, mark in enumerate(marks)]
        if shown != self._shown:
            self._shown = shown
            for j, (drum, link) in enumerate(zip(self._drums[1:], self._links[1:])):
                drum.color = shown[j]
                link.color = shown[j] if marks[j] else LINK


class Plots:
    """The plots of the joints that the user has chosen."""

    def __init__(self, gui: Any, place: Any, joints: Sequence[str], *, detector: bool) -> None:
        """Add them, for all joints.

        Args:
            gui: viser's.
            place: a folder for them.
            joints: names.
            detector: whether the run has a detector.
        """
        self._gui, self._place, self._joints = gui, place, joints
        self._plots = [plot for plot in PLOTS if detector or not plot.detector]
        key = " &nbsp;".join(f"{tables.dot(tables.colour(j))} {name}" for j, name in enumerate(joints))
        with place:
            gui.add_html(tables.block(f"{key} &nbsp;over t, s"))
            self._choice = gui.add_dropdown("joint", (ALL, *joints), initial_value=ALL)
        self._chosen = ""
        self._told: set[str] = set()
        self._shown: list[Plot] = []
        self._handles: list[Any] = []

    def show(self, table: Table) -> None:
        """Send what is kept."""
        if len(table.time) < 2:
            return
        told = {line.field for plot in self._plots for line in plot.lines if table.tells(line.field)}
        if (self._choice.value, told) == (self._chosen, self._told):
            for plot, handle in zip(self._shown, self._handles):
                handle.data, handle.title = self._data(plot, table)
            return
        self._chosen, self._told = self._choice.value, told
        for handle in self._handles:
            handle.remove()
        plots = [
            plot._replace(lines=tuple(line for line in plot.lines if line.field in told))
            for plot in self._plots
        ]
        self._shown = [plot for plot in plots if plot.lines]
        self._handles = [self._add(plot, table) for plot in self._shown]

    def _which(self) -> list[int]:
        return [j for j, name in enumerate(self._joints) if self._chosen in (ALL, name)]

    def _data(self, plot: Plot, table: Table) -> tuple[tuple[Any, ...], str]:
        """Times and curves of a plot, and its title."""
        curves = [table.column(line.field, j) for line in plot.lines for j in self._which()]
        # One that is not a number would take the whole plot away.
        known = np.logical_and.reduce([np.isfinite(curve) for curve in curves])
        factor, prefix = 1.0, ""
        if plot.unit:
            most = max(float(np.abs(curve[known]).max(initial=0.0)) for curve in curves)
            factor, prefix = next((f, name) for least, f, name in PREFIXES if most >= least)
        alarms = [table.column("alarm", j)[known] for j in self._which()] if plot.detector else []
        scaled = [factor * curve[known] for curve in curves]
        return (table.time[known], *scaled, *alarms), plot.title.format(prefix + plot.unit)

    def _add(self, plot: Plot, table: Table) -> Any:
        series: list[dict[str, Any]] = [{"label": "t"}]
        for line in plot.lines:
            for j in self._which():
                one = {"label": self._joints[j], "stroke": tables.colour(j), "width": 1.5}
                series.append({**one, "points": {"show": False}, **({"dash": (5, 4)} if line.dashed else {})})
        scales: dict[str, Any] = {"x": {"time": False}}
        if plot.detector:
            scales["alarm"] = {"range": (0.0, 1.0)}
            shade = {"label": "alarm", "scale": "alarm", "width": 0, "fill": "rgba(220, 38, 38, 0.15)"}
            series += [{**shade, "points": {"show": False}} for _ in self._which()]
        axes = tuple({"size": size, "space": space, "ticks": {"size": 4}} for size, space in AXES)
        data, title = self._data(plot, table)
        with self._place:
            return self._gui.add_uplot(
                data, tuple(series), title=title, scales=scales,
                axes=axes, legend={"show": False}, height=PLOT_HEIGHT, padding=(0, 12, 0, 0),
            )  # fmt: skip


class Controls:
    """Buttons for what may be done to a run."""

    def __init__(self, gui: Any, place: Any, scenario: Scenario, operator: Operator) -> None:
        """Add those that this run offers.

        Args:
            gui: viser's.
            place: a folder for them.
            scenario: the run.
            operator: who carries out what they say.
        """
        self._operator = operator
        self._swaps: dict[str, Any] = {}
        self._in_force: dict[str, str] = {}
        with place:
            self._pause = gui.add_button_group("time", (WAIT, GO_ON), visible=False)
            self._pause.on_click(lambda event: operator.ask(pause_order(event.target.value == WAIT)))
            for kind in SWAPPED:
                part = getattr(scenario, kind)
                if part is not None:
                    names = tuple(components(kind))
                    self._swaps[kind] = gui.add_dropdown(kind, names, initial_value=part.type_name)
                    self._swaps[kind].on_update(lambda event, kind=kind: self._swap(kind, event))
            for label, fault in zip(scenario.fault_labels, scenario.faults):
                actions = ("arm", "clear") if fault.trigger == "hand" else ("clear",)
                if fault.by_hand:
                    buttons = gui.add_button_group(label, actions)
                    buttons.on_click(
                        lambda event, label=label: operator.ask(fault_order(event.target.value, label))
                    )

    def _swap(self, kind: str, event: Any) -> None:
        if event.client_id is not None:  # a user's choice, and not what was put there to be shown
            self._operator.ask(swap_order(kind, event.target.value))

    def look(self, in_force: Mapping[str, str]) -> None:
        """Offer what the nodes offer now.

        Args:
            in_force: names of the components in force, by kind.
        """
        self._pause.visible = self._operator.offered(PAUSE)
        for kind, choice in self._swaps.items():
            name = in_force.get(kind, "")
            if name in choice.options and name != self._in_force.get(kind):
                self._in_force[kind] = choice.value = name


class Page:
    """What is in the browser; nothing of it waits for one."""

    def __init__(self, server: Any, view: View, where: str, operator: Operator | None = None) -> None:
        """Lay it out.

        Args:
            server: viser's.
            view: what is heard of the run.
            where: the domain, in words.
            operator: who carries out what the controls say; None: there are none.
        """
        self._server, self._view, self._where, self._operator = server, view, where, operator
        self._key: tuple[Any, ...] = ()
        self._history = History(0)
        self._solid: Arm | None = None
        self._ghost: Arm | None = None
        self._plots: Plots | None = None
        self._controls: Controls | None = None
        self._of_run: list[Any] = []
        self._shape: Drawing | None = None
        self._due = {"plots": 0.0, "texts": 0.0}
        gui, scene = server.gui, server.scene
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.set_panel_label("ftcm watch")
        gui.main_panel.dock_left()
        gui.main_panel.set_width(SIDE_WIDTH)
        gui.add_html(STYLE)
        self._run = gui.add_html("")
        self._faults = self._titled("faults")
        self._joints = self._titled("joints")
        self._controls_place = gui.add_folder("controls", visible=False)
        self._nodes = self._titled("nodes")
        self._note = gui.add_html(tables.note("The arm and the plots come with a run."))
        panel = gui.add_panel()
        self._tab = panel.add_tab("plots")
        panel.dock_right()
        panel.set_width(PLOTS_WIDTH)
        scene.set_up_direction("+z")
        server.on_client_connect(self._aim)
        with self._controls_place:
            self._said = gui.add_html("")

    def _titled(self, name: str) -> Any:
        with self._server.gui.add_folder(name):
            return self._server.gui.add_html("")

    def show(self, now: float) -> None:
        """Show what has been heard.

        Args:
            now: steady time, s.
        """
        view, key = self._view, (self._view.runs, self._view.joints)
        known = bool(
            view.joints and view.scenario
        )  # else another run begins, of which too little has been heard
        if known and self._key != key:
            self._key = key
            self._begin()
        if known:
            self._keep()
        if not self._server.get_clients():
            return
        with self._server.atomic():
            if known:
                self._draw()
                if self._passed("plots", now, PLOT_SECONDS) and self._plots is not None:
                    self._plots.show(self._history.table())
            if self._passed("texts", now, TEXT_SECONDS):
                self._write(now)

    def _keep(self) -> None:
        """Keep the newest values."""
        view, alarms = self._view, self._view.alarms()
        values = [view.values(joint) for joint in view.joints]
        if view.time is not None and all(math.isfinite(one.error) for one in values):
            self._history.add(view.time, values, [joint in alarms for joint in view.joints])

    def _passed(self, what: str, now: float, seconds: float) -> bool:
        if now < self._due[what]:
            return False
        self._due[what] = now + seconds
        return True

    def _begin(self) -> None:
        """Begin to show another run."""
        view, gui, scene = self._view, self._server.gui, self._server.scene
        for handle in self._of_run:
            handle.remove()
        self._solid = self._ghost = self._controls = None
        self._controls_place.visible = False
        self._history = History(len(view.joints))
        with self._tab:
            folder = gui.add_folder(None)
        self._plots = Plots(gui, folder, view.joints, detector=bool(view.scenario.get("detector")))
        self._of_run = [folder]
        try:
            scenario = from_mapping(view.scenario)
        except FtcmError as error:
            self._note.content = tables.note(f"No arm, no controls: {error}")
            return
        if self._operator is not None:
            self._controls_place.visible = True
            with self._controls_place:
                buttons = gui.add_folder(None)
            self._controls = Controls(gui, buttons, scenario, self._operator)
            self._of_run.append(buttons)
        shape = drawing(scenario.robot)
        thin = drawing(scenario.robot, GHOST_THICKNESS)
        if shape is None or thin is None:
            name = scenario.robot.type_name
            self._note.content = tables.note(f"No arm: robot {name} does not say where its joints are.")
            return
        if tuple(scenario.robot.joint_names) != view.joints:
            self._note.content = tables.note(
                "No arm: the run's joints are not those of its scenario's robot."
            )
            return
        self._note.content = tables.note(LEGEND)
        self._solid = Arm(scene, "/robot", scenario.robot, shape)
        self._ghost = Arm(scene, "/reference", scenario.robot, thin, ghost=True)
        self._of_run += [*self._solid.roots, *self._ghost.roots, self._ground(shape)]

    def _ground(self, shape: Drawing) -> Any:
        """Lay a floor; have everybody look at an arm that is not the one before."""
        if shape != self._shape:
            self._shape = shape
            for client in self._server.get_clients().values():
                self._aim(client)
        size = 4.0 * shape.reach
        return self._server.scene.add_grid(
            "/floor", size, size, cell_size=0.1 * shape.reach, section_size=0.5 * shape.reach,
            cell_color=(232, 234, 238), section_color=(212, 216, 222), position=(0.0, 0.0, shape.floor),
        )  # fmt: skip

    def _aim(self, client: Any) -> None:
        """Have a browser look at the arm: all of it; on a phone above the sheet."""
        shape, camera = self._shape, client.camera
        if shape is None:
            return
        wide = camera.image_width / max(1, camera.image_height)
        away = SEEN * shape.reach / (math.tan(0.5 * VIEW_ANGLE) * min(wide, 1.0))
        middle = shape.floor + 0.55 * shape.reach
        if wide < PHONE:
            middle -= SHEET * math.tan(0.5 * VIEW_ANGLE) * away
        along = (0.66, 0.66, 0.36)
        camera.fov = VIEW_ANGLE
        camera.position = (along[0] * away, along[1] * away, middle + along[2] * away)
        camera.look_at = (0.0, 0.0, middle)

    def _draw(self) -> None:
        view = self._view
        if self._solid is None or self._ghost is None:
            return
        alarms, faulty = view.alarms(), view.faulty()
        for arm, topics in ((self._solid, (TRUE_STATE, JOINT_STATES)), (self._ghost, (REFERENCE,))):
            if (q := view.positions(*topics)) is not None:
                arm.move(q)
        self._solid.paint(
            [tables.ALARM if x in alarms else tables.FAULT if x in faulty else "" for x in view.joints]
        )

    def _write(self, now: float) -> None:
        view = self._view
        self._run.content = tables.run(view, self._where)
        self._nodes.content = tables.nodes(view, now)
        self._faults.content = tables.faults(view)
        self._joints.content = tables.joints(view)
        if self._operator is not None and self._controls is not None:
            self._said.content = tables.answers(tuple(self._operator.answers))
            self._controls.look(view.components)
