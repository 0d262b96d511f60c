"""A thousand simulated rigs: capacity of a lab's router and recorder, and their longest outage.

`python -m tests.benchmarks.scale` prints the figures of docs/scale.md. The options are the costs of
one message, measured by fleet.py. The rest follows by a simulation of rates: in steps of 0.2 s each
rig adds messages to its cache, which discards the oldest beyond 2 MiB. If the recorder is connected
it takes as many messages as its processor allows, rig after rig, 64 KiB each.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from armrig_core.history import REPLY_LIMIT
from armrig_core.telemetry import SAMPLE_LENGTH
from armrig_daemon.service.history import MOST_BYTES
from numpy.typing import NDArray

STEP_S = 0.2
KEPT = MOST_BYTES // SAMPLE_LENGTH
"""Samples in a daemon's cache."""
PIECE = -(-REPLY_LIMIT // SAMPLE_LENGTH)
"""Samples in an answer."""
_LAB_HOURS = 8.0
_AWAY_S = 5.0
_WIRE = SAMPLE_LENGTH + 5  # B of a sample in an answer


@dataclass(frozen=True, slots=True, kw_only=True)
class Costs:
    """Costs of one message."""

    recorder_us: float
    """Time of one processor, because its interpreter runs one thread at a time."""
    router_us: float
    disk_bytes: float

    @property
    def most_per_s(self) -> float:
        """Messages that one recorder takes a second."""
        return 1e6 / self.recorder_us


def lost(rates: NDArray[np.float64], most_per_s: float, away_s: float, after_s: float) -> int:
    """Return how many messages are lost when the recorder is away once, for `away_s`.

    Parameters
    ----------
    rates : ndarray (R,)
        Of each rig, in messages a second.
    most_per_s : float
        What the recorder can take of all together.
    after_s : float
        How long it is looked at after that.
    """
    waiting = np.zeros(rates.size)
    gone = 0.0
    for step in range(round((away_s + after_s) / STEP_S)):
        waiting += rates * STEP_S
        over = np.maximum(waiting - KEPT, 0.0)
        gone += over.sum()
        waiting -= over
        if (step + 1) * STEP_S > away_s:
            waiting = _taken(waiting, most_per_s * STEP_S)
    return round(gone)


def level_after_s(rates: NDArray[np.float64], most_per_s: float, away_s: float) -> float:
    """Return how long after `away_s` nothing waits any more but what has just come."""
    if rates.sum() >= most_per_s:
        return float("inf")
    waiting, steps = np.minimum(rates * away_s, KEPT), 0
    while waiting.sum() > 1.0:
        waiting = _taken(waiting + rates * STEP_S, most_per_s * STEP_S)
        steps += 1
    return steps * STEP_S


def _taken(waiting: NDArray[np.float64], budget: float) -> NDArray[np.float64]:
    """Return the messages that wait after a step: a piece of each rig in turn, again and again."""
    left = waiting.copy()
    while budget > 0 and left.any():
        share = np.minimum(left, PIECE)
        taken = share * min(1.0, budget / share.sum())
        left -= taken
        budget -= taken.sum()
        left[left < 1e-6] = 0.0
    return left


def longest_away_s(rates: NDArray[np.float64], most_per_s: float) -> float:
    """Return for how long the recorder may be away, to 0.2 s, with nothing lost."""
    if rates.sum() >= most_per_s:
        return 0.0
    low, high = 0, round(KEPT / rates.max() / STEP_S) + 1
    while high - low > 1:
        middle = (low + high) // 2
        fits = lost(rates, most_per_s, middle * STEP_S, 2 * KEPT / rates.max()) == 0
        low, high = (middle, high) if fits else (low, middle)
    return low * STEP_S


def main() -> None:
    """Print a line for each kind of lab."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--labs", type=int, default=30)
    parser.add_argument("--rigs", type=int, default=1000)
    parser.add_argument("--recorder-us", type=float, default=19.3)
    parser.add_argument("--router-us", type=float, default=2.2)
    parser.add_argument("--disk-bytes", type=float, default=61.5)
    given = parser.parse_args()
    costs = Costs(
        recorder_us=given.recorder_us, router_us=given.router_us, disk_bytes=given.disk_bytes
    )
    a_lab = -(-given.rigs // given.labs)
    print(f"a recorder takes {costs.most_per_s:.0f} messages/s; a daemon keeps {KEPT} samples")
    rng = np.random.default_rng(1)
    mixed = rng.choice([100.0, 500.0, 1000.0], size=given.rigs, p=[0.8, 0.1, 0.1])
    kinds = {
        "lab, all at 100 Hz": np.full(a_lab, 100.0),
        "lab, mixed": mixed[:a_lab],
        "lab, all at 1 kHz": np.full(a_lab, 1000.0),
        "school, all at 100 Hz": np.full(given.rigs, 100.0),
        "school, mixed": mixed,
        "school, all at 1 kHz": np.full(given.rigs, 1000.0),
    }
    for name, rates in kinds.items():
        total = rates.sum()
        print(
            f"{name:22} {rates.size:5} rigs {total:9.0f} messages/s"
            f" {total * _WIRE * 8e-6:7.1f} Mbit/s"
            f" router {total * costs.router_us * 1e-6:5.2f} recorder"
            f" {total * costs.recorder_us * 1e-6:6.2f} processors"
            f" {total * costs.disk_bytes * _LAB_HOURS * 3600e-9:7.1f} GB in {_LAB_HOURS:g} h,"
            f" away at most {longest_away_s(rates, costs.most_per_s):5.1f} s,"
            f" level {level_after_s(rates, costs.most_per_s, _AWAY_S):.1f} s after {_AWAY_S:g} s"
        )


if __name__ == "__main__":
    main()
