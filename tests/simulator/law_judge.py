"""Judge of a control run, which evaluates the accepted law by itself (S5).

Nothing here comes from `armrig_core.control`. The judge has the accepted order, the samples that
were published before a frame left, and the codes of the earlier frames. It keeps the history of the
run from its first sample on, and has no ring and no state but this history.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import isfinite, pi
from struct import unpack
from typing import Any, NamedTuple

from armrig_core.commands.codes import OutcomeCode
from armrig_daemon.pipe import Control, Run

from tests.simulator.monitor_judge import MonitorJudge, ordered_sum
from tests.simulator.options import Options
from tests.simulator.violation import Violation

BOUNDS = frozenset({OutcomeCode.TRACKING, OutcomeCode.BLIND, OutcomeCode.AT_LIMIT})
"""Ends of a run by a bound of its law."""
_FULL_CODE, _FULL_V = 65_535, 5.0


class _Tick(NamedTuple):
    """Decision of the law at a tick."""

    k: int
    ends: frozenset[str]
    """Reasons why no code of the law may follow: codes of outcomes, or gates of the monitor."""
    code: int = -1
    v: float = 0.0
    is_low: bool = False
    is_high: bool = False
    is_slewed: bool = False
    predicted: int = 0


class LawJudge:
    """The history of a control run, and the only code that may leave at each tick."""

    def __init__(self, run: Run, options: Options, seen: Counter[str]) -> None:
        """Begin before the first sample of an accepted run."""
        self._law: Any = run.law
        self._r = [*unpack(f"<{len(run.reference or b'') // 8}d", run.reference or b"")]
        self._reference_n = 0
        self._options, self._seen = options, seen
        self._bits = options.pwm_bits or 16
        self._low = max(options.u_min, self._law.lo_code)
        self._high = min(options.u_max, self._law.hi_code)
        self._slew = min((s for s in (self._law.slew, options.slew) if s), default=0)
        self.k_first = -1
        self.codes: list[int] = []
        """Code of each sample, as sent; a skipped sample has the code before it."""
        self._x: list[float] = list(self._law.x0)
        self._y: list[list[float]] = []
        """Change of each output from the operating point, for each sample up to the newest."""
        self._zeros: list[float | None] = [None] * len(self._law.y0)
        self._blind = self._astray = self._limited = 0
        self._ends: frozenset[str] = frozenset()
        self._monitor = MonitorJudge(self._law.monitor) if self._law.monitor else None
        self._prelude = self._law.monitor.prelude if self._law.monitor else 0
        self._tick: _Tick | None = None
        self._recorded: Control | None = None
        self._is_over = False

    # -- events in their order -------------------------------------------------------------------

    def sampled(self, k: int, values: Sequence[float]) -> None:
        """Take a published sample, and the samples that are missing before it."""
        i = k - self.k_first
        if self._is_over or self.k_first < 0 or i < 0:
            return
        while len(self._y) < i:
            self._take(None)
        self._take(values)
        law, ends = self._law, set[str]()
        if self._monitor and self._monitor.alarm:
            ends.add(self._monitor.alarm)
        if self._monitor and self._monitor.is_blind:
            ends.add(OutcomeCode.BLIND)
        if not all(map(isfinite, self._x)):
            ends.add(OutcomeCode.FAULT)
        if self._blind >= law.most_blind:
            ends.add(OutcomeCode.BLIND)
        if law.tracked is not None and self._astray >= law.most_astray:
            ends.add(OutcomeCode.TRACKING)
        self._ends = frozenset(ends)

    def begin_tick(self, k: int) -> None:
        """Compute the code for a tick, before the core does."""
        self._recorded = None
        if not self._is_over:
            self._tick = self._decided(k, k - self.k_first if self.k_first >= 0 else 0)
            self._ends = self._tick.ends

    def set_reference(self, r: float, n: int) -> None:
        """Take another reference, for the samples whose codes have not left."""
        decided = len(self.codes)
        self._r[decided:] = [r] * (len(self._r) - decided)
        self._reference_n = n
        self._seen["law: references set"] += 1
        if self._tick is not None and self._recorded is None and not self._is_over:
            self.begin_tick(self._tick.k)  # the same step contains the order and the tick

    def recorded(self, now_ns: int, record: Control) -> None:
        """Judge the core's record of a tick."""
        self._recorded = record
        i, tick = record.k - self.k_first, self._tick
        r = self._r[i] if 0 <= i < len(self._r) else None
        if record.reference_n != self._reference_n:
            raise Violation("S5", now_ns, f"recorded {record}, for command {self._reference_n}")
        facts = record.k, record.r, record.v, record.u_v
        flags = record.is_low, record.is_high, record.is_slewed, record.predicted
        if tick is None or (*facts, *flags) != (tick.k, r, tick.v, _volts(tick.code), *tick[4:]):
            raise Violation("S5", now_ns, f"recorded {record}, where the law gives {tick}")

    def sent(self, now_ns: int, k: int, code: int) -> None:
        """Judge an EXCHANGE of the run that is leaving."""
        if self._is_over:
            if code != self._options.rest:
                raise Violation("S5", now_ns, f"code {code} at k={k}, after the end of the law")
            return
        tick, i = self._tick, k - self.k_first
        if tick is None or tick.k != k or tick.ends or self._recorded is None:
            raise Violation("S5", now_ns, f"code {code} at k={k}, where the law gives {tick}")
        if code != tick.code:
            raise Violation("S5", now_ns, f"code {code} at k={k}, where the law gives {tick.code}")
        self.codes += [self._code(i)] * (i - len(self.codes))
        self.codes.append(code)
        self._limited = self._limited + 1 if tick.is_low or tick.is_high else 0
        self._seen["law: codes"] += 1
        self._seen["law: codes off rest"] += code != self._options.rest
        self._seen["law: codes at a limit"] += tick.is_low or tick.is_high
        self._seen["law: codes within the slew"] += tick.is_slewed
        self._seen["law: codes without the newest sample"] += tick.predicted > 0
        if self._monitor:
            is_turning = any(self._law.turning) and self._law.predictions is None
            self._seen["law: codes with a monitor that counts turns"] += is_turning
            self._seen["law: runs with a monitor"] += i == 0
            self._seen["law: codes with a monitor"] += 1
            self._seen["law: codes of a prelude"] += i < self._prelude
            self._seen["law: loops closed after a prelude"] += i == self._prelude > 0

    def stopped(self) -> None:
        """Note that a STOP leaves, or that the run has ended."""
        self._is_over = True

    def end_step(self, now_ns: int) -> None:
        """Judge that a run whose bound was exceeded by a sample was stopped in that step."""
        if self._ends and not self._is_over and self._tick and not self._tick.ends:
            raise Violation("S5", now_ns, f"the law goes on after {[*self._ends]}")

    def ended(self, now_ns: int, code: OutcomeCode) -> None:
        """Judge the cause of an end."""
        self._is_over = True
        if code in BOUNDS:
            self._seen[f"law: ended, {code}"] += 1
            self.ends_by(now_ns, code)

    def tripped(self, now_ns: int, gate: str, output: str) -> None:
        """Judge a trip by a gate of the monitor."""
        self._seen[f"law: tripped, {gate}"] += 1
        self.ends_by(now_ns, f"{gate} of {output}")

    def ends_by(self, now_ns: int, code: str) -> None:
        """Judge an end or a trip that the law is said to have caused."""
        if code not in self._ends:
            raise Violation("S5", now_ns, f"ended by {code}, where the law has {[*self._ends]}")

    # -- the law ---------------------------------------------------------------------------------

    def _code(self, i: int) -> int:
        """Return the code that sample i has, or had if its tick was skipped."""
        if i < 0 or not self.codes:
            return self._options.rest
        return self.codes[min(i, len(self.codes) - 1)]

    def _expected(
        self, x: Sequence[float], y: Sequence[float], of_monitor: Sequence[float]
    ) -> list[float]:
        """Return Δy after the states of law and monitor, and after the newest Δy."""
        F = self._law.predictions
        if F is not None:
            return [ordered_sum(row, x) for row in F]
        return self._monitor.expected(of_monitor) if self._monitor else [*y]

    def _volts_at(self, i: int) -> float:
        """Return the voltage that the device latched with sample i."""
        return _volts(_latched(self._code(i), self._bits))

    def _next(self, i: int, x: Sequence[float], y: Sequence[float]) -> list[float]:
        """Return x[i + 1]."""
        u = self._volts_at(i - self._law.input_delay) - self._law.u0
        z = [*x, self._r[i], u, *y]
        return [ordered_sum(row, z) for row in self._law.rows]

    def _newest(self) -> list[float]:
        return self._y[-1] if self._y else [0.0] * len(self._zeros)

    def _take(self, values: Sequence[float] | None) -> None:
        """Advance by a sample; None is a missing one."""
        law, i = self._law, len(self._y)
        monitor, valid = self._monitor, [False] * len(law.y0)
        y = self._expected(self._x, self._newest(), monitor.x if monitor else ())
        for j, channel in enumerate(law.channels):
            value = values[channel] if values is not None else float("nan")
            if not isfinite(value):
                continue
            valid[j] = True
            y[j] = self._turned(j, value, y[j]) if law.turning[j] else value - law.y0[j]
        self._y.append(y)
        self._x = self._next(i, self._x, y)
        if monitor:
            monitor.take(y, valid, self._volts_at(i - law.monitor.input_delay))
        self._blind = 0 if any(valid) else self._blind + 1
        if law.tracked is not None and i >= self._prelude:
            error = self._r[i] - ordered_sum(law.tracked, [*self._x, *y, 1.0])
            self._astray = 0 if abs(error) <= law.most_error else self._astray + 1

    def _turned(self, j: int, value: float, expected: float) -> float:
        """Return an angle with those turns that bring it nearest to its prediction."""
        zero = self._zeros[j]
        if zero is None:
            zero = self._zeros[j] = value - expected
        angle = value - zero
        turns = (expected - angle) / (2 * pi)
        return angle + 2 * pi * round(turns) if isfinite(turns) else angle

    def _decided(self, k: int, i: int) -> _Tick:
        law, monitor = self._law, self._monitor
        if i >= len(self._r):
            return _Tick(k, frozenset({OutcomeCode.COMPLETE}))
        x, y, predicted = self._x, self._newest(), i - len(self._y)
        of_monitor = monitor.x if monitor else []
        for j in range(len(self._y), i):
            y = self._expected(x, y, of_monitor)
            x = self._next(j, x, y)
            if monitor:
                volts = self._volts_at(j - law.monitor.input_delay)
                of_monitor = monitor.next(of_monitor, volts)
        v = ordered_sum(law.v_row, [*x, self._r[i]]) + law.u0
        if i < self._prelude:
            v = law.monitor.forward[0] * self._r[i] + law.monitor.forward[1]
        if not isfinite(v):
            return _Tick(k, frozenset({OutcomeCode.FAULT}))
        wanted = round(min(max(v, -1.0), 6.0) * 13_107)
        is_low, is_high = wanted < self._low, wanted > self._high
        code = within = min(max(wanted, self._low), self._high)
        if self._slew:
            confirmed = len(self._y) - 1
            held = [self._code(j) for j in range(confirmed, max(i, confirmed + 1))]
            within = max(code, max(held) - self._slew)
            within = min(within, min(held) + self._slew)
        ends = set[str]()
        if law.most_limited and (is_low or is_high) and self._limited + 1 >= law.most_limited:
            ends.add(OutcomeCode.AT_LIMIT)
        if self._blind + predicted > law.most_blind:
            ends.add(OutcomeCode.BLIND)
        is_slewed = within != code
        return _Tick(k, frozenset(ends), within, v, is_low, is_high, is_slewed, predicted)


def _volts(code: int) -> float:
    return code / _FULL_CODE * _FULL_V


def _latched(code: int, bits: int) -> int:
    """Return the code nearest to the duty cycle that is nearest to a code."""
    steps = 1 << bits
    duty = (2 * code * steps + _FULL_CODE) // (2 * _FULL_CODE)
    return (2 * duty * _FULL_CODE + steps) // (2 * steps)
