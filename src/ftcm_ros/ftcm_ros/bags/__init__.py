# SPDX-License-Identifier: Apache-2.0
"""Runs on disk: writing, reading and repairing rosbag2 bags."""
