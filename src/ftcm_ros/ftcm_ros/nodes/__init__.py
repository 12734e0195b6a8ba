# SPDX-License-Identifier: Apache-2.0
"""The nodes: plant, observer, controller, injector, detector, recorder."""

from ftcm_ros.transport.network import require_middleware

require_middleware()  # before rclpy is imported
