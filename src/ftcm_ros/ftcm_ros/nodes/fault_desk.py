# SPDX-License-Identifier: Apache-2.0
"""What a node has to do with the faults that act at its place: it takes orders, and tells when they act.

The injector also answers for all of them: its services list, arm and clear the faults of a run.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ftcm_core.faults.timing import NEVER
from ftcm_core.scenario import Scenario
from ftcm_core.signals import NANOSECONDS, seconds
from ftcm_ros.nodes.suite_node import SuiteNode
from ftcm_ros.transport.plane import qos
from ftcm_ros.transport.topics import FAULT_ORDERS, FAULTS, faults_at

LOOK_NS = NANOSECONDS // 10
"""How often, in time of the run, a node looks whether a condition has been met."""
ACTIONS = ("arm", "clear")


class FaultDesk:
    """The faults at a node's place."""

    def __init__(self, node: SuiteNode, next_tick: Callable[[], int], places: tuple[str, ...] = ()) -> None:
        """Subscribe to orders, where there may be any.

        Args:
            node: whose faults they are; its ``stage`` has them.
            next_tick: number of the tick that the next step of the stage is.
            places: nodes at whose places they act; none: this one's.
        """
        self._node: Any = node
        self._next_tick = next_tick
        scenario = node.scenario
        places = places or (node.name_in_suite,)
        self.mine = tuple(n for place in places for n in faults_at(scenario, place))
        self._labels = scenario.fault_labels
        self._known: dict[int, tuple[float, float]] = {}
        waiting = any(scenario.faults[n].trigger == "condition" for n in self.mine)
        self._look_ns = 0 if waiting else NEVER
        self._publish = node.plane.publisher(FAULTS) if self.mine else None
        if "injector" not in places and any(scenario.faults[n].by_hand for n in self.mine):
            # Not by the data plane: its readers must not be waited for by who publishes.
            node.create_subscription(String, FAULT_ORDERS.name, self._on_order, qos(FAULT_ORDERS))

    def begin(self) -> None:
        """Tell from when to when each fault will act, as far as is known; a run begins."""
        self._known = {}
        self._look_ns = min(self._look_ns, 0) if self._look_ns < NEVER else self._look_ns
        self.tell(0)

    def look(self, time_ns: int) -> None:
        """Tell of conditions that have been met, if it is time to look."""
        if time_ns >= self._look_ns:
            self._look_ns = time_ns + LOOK_NS
            self.tell(time_ns // self._node.scenario.dt_ns)

    def tell(self, tick: int, action: str = "") -> None:
        """Publish what has been decided since the last time.

        Args:
            tick: number of the tick.
            action: the order that has decided it; empty: the scenario, or a condition.
        """
        if self._publish is None:
            return
        for number, phase in self._node.stage.phases().items():
            if self._known.get(number) != phase:
                self._known[number] = phase
                self._publish(event_message(self._node.scenario, tick, number, phase, action))

    def order(self, number: int, action: str) -> None:
        """Arm or clear a fault of this place, from the next tick on; by whoever may touch the stage."""
        tick = self._next_tick()
        self.tell(tick)
        self._node.stage.order(number, action, seconds(tick * self._node.scenario.dt_ns))
        self.tell(tick, action)

    def _on_order(self, message: String) -> None:
        action, _, label = message.data.partition(" ")
        if self._node.active and action in ACTIONS and label in self._labels:
            number = self._labels.index(label)
            if number in self.mine:
                self._node.on_main_thread(lambda: self.order(number, action))


class FaultServices:
    """Services ``~/faults/list``, and ``~/faults/LABEL/arm`` and ``clear`` of every fault.

    The injector has them, or the plant where it adds the disturbances itself.
    """

    def __init__(self, node: SuiteNode, desk: FaultDesk) -> None:
        """Offer them for the faults of the scenario."""
        self._node, self._desk, self._scenario = node, desk, node.scenario
        self._labels = self._scenario.fault_labels
        self._phases: dict[str, tuple[float, float]] = {}
        """From when to when each fault acts, as its node has told."""
        if not self._labels:
            return
        node.create_subscription(DiagnosticArray, FAULTS.name, self._on_event, qos(FAULTS))
        self._order = node.plane.publisher(FAULT_ORDERS)
        node.create_service(Trigger, "~/faults/list", self._list)
        for number, label in enumerate(self._labels):
            for action in ACTIONS:
                node.create_service(Trigger, f"~/faults/{label}/{action}", self._answering(number, action))

    def _on_event(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {v.key: v.value for v in status.values}
            self._phases[status.name] = float(values["onset"]), float(values["end"])

    def _list(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        lines = []
        for label, fault in zip(self._labels, self._scenario.faults):
            joint = getattr(fault, "joint", None)
            where = fault.site + (f", joint {joint}" if joint else "")
            how = f"trigger {fault.trigger}, lifetime {fault.lifetime}"
            lines.append(f"{label}: {where}; {how}; {acting(*self._phases.get(label, fault.planned()))}")
        response.success, response.message = True, "\n".join(lines)
        return response

    def _answering(
        self, number: int, action: str
    ) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        label, fault = self._labels[number], self._scenario.faults[number]

        def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            response.success = False
            if not self._node.active:
                response.message = "no run is on; expected the node to be active"
            elif not fault.by_hand:
                response.message = (
                    f"{label} has trigger {fault.trigger} and lifetime {fault.lifetime}; expected trigger: "
                    "hand or lifetime: until_cleared in the scenario"
                )
            elif action == "arm" and fault.trigger != "hand" and not self._begun(label):
                response.message = (
                    f"{label} has trigger {fault.trigger}; expected trigger: hand in the scenario"
                )
            else:
                if number in self._desk.mine:
                    self._node.on_main_thread(lambda: self._desk.order(number, action))
                else:
                    self._order(String(data=f"{action} {label}"))
                response.success = True
                response.message = f"{action} {label}: ordered; /faults tells from which tick on"
            return response

        return answer

    def _begun(self, label: str) -> bool:
        return self._phases.get(label, (NEVER, NEVER))[0] < NEVER


def acting(onset: float, end: float) -> str:
    """From when to when a fault acts, in words."""
    if onset >= NEVER:
        return "waits"
    return f"acts from t = {onset:g} s" + ("" if end >= NEVER else f" to {end:g} s")


def event_message(
    scenario: Scenario, tick: int, number: int, phase: Iterable[float], action: str
) -> DiagnosticArray:
    """Describe from when to when a fault acts.

    Args:
        scenario: the run.
        tick: in which it was decided.
        number: place of the fault in the scenario's list.
        phase: onset and end, s.
        action: ``arm`` or ``clear`` by hand; empty: by the scenario, or a condition.
    """
    fault, label = scenario.faults[number], scenario.fault_labels[number]
    onset, end = phase
    values: dict[str, Any] = {
        "number": number, "tick": tick, "onset": onset, "end": end, "action": action, "site": fault.site,
        "fault": fault.to_mapping(),
    }  # fmt: skip
    text = {"arm": "armed by hand: ", "clear": "cleared by hand: "}.get(action, "")
    status = DiagnosticStatus(
        level=DiagnosticStatus.OK,
        name=label,
        message=text + acting(onset, end),
        hardware_id=fault.site,
        values=[KeyValue(key=k, value=v if isinstance(v, str) else json.dumps(v)) for k, v in values.items()],
    )
    array = DiagnosticArray(status=[status])
    array.header.stamp.sec, array.header.stamp.nanosec = divmod(tick * scenario.dt_ns, NANOSECONDS)
    return array
