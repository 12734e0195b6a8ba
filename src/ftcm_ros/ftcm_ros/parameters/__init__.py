# SPDX-License-Identifier: Apache-2.0
"""The nodes' ROS parameters: their own, and those of controllers, observers and detectors."""
