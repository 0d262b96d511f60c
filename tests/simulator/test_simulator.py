"""The invariants under drawn faults, and the simulator itself."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from armrig_protocol.messages import Ping

from tests.simulator import campaign, story
from tests.simulator.options import draw
from tests.simulator.rig import simulate

# `.ci/run` tries 1000; test_mutants.py shows that each planted bug is seen in 100.
SEEDS = int(os.environ.get("ARMRIG_SIMULATE_SEEDS", "30"))
FIRST = 244
"""First of 30 seeds in which each fault strikes often enough."""


def test_every_invariant_holds_under_faults() -> None:
    """S1 to S6, A1, L2, R1 and T1; `make simulate SEED=...` shows a failing schedule."""
    done = campaign.run(range(FIRST, FIRST + SEEDS))

    assert not done.violations, [f"make simulate SEED={v[0]}: {v[1:]}" for v in done.violations]
    assert not done.emptiness()
    assert not done.lateness()


def test_a_requested_end_reports_no_fault() -> None:
    """In one seed of the 2500 tried, several frames after the last STOP came together."""
    assert simulate(draw(2327)).violation is None


@pytest.mark.parametrize("tolerates", [True, False])
def test_every_invariant_holds_while_the_emulator_is_stalled(tolerates: bool) -> None:
    """Alone and with its machine, for 20 to 500 ms; its clock stops meanwhile, or does not.

    Times to 0 V are by the device's clock, so no watchdog and no lease is longer.
    """
    done = campaign.run(range(SEEDS // 5), stalls=tolerates)

    assert not done.violations, [(seed, invariant) for seed, invariant, *_ in done.violations]
    assert not done.lateness()
    assert done.faults["stall"] > SEEDS // 2


def test_the_same_seed_gives_the_same_bytes() -> None:
    first, second = simulate(draw(7)), simulate(draw(7))

    assert first == second
    assert simulate(draw(8)).digest != first.digest


def test_writing_a_story_does_not_change_the_outcome(tmp_path: Path) -> None:
    outcome = story.write(draw(7), tmp_path / "7.txt")

    text = (tmp_path / "7.txt").read_text(encoding="utf-8")
    assert outcome == simulate(draw(7))
    assert all(line in text for line in draw(7).lines())
    assert Ping.__name__ in text or "Exchange(" in text


def test_a_campaign_needs_each_cause_of_a_trip() -> None:
    done = campaign.Campaign(schedules=1000, ticks=1, driving=1)

    said = done.emptiness()

    assert all(any(cause in line for line in said) for cause in campaign.TRIPS)
    assert all(any(kind in line for line in said) for kind in campaign.BOUNDS_NS)


def test_a_time_to_0_v_above_the_documented_bound_is_reported() -> None:
    """210 ms after the commander is gone, 110 ms after the link is, at 100 ms and Ts 5 ms."""
    worst = {kind: (ns, 7) for kind, ns in campaign.BOUNDS_NS.items()}
    assert not campaign.Campaign(worst=worst).lateness()

    later = {kind: (ns + 1, 7) for kind, (ns, _) in worst.items()}
    assert len(campaign.Campaign(worst=later).lateness()) == len(worst)
