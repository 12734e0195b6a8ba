# SPDX-License-Identifier: Apache-2.0
"""When things happen and how long they take: pacing, statistics, clocks, scheduling."""
