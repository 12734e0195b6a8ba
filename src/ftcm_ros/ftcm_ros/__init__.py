# SPDX-License-Identifier: Apache-2.0
"""ROS 2 nodes of the fault-tolerant control suite: thin wrappers around ``ftcm_core``."""

__version__ = "0.1.0"
