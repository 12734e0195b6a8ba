# SPDX-License-Identifier: Apache-2.0
"""How signals travel between the nodes: topics, bytes, ways in and out, and the network."""
