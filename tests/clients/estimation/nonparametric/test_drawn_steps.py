"""Numbers of drawn steps agree with the truth, or are not given."""

from __future__ import annotations

import numpy as np

from tests.drawn_steps import judged_step


def test_no_number_of_a_drawn_step_is_surely_wrong() -> None:
    """10 cases from a fresh seed; `python -m tests.drawn_steps` counts the intervals."""
    seed = int(np.random.default_rng().integers(1_000_000))
    for i in range(10):
        judged, settled = judged_step(seed, i)

        assert max(abs(off) for off, _ in judged.values()) < 7, f"seed {seed}, case {i}: {judged}"
        given = {"gain", "tau", "equivalent_time", "settling", "dead_time"} <= judged.keys()
        assert given or not settled, f"seed {seed}, case {i}: {judged}"
