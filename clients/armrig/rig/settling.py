"""The end of a step: the outputs of a running rig have settled."""

from __future__ import annotations

from collections.abc import Sequence
from math import tau

import numpy as np
from armrig_core.rig.channels import DeviceChannel
from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Flag
from numpy.typing import NDArray

_BIN_S = 0.1  # the mean of the samples in this time is one row
_FEWEST, _FEWEST_SAMPLES = 40, 300  # rows after the step, and samples of models that are not poor
_GROWTH = 1.02  # of the rows from one judgement to the next
_MAX_CHANGE = 0.02  # of a settled output in the last quarter, as a share of its whole change
_LEAST_SIGNAL = 5.0  # change of an output by the step, as a multiple of its noise
_NOISE = 3.0  # change that noise explains, in standard deviations


class Settling:
    """Judge of the outputs after a step: feed it samples, and ask whether they have settled.

    The rows after the step are divided into four quarters. An output has settled if its mean in the
    last quarter differs from that in the third by at most 2 % of its whole change, or by what its
    noise explains. At least one output must have moved. A first-order output then is after seven
    time constants. The speed of a turning output is judged.
    """

    def __init__(self, channels: Sequence[DeviceChannel], at_s: float, Ts: float) -> None:
        """Store the channels, the time of the step, and the time between two samples, in s."""
        self._channels, self._at, self._Ts = channels, at_s, Ts
        self._per_row = max(1, round(_BIN_S / Ts))
        self._k_first: int | None = None
        self._waiting: list[list[float]] = []
        self._rows: list[list[float]] = []
        self._last: list[float] = []
        self._judged = 0

    def add(self, samples: Sequence[Sample]) -> None:
        """Take in samples of a run, in their order."""
        for m in samples:
            if not m.flags & Flag.RUN:
                continue
            self._k_first = m.k if self._k_first is None else self._k_first
            y = [m.value_0, m.value_1][: len(self._channels)]
            values = [
                (now - before + tau / 2) % tau - tau / 2 if c.turns else now
                for c, now, before in zip(self._channels, y, self._last or y, strict=True)
            ]
            self._last = y
            self._waiting.append([(m.k - self._k_first) * self._Ts, *values])
            if len(self._waiting) == self._per_row:
                self._rows.append(np.mean(self._waiting, axis=0).tolist())
                self._waiting = []

    def has_settled(self) -> bool:
        """Return whether an output has moved since the step, and all outputs are steady."""
        if len(self._rows) < max(_FEWEST_SAMPLES / self._per_row, _GROWTH * self._judged):
            return False
        self._judged = len(self._rows)
        table = np.array(self._rows).reshape(len(self._rows), 1 + len(self._channels))
        after = table[:, 0] > self._at
        if np.count_nonzero(after) < _FEWEST or after.all():
            return False
        verdicts = [_judge(y[~after], y[after]) for y in table[:, 1:].T if np.isfinite(y).any()]
        return any(moved for moved, _ in verdicts) and all(steady for _, steady in verdicts)


def _judge(before: NDArray[np.float64], after: NDArray[np.float64]) -> tuple[bool, bool]:
    """Return whether an output moved, and whether it is steady."""
    third, last = np.array_split(after, 4)[2:]
    noise = float(np.nanstd(np.diff(last))) / np.sqrt(2)
    end, change = np.nanmean(last), abs(np.nanmean(last) - np.nanmean(third))
    size = abs(end - np.nanmean(before))
    by_noise = _NOISE * noise * np.sqrt(2 / last.size)
    return bool(size > _LEAST_SIGNAL * noise), bool(change <= max(_MAX_CHANGE * size, by_noise))
