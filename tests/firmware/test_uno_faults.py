"""The simulator of faults over the Uno's binary: S1 ... S6 judged at its pin."""

from __future__ import annotations

import os

import pytest

from tests.simulator import campaign
from tests.tools import needs

pytestmark = needs("cc", "make", "simavr")

# `make simulate UNO=1` tries 200.
SEEDS = int(os.environ.get("ARMRIG_SIMULATE_UNO_SEEDS", "8"))


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["uno", "tclab"])
def test_every_invariant_holds_at_the_pin_under_faults(name: str) -> None:
    done = campaign.run(range(SEEDS), uno=name)

    assert not done.violations, [
        f"make simulate UNO={name} SEED={v[0]}: {v[1:]}" for v in done.violations
    ]
    assert done.seen["S5: the pin had the code that was told"] > 0.4 * done.ticks
    assert done.seen["S4"]
