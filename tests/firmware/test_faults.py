"""The simulator of faults over the C core: S1 ... S6 judged at its calls of the board layer."""

from __future__ import annotations

import os
from dataclasses import replace

import pytest

from tests.sampling import sampled
from tests.simulator import campaign
from tests.simulator.options import draw
from tests.simulator.rig import simulate
from tests.tools import needs

pytestmark = needs("cc", "make")

# `make simulate CORE=1 SEEDS=10000` tries 10 000.
SEEDS = int(os.environ.get("ARMRIG_SIMULATE_SEEDS", "40"))


@pytest.mark.exhaustive
def test_every_invariant_holds_under_faults() -> None:
    done = campaign.run(range(SEEDS), c_core=True)

    assert not done.violations, [
        f"make simulate CORE=1 SEED={v[0]}: {v[1:]}" for v in done.violations
    ]
    assert not done.emptiness()
    assert not done.lateness()


@pytest.mark.parametrize("seed", sampled(range(5), 2))
def test_a_schedule_of_faults_has_the_same_outcome_as_with_python_firmware(seed: int) -> None:
    options = draw(seed)

    assert simulate(replace(options, c_core=True)) == simulate(options)


@pytest.mark.parametrize("tolerates", sampled([False, True]))
def test_every_invariant_holds_while_the_emulator_is_stalled(tolerates: bool) -> None:
    done = campaign.run(range(SEEDS // 20), stalls=tolerates, c_core=True)

    assert not done.violations
