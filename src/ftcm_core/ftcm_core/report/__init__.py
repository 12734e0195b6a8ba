# SPDX-License-Identifier: Apache-2.0
"""Reports of runs: tables, figures, results folders, and the generated reference page."""
