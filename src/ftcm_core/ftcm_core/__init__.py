# SPDX-License-Identifier: Apache-2.0
"""ROS-free core of the fault-tolerant control suite: robots, laws, faults, simulation, metrics."""

__version__ = "0.1.0"
