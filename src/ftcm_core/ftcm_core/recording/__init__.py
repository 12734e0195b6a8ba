# SPDX-License-Identifier: Apache-2.0
"""Recorded runs: traces, their metrics, their files, and where they come from."""
