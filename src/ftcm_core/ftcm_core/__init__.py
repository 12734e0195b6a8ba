# SPDX-License-Identifier: Apache-2.0
"""ROS-free core of the fault-tolerant control suite: robots, laws, faults, simulation, metrics.

In a program or a notebook::

    import ftcm_core as ftcm
    trace = ftcm.simulate("paper", ["duration=20"], controller="ftcm")
    trace.plot()
    trace.to_pandas().describe()
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ftcm_core.recording.trace import Trace

__version__ = "0.1.0"


def simulate(
    scenario: str = "paper",
    settings: Sequence[str] = (),
    controller: str | None = None,
    *,
    engine: str = "plain",
) -> Trace:
    """Run a scenario, as ``ftcm simulate`` does.

    Args:
        scenario: scenario file, or name of a shipped one.
        settings: changes of it, as of ``--set``: ``["observer.k1=10000"]``.
        controller: use this law, with its defaults.
        engine: ``plain``, or ``compiled`` (numba).

    Returns:
        The run. One that diverges is a result; ``status`` says so.

    Raises:
        FtcmError: the scenario is not valid, or the engine cannot run it.
    """
    from ftcm_core import compiled, simulation
    from ftcm_core.errors import FtcmError
    from ftcm_core.scenario import load

    if engine not in ("plain", "compiled"):
        raise FtcmError(f"engine: {engine!r} is not one of plain, compiled")
    if isinstance(settings, str):
        raise FtcmError(f"settings: {settings!r} is a text; expected a list of texts")
    found = load(scenario, settings, controller)
    return compiled.simulate(found) if engine == "compiled" else simulation.simulate(found)
