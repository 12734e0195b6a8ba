# SPDX-License-Identifier: Apache-2.0
"""The command ``experiment``: it starts the nodes, drives and watches a run, and reports."""

from ftcm_ros.transport.network import require_middleware

require_middleware()  # before rclpy is imported
