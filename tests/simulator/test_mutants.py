"""Planted bugs: each must turn a schedule red, or the checks would be blind to it."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

from tests.simulator.mutants import MUTANTS, Mutant, planted
from tests.simulator.options import draw
from tests.simulator.rig import simulate

SEEDS = range(1000, 1100)


@pytest.fixture(autouse=True)
def _no_collector() -> Iterator[None]:
    gc.disable()
    yield
    gc.enable()


def _broken(mutant: Mutant, seed: int) -> str:
    violation = simulate(draw(seed, only=mutant.faults)).violation
    return violation[0] if violation else ""


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda m: m.name)
def test_a_planted_bug_violates_its_invariant(mutant: Mutant) -> None:
    with planted(mutant):
        seed = next((s for s in SEEDS if _broken(mutant, s) in mutant.breaks), None)
    assert seed is not None, f"{mutant.name}: not seen in {len(SEEDS)} schedules"

    assert _broken(mutant, seed) not in mutant.breaks
