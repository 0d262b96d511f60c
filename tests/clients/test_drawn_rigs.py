"""Drawn rigs: each is understood as its description says, or refused."""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from armrig_core.rig.description import Input, Output
from armrig_daemon import config
from msgspec.structs import replace

from tests import drawn_chains
from tests.drawn_rigs import run

_limits = config.output_limits


def test_a_drawn_rig_is_understood_or_refused() -> None:
    """10 rigs from a fresh seed; `python -m tests.drawn_rigs --count 100` judges a bank."""
    seed = int(np.random.default_rng().integers(1_000_000))
    for i in range(10):
        rig, found = run(seed, i)

        assert not found.wrong, f"seed {seed}, case {i}: {found.wrong}, {rig}"


@pytest.mark.exhaustive
def test_a_drawn_rig_goes_from_its_description_to_a_model() -> None:
    """5 rigs from a fresh seed; `python -m tests.drawn_chains --count 100` judges a bank."""
    seed = int(np.random.default_rng().integers(1_000_000))
    for i in range(5):
        rig, found = drawn_chains.run(seed, i)

        assert not found.wrong, f"seed {seed}, case {i}: {found.wrong}, {rig}"


def _in_counts(outputs: Any, *args: Any) -> Any:
    """Compare values with the counts of the limits."""
    found = _limits(outputs, *args)
    return found and tuple(
        replace(
            limit,
            low=None if limit.low is None else outputs[limit.name].conversion.counts(limit.low),
            high=None if limit.high is None else outputs[limit.name].conversion.counts(limit.high),
        )
        for limit in found
    )


PLANTED = {
    "the offset twice": (Input, "value", lambda self, u: 2 * self.offset + self.per_volt * u),
    "no offset": (Input, "value", lambda self, u: self.per_volt * u),
    "a limit in counts": (config, "output_limits", _in_counts),
    "the wider of two limits": (config.Config, "check_limits", lambda *_: None),
    "an end that is never outside": (Output, "sides_of_rails", ("", "")),
    "a limit that no reading breaks": (Output, "_check_reached", lambda self: None),
}


@pytest.mark.parametrize("bug", PLANTED)
def test_the_judge_sees_a_planted_bug(bug: str) -> None:
    owner, name, value = PLANTED[bug]
    with patch.object(owner, name, value):
        assert any(run(4, i)[1].wrong for i in range(60))
