"""Planted bugs: each must turn a schedule red, or the checks would be blind to it."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

from tests.simulator.mutants import DESIGN, MUTANTS, Mutant, planted
from tests.simulator.options import draw
from tests.simulator.rig import simulate

MOST = 40


@pytest.fixture(autouse=True)
def _no_collector() -> Iterator[None]:
    gc.disable()
    yield
    gc.enable()


def _broken(mutant: Mutant, seed: int) -> str:
    violation = simulate(draw(seed, only=mutant.faults)).violation
    return violation[0] if violation else ""


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda m: m.name)
def test_a_planted_bug_is_seen(mutant: Mutant) -> None:
    with planted(mutant.plant, *mutant.without):
        seeds = range(mutant.first, mutant.first + MOST)
        seed = next((s for s in seeds if _broken(mutant, s) in mutant.breaks), None)
    assert seed is not None, f"{mutant.name}: not seen in {MOST} schedules"

    with planted(*mutant.without):
        assert _broken(mutant, seed) not in mutant.breaks


@pytest.mark.parametrize("mutant", [m for m in MUTANTS if m.without], ids=lambda m: m.name)
def test_a_bug_that_another_guard_covers_is_masked_by_it(mutant: Mutant) -> None:
    with planted(mutant.plant):
        broken = {_broken(mutant, seed) for seed in range(mutant.first, mutant.first + 2)}

    assert not broken & mutant.breaks


def test_the_bugs_of_the_design_come_first() -> None:
    """All thirteen, in its order."""
    assert [m.name for m in MUTANTS[:DESIGN]] == [
        "freshness by the time of arrival",
        "no boot nonce",
        "no CRC",
        "what is no code is let through (NaN, an integer beyond u16)",
        "no lease",
        "any owner",
        "no staleness",
        "no firmware timeout",
        "replay of a frame accepted",
        "silent gap",
        "wrong scale in the host",
        "no pause detection",
        "no firmware clamp",
    ]
