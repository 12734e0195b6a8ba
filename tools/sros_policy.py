# SPDX-License-Identifier: Apache-2.0
"""Generates the SROS2 policy, which lets each process do what it does and nothing else.

``python tools/sros_policy.py config/security/`` writes it; ``--check`` tells whether it is up to date.
"""

from __future__ import annotations

import sys
from xml.etree import ElementTree

from ftcm_ros.parameters.node_parameters import ALL_NODES
from ftcm_ros.run.local_nodes import COMPOSED
from ftcm_ros.run.view import DRAWN, SHOWN, WATCHED
from ftcm_ros.transport.topics import DIAGNOSTICS, TOPICS
from topics_page import write_or_check

FILE = "policy.xml"
_COMMENT = " Generated from the declarations by `python tools/sros_policy.py config/security/`; do not edit. "
PARAMETER_SERVICES = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
LIFECYCLE_SERVICES = (
    "change_state",
    "get_available_states",
    "get_available_transitions",
    "get_state",
    "get_transition_graph",
)
NODE_SERVICES = ("get_type_description", *PARAMETER_SERVICES)
"""Services of every node, under its name."""
NODE_TOPICS = ("/parameter_events", "/rosout")
"""Topics that every node publishes."""
CONDUCTOR = "experiment"
"""The ordinary node that drives the others."""
VIEWER = "watch"
"""The ordinary node that looks at the others."""
DRIVEN = ("change_state", "get_state")
"""Services of the nodes that it calls."""


def rules(name: str) -> dict[tuple[str, str], list[str]]:
    """Return what a process of the suite may do.

    Args:
        name: one of the nodes, ``experiment`` or ``watch``.

    Returns:
        Absolute names by ``("topics", "publish")``, ``("topics", "subscribe")``, ``("services", "reply")``
        and ``("services", "request")``, sorted.
    """
    publish, subscribe = set(NODE_TOPICS), set()
    reply, request = {f"/{name}/{service}" for service in NODE_SERVICES}, set()
    if name == CONDUCTOR:
        subscribe.add(DIAGNOSTICS.name)
        request = {f"/{node}/{service}" for node in ALL_NODES for service in DRIVEN}
    elif name == VIEWER:
        subscribe = {_absolute(topic.name) for topic in (*WATCHED, *SHOWN, *DRAWN)}
    else:
        publish |= {f"/{name}/transition_event", *(_absolute(t.name) for t in TOPICS if name in t.publishers)}
        subscribe = {_absolute(t.name) for t in TOPICS if name in t.subscribers}
        reply |= {f"/{name}/{service}" for service in LIFECYCLE_SERVICES}
    if name == "injector":
        reply.add(f"/{name}/faults/*")  # one for each fault of the scenario
    if name == "plant":
        reply |= {"/plant/pause", "/plant/step"}
    return {
        ("topics", "publish"): sorted(publish),
        ("topics", "subscribe"): sorted(subscribe),
        ("services", "reply"): sorted(reply),
        ("services", "request"): sorted(request),
    }


def processes() -> dict[str, tuple[str, ...]]:
    """Return the nodes of each process that there may be."""
    alone = {name: (name,) for name in (*ALL_NODES, CONDUCTOR, VIEWER)}
    return {**alone, COMPOSED: tuple(name for name in ALL_NODES if name != "recorder")}


def _absolute(topic: str) -> str:
    return topic if topic.startswith("/") else f"/{topic}"


def policy() -> str:
    """Return the policy file: one enclave per process."""
    root = ElementTree.Element("policy", version="0.2.0")
    root.append(ElementTree.Comment(_COMMENT))
    enclaves = ElementTree.SubElement(root, "enclaves")
    for process, nodes in processes().items():
        enclave = ElementTree.SubElement(enclaves, "enclave", path=f"/ftcm/{process}")
        profiles = ElementTree.SubElement(enclave, "profiles")
        for node in nodes:
            profile = ElementTree.SubElement(profiles, "profile", ns="/", node=node)
            for (kind, action), names in rules(node).items():
                if names:
                    expressions = ElementTree.SubElement(profile, kind, {action: "ALLOW"})
                    for expression in names:
                        ElementTree.SubElement(expressions, kind.removesuffix("s")).text = expression
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def main() -> int:
    """Write or check the policy."""
    return write_or_check("tools/sros_policy.py", __doc__, FILE, policy())


if __name__ == "__main__":
    sys.exit(main())
