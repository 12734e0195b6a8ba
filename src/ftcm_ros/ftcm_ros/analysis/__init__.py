# SPDX-License-Identifier: Apache-2.0
"""What is computed from a recorded run, and the command ``analyse``."""
