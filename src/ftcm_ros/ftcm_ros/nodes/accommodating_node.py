# SPDX-License-Identifier: Apache-2.0
"""A node that policies change: the observer's and the controller's."""

from __future__ import annotations

from typing import Any

from ftcm_core.errors import FtcmError
from ftcm_core.signals import Detection, Measurement
from ftcm_core.simulation.accommodation import Accommodation
from ftcm_ros.nodes.component_node import ComponentNode, decision_message
from ftcm_ros.transport.codec import JointSample
from ftcm_ros.transport.composed import Composition
from ftcm_ros.transport.topics import CHANGES, DETECTION, JOINT_STATES, Topic


class AccommodatingNode(ComponentNode):
    """Hears what the detector said in the tick before, and does its part of what policies make of it.

    Where a scenario has policies, ``detection`` is one more input; it counts for the tick after its own.
    """

    tells = False
    """Whether this node tells what was decided: one of the two does."""

    def __init__(self, kind: str, composition: Composition | None = None) -> None:
        """As of :class:`~ftcm_ros.nodes.component_node.ComponentNode`.

        Raises:
            FtcmError: besides, there are policies and no stamps by which they tell the ticks.
        """
        super().__init__(kind, composition)
        self.count_ticks()
        if self.free is not None and self.scenario.policies:
            raise FtcmError("stamps: free is not possible with policies; leave them out of the scenario")
        self.accommodation: Accommodation | None = None
        self._awaits = bool(self.setting("await_detection")) and bool(self.scenario.policies)
        self._tell_decision = self.plane.publisher(CHANGES) if self.tells else None

    def listen(self, needs: dict[Topic, tuple[str, ...]]) -> None:
        """Besides, what the detector says, where there are policies."""
        super().listen(needs)
        if self.scenario.policies:
            dt_ns = self.scenario.dt_ns

            def take(sample: JointSample) -> None:
                self.take(DETECTION.name, sample._replace(time_ns=sample.time_ns + dt_ns))

            self.subscribe(DETECTION, ("position", "velocity", "effort"), take)

    def require(self, *topics: Topic) -> None:
        """Say which inputs a tick waits for, the last to come last."""
        self.aligner.required = tuple([topic.name for topic in (*[DETECTION] * self._awaits, *topics)])

    def configure(self) -> None:
        """Nothing decided yet; nothing was said before the first tick."""
        super().configure()
        self.accommodation = Accommodation(self.scenario) if self.scenario.policies else None
        if self._awaits:
            self.aligner.put(DETECTION.name, 0, None)

    def accommodated(self, time_ns: int, values: dict[str, JointSample]) -> Measurement:
        """Do what is decided, and return the measurement as the stage is given it."""
        y = Measurement(*values[JOINT_STATES.name][1:])
        accommodation, said = self.accommodation, values.get(DETECTION.name)
        if accommodation is None:
            return y
        tick = time_ns // self.scenario.dt_ns
        found = Detection(said.effort, said.position, said.velocity) if said else None
        decisions = accommodation.hear(tick, found, self.elapsed) if found else []
        for decision in decisions:
            label = self.scenario.policy_labels[decision.number]
            component = accommodation.policies[decision.number].components().get(self.kind)
            if component is not None:
                self.changed_by = label
                self.stage.swap(component)
                self.use(component)
            if self._tell_decision:
                self._tell_decision(decision_message(time_ns, label, decision))
                self.get_logger().warning(
                    f"policy {label} from tick {tick} on: {decision.verdict}, joint {decision.joint}"
                )
        if decisions:
            self.slow(accommodation.pace)
        return accommodation.measured(y, self.elapsed)

    def slow(self, pace: Any) -> None:
        """Let the reference go on at a pace, where this node has it."""
