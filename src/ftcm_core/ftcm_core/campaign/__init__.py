# SPDX-License-Identifier: Apache-2.0
"""Campaigns: one scenario many times, some of its values drawn at random; statistics of the metrics.

Every contender meets the same draws. A run is reproduced exactly by
``ftcm simulate SCENARIO --controller NAME --set ...`` with the list it reports.
"""

from ftcm_core.campaign.plan import Campaign, Run, from_file, is_campaign
from ftcm_core.campaign.running import ENGINES, chosen_engine, read_runs, result_of, run_campaign, run_one
from ftcm_core.campaign.sampling import SAMPLINGS
from ftcm_core.campaign.statistics import table
from ftcm_core.campaign.variation import DISTRIBUTIONS, Variation, parse_variation

__all__ = [
    "DISTRIBUTIONS", "ENGINES", "SAMPLINGS", "Campaign", "Run", "Variation", "chosen_engine", "from_file",
    "is_campaign", "parse_variation", "read_runs", "result_of", "run_campaign", "run_one", "table",
]  # fmt: skip
