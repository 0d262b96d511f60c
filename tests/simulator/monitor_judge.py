"""Judge of a law's monitor, which computes predictions, simulation and gates by itself.

Nothing here comes from `armrig_core.control`. The judge remembers for each gate and each output
which of the valid samples were beyond the gate.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isfinite
from typing import Any

GATES = ("innovation", "simulation")
_DEVIATIONS, _IN_A_ROW, _RANGE_SHARE = 6.0, 5, 0.25


def ordered_sum(row: Iterable[float], z: Iterable[float]) -> float:
    """Return the sum of products, in the order of the law's definition."""
    total = 0.0
    for a, b in zip(row, z, strict=False):
        total += a * b
    return total


class MonitorJudge:
    """The history of a monitor in one run."""

    def __init__(self, monitor: Any) -> None:
        """Begin before the first sample of an accepted run."""
        self._monitor = monitor
        self.x: list[float] = list(monitor.x0)
        """State with the corrections by the samples so far."""
        self._free: list[float] = list(monitor.x0)
        self._zeros: list[float | None] = [None] * len(monitor.outputs)
        self._ranges: list[list[float]] = [[] for _ in monitor.outputs]
        """Lowest and highest simulated value of each output."""
        self._missing = [0] * len(monitor.outputs)
        self._seen = self._outputs(self.x)
        """Newest valid value of each output."""
        self._beyond = {(gate, j): [] for gate in GATES for j in range(len(monitor.outputs))}

    def expected(self, x: Sequence[float]) -> list[float]:
        """Return the outputs that follow from a state."""
        pairs = zip(self._outputs(x), self._zeros, strict=True)
        return [y if zero is None else y + zero for y, zero in pairs]

    def next(self, x: Sequence[float], volts: float, e: Sequence[float] = ()) -> list[float]:
        """Return the state after `x`, with the innovations `e`; without them, without correction.

        `volts` is the voltage that the device latched a dead time before.
        """
        e = e or [0.0] * len(self._zeros)
        return [ordered_sum(row, [*x, volts - self._monitor.u0, *e]) for row in self._monitor.rows]

    def take(self, y: Sequence[float], valid: Sequence[bool], volts: float) -> None:
        """Advance by a sample; only the outputs that are `valid` count."""
        expected, simulated = self._outputs(self.x), self._outputs(self._free)
        e = [0.0] * len(y)
        for j, (values, value) in enumerate(zip(self._ranges, simulated, strict=True)):
            values[:] = min([*values, value]), max([*values, value])
            self._missing[j] = 0 if valid[j] else self._missing[j] + 1
            if not valid[j]:
                continue
            self._seen[j] = y[j]
            zero = self._zeros[j]
            if zero is None:
                zero = self._zeros[j] = y[j] - expected[j]
            e[j] = y[j] - zero - expected[j]
            bound = _DEVIATIONS * self._monitor.deviations[j]
            self._note("innovation", j, e[j], bound)
            if self._monitor.settling[j]:
                span = _RANGE_SHARE * (values[1] - values[0])
                warm = abs(zero) if abs(zero) > bound else 0.0
                self._note("simulation", j, y[j] - zero - value, max(bound, span) + warm)
        self.x, self._free = self.next(self.x, volts, e), self.next(self._free, volts)

    def _note(self, gate: str, j: int, difference: float, bound: float) -> None:
        self._beyond[gate, j].append(not abs(difference) <= bound or not isfinite(bound))

    def _outputs(self, x: Sequence[float]) -> list[float]:
        return [ordered_sum(row, x) for row in self._monitor.predictions]

    @property
    def is_blind(self) -> bool:
        """True if an output is missing for too many samples, or for too large a turn."""
        turned = [abs(a - b) for a, b in zip(self.expected(self.x), self._seen, strict=True)]
        bounds = zip(self._missing, self._monitor.most_turned, turned, strict=True)
        return any(
            count >= self._monitor.most_blind
            if most is None
            else not turn * (count - 2) <= most * count
            for count, most, turn in bounds
            if count > 0
        )

    @property
    def alarm(self) -> str:
        """Gate and output that must stop the run; empty without one."""
        for (gate, j), beyond in self._beyond.items():
            if beyond[-_IN_A_ROW:] == [True] * _IN_A_ROW:
                return f"{gate} of {self._monitor.outputs[j]}"
        return ""
