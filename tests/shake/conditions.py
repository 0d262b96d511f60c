"""The conditions under which the suite runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """Disturbance of a run."""

    burners: int = 0
    """Busy processes, each in a session of its own."""
    one_core: bool = False
    """The suite may use one processor only."""
    stop_ms: tuple[int, int] | None = None
    """Shortest and longest time for which a random process of the suite is stopped, in ms."""
    shuffled: bool = False
    """The order of the tests and the workers' shares are drawn."""


CONDITIONS: Final = {
    "quiet": Condition(),
    "busy": Condition(burners=4),
    "one-core": Condition(one_core=True),
    "stopped": Condition(stop_ms=(20, 500)),
    "stopped-200": Condition(stop_ms=(200, 200)),
    "shuffled": Condition(shuffled=True),
}
DRAWN: Final = ("busy", "one-core", "stopped", "shuffled")
"""Conditions of `make shake`: each seed selects one."""
PROOF: Final = {"quiet": 6, "busy": 6, "one-core": 3, "stopped-200": 5}
"""Runs that must pass under each condition before a release."""


def of_seed(seed: int) -> str:
    """Return the name of the condition of a seed."""
    return DRAWN[(seed - 1) % len(DRAWN)]
