# SPDX-License-Identifier: Apache-2.0
"""Replay: run a recorded run again, stage by stage, and compare.

Each stage is given what it received, as recorded, and must give what it sent, as recorded. What it remembers
between ticks is not in a record: it follows from the first tick. So each stage is proved by itself, also in a
real-time run, where inputs come late: what the plant acted with then is found among what was recorded before,
by trying which of it gives the recorded motion.

Where a recorded value is not what its stage gives, or is lost, its readers are tried with what the replay
gives in its place. So one value that was changed is one difference, and a gap in a lockstep run is bridged.

If every stage of every tick is equal, and no input was held, the run is that of
:func:`ftcm_core.simulation.simulate`, float for float.

One file each: :mod:`~ftcm_core.replay.record` (what is known of a run), :mod:`~ftcm_core.replay.answers`
(observer, controller, injector, detector), :mod:`~ftcm_core.replay.plant`, :mod:`~ftcm_core.replay.findings`
(what differs, and why).
"""

from ftcm_core.replay.findings import Difference, Replay, StageFinding, cause, replay, verdict
from ftcm_core.replay.record import Record

__all__ = ["Difference", "Record", "Replay", "StageFinding", "cause", "replay", "verdict"]
