"""The kind of a drawn nonlinearity is right, or not known."""

from __future__ import annotations

from collections import Counter

import numpy as np

from tests.drawn_nonlinear import RIGS, judged_rig


def test_the_kind_of_a_drawn_rig_is_right_or_not_known() -> None:
    """10 cases from a fresh seed; `python -m tests.drawn_nonlinear` counts 100 of each rig."""
    seed = int(np.random.default_rng().integers(1_000_000))
    names = [*RIGS][1:]
    verdicts = Counter(judged_rig(names[i % len(names)], seed, i)[0] for i in range(10))

    assert verdicts["wrong"] + verdicts["not found"] <= 2, f"seed {seed}: {verdicts}"
    assert verdicts["right"] >= 5, f"seed {seed}: {verdicts}"
