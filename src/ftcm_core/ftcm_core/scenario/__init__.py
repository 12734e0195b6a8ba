# SPDX-License-Identifier: Apache-2.0
"""Scenarios: what determines a run, and the files that say it."""

from ftcm_core.scenario.definition import SPEED_LIMIT, InitialState, Scenario, replace
from ftcm_core.scenario.reading import (
    apply_override,
    from_mapping,
    load,
    read_mapping,
    shipped_scenarios,
    with_plugins,
)
from ftcm_core.scenario.yaml_text import parse_yaml

__all__ = [
    "SPEED_LIMIT", "InitialState", "Scenario", "apply_override", "from_mapping", "load", "parse_yaml",
    "read_mapping", "replace", "shipped_scenarios", "with_plugins",
]  # fmt: skip
