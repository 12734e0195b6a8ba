# SPDX-License-Identifier: Apache-2.0
"""``python -m ftcm_core.cli``."""

import sys

from ftcm_core.cli.main import main

sys.exit(main())
