# SPDX-License-Identifier: Apache-2.0
"""ROS domains for tests: none is used by two workers of pytest-xdist."""

from __future__ import annotations

import os
import random

import pytest

from ftcm_core.errors import FtcmError
from ftcm_ros.transport.domain import DOMAINS, Domain

WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
WORKERS = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
OWN_DOMAINS = DOMAINS[WORKER::WORKERS]
"""Until a test's run has taken a domain, it is free to all: so each worker has domains of its own."""


def free_domain() -> int:
    """A domain of this worker's that nobody on this machine uses."""
    for number in random.sample(OWN_DOMAINS, len(OWN_DOMAINS)):
        try:
            Domain(number).release()  # an experiment that is told this number takes it itself
        except FtcmError:  # in use
            continue
        return number
    pytest.fail("no domain is free")
