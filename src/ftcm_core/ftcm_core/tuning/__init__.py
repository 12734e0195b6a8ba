# SPDX-License-Identifier: Apache-2.0
"""Tuning: parameters of a law and its observer found by trials over the runs of a campaign.

One file per step: :mod:`~ftcm_core.tuning.plan` reads what is tuned, :mod:`~ftcm_core.tuning.trials` measures
a candidate, :mod:`~ftcm_core.tuning.search` chooses candidates with Optuna (extra ``tune``), and
:mod:`~ftcm_core.tuning.running` does it all, and compares before and after on runs that the search has not
seen.
"""

from ftcm_core.tuning.plan import Tuning, tuning_from_file
from ftcm_core.tuning.running import run_tuning, table

__all__ = ["Tuning", "run_tuning", "table", "tuning_from_file"]
