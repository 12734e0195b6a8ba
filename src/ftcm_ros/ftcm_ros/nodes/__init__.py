# SPDX-License-Identifier: Apache-2.0
"""The nodes: plant, observer, controller, injector, detector, recorder."""
