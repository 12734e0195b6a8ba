# SPDX-License-Identifier: Apache-2.0
"""Properties checked on a stated number of generated inputs.

The inputs are the same in every run. ``FTCM_INPUTS=20`` checks twenty times as many, drawn anew; an input
that then fails becomes an example of its property.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

FACTOR = int(os.environ.get("FTCM_INPUTS", "0"))
NOT_BAD = object()
"""What a check returns for an input that turned out to be a good one: it is not counted."""


def inputs(
    count: int,
    *,
    of: int | None = None,
    examples: tuple[dict[str, Any], ...] = (),
    **strategies: st.SearchStrategy[Any],
) -> Callable[[Callable[..., object]], Callable[[], None]]:
    """Make a check of one input a test of at least ``count`` inputs.

    Args:
        count: inputs to be counted, or the test fails.
        of: how many are generated, where some turn out not to count.
        examples: inputs that failed once, as keyword arguments of the check.
        strategies: what to draw for each argument of the check.
    """

    def decorate(check: Callable[..., object]) -> Callable[[], None]:
        def test() -> None:
            counted = 0

            def one(**drawn: Any) -> None:
                nonlocal counted
                counted += check(**drawn) is not NOT_BAD

            run = given(**strategies)(one)
            for drawn in examples:
                run = example(**drawn)(run)
            settings(
                max_examples=(of or count) * max(1, FACTOR),
                derandomize=not FACTOR,
                database=None,
                deadline=None,
                suppress_health_check=list(HealthCheck),
            )(run)()
            assert counted >= count, f"{counted} inputs were counted; expected {count}"

        test.__name__, test.__doc__ = check.__name__, check.__doc__
        test.count = count  # type: ignore[attr-defined]
        return test

    return decorate


def promised(module: dict[str, Any]) -> int:
    """Return how many inputs the tests of a module check; each fails unless it did."""
    return sum(getattr(test, "count", 0) for name, test in module.items() if name.startswith("test_"))
