# SPDX-License-Identifier: Apache-2.0
"""The command line ``ftcm``."""

from ftcm_core.cli.main import main

__all__ = ["main"]
