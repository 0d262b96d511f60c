"""Evaluation of a control law at each sample, in plain Python numbers.

Every sum adds its products from left to right in Python floats, so that a replay gives the same
bits on every machine and every version of Python.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite, tau
from typing import NamedTuple, Protocol

import msgspec
from msgspec.structs import replace

from armrig_core.control import monitor as monitors
from armrig_core.control.monitor import MonitorProgram, MonitorState
from armrig_core.control.sums import Row, Rows, products
from armrig_core.rig.volts import CODES_PER_V, device_code, volts_of


class ReferenceValues(Protocol):
    """Reference at each sample of a run, in the unit of the law."""

    def __getitem__(self, k: int, /) -> float:
        """Return r[k]."""


class Program(msgspec.Struct, frozen=True, kw_only=True, array_like=True, gc=False):
    """A law as the core evaluates it: limits in codes, outputs by the number of their channel."""

    law_sha256: str
    Ts_us: int
    rows: Rows
    """(n, n + 2 + ny): A and B side by side."""
    v_row: Row
    """C and D."""
    u0: float
    x0: Row
    predictions: Rows | None
    """F of the law."""
    channels: tuple[int, ...]
    y0: Row
    turning: tuple[bool, ...]
    lo_code: int
    hi_code: int
    slew: int
    """Largest change of the code in one sample; 0 is no limit."""
    input_delay: int
    most_blind: int
    most_limited: int
    tracked: Row | None
    """Row of the tracked value, over (x, Δy), and then its offset; None for no bound."""
    most_error: float
    most_astray: int
    monitor: MonitorProgram | None = None


class Latch(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """Rest, resolution and limits of a rig's codes."""

    rest_code: int = 0
    pwm_bits: int = 16
    code_min: int = 0
    code_max: int = 65535
    slew: int = 0
    """Largest change of the code in one sample; 0 is no limit."""


class LawState(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """State of a law in a run, after the samples before `k`."""

    k: int
    """Number of samples, from the first of the run, that x contains."""
    x: Row
    y: Row
    """Δy of the newest sample, with predictions for missing values."""
    zeros: tuple[float | None, ...]
    """Angle, in rad, from which each turning output is counted; None before its first sample."""
    codes: tuple[int, ...] = ()
    """Commanded codes of the samples from `first` on."""
    first: int = 0
    blind: int = 0
    """Number of consecutive samples, up to the newest, without a valid output."""
    astray: int = 0
    """Number of consecutive samples with a control error beyond the bound."""
    limited: int = 0
    """Number of consecutive codes at a limit of the voltage."""
    monitor: MonitorState | None = None

    @property
    def is_finite(self) -> bool:
        """True if all states are finite numbers."""
        return all(map(isfinite, self.x))


class LawCommand(NamedTuple):
    """Code of a law for one sample, and how it came about."""

    code: int
    v: float
    """Voltage before the limits, in V; it may be no finite number, and the code is then rest."""
    is_low: bool
    """True if v is below the lowest voltage."""
    is_high: bool
    """True if v is above the highest voltage."""
    is_slewed: bool
    """True if the change of the voltage was limited."""
    predicted: int
    """Number of samples that had not arrived, and that F x replaced."""


def begin(law: Program) -> LawState:
    """Return the state of a law before the first sample of a run."""
    none = (None,) * len(law.y0)
    state = LawState(0, law.x0, (0.0,) * len(law.y0), none)
    return replace(state, monitor=monitors.begin(law.monitor)) if law.monitor else state


def observe(
    law: Program,
    state: LawState,
    k: int,
    values: Sequence[float],
    reference: ReferenceValues,
    latch: Latch,
) -> LawState:
    """Return the state after sample k; samples between the newest one and k are missing.

    `values` are the values of the rig's channels, NaN for a missing one.
    """
    while state.k < k:
        state = _advance(law, state, None, reference[state.k], latch)
    return _advance(law, state, values, reference[k], latch)


def decide(
    law: Program, state: LawState, k: int, reference: ReferenceValues, latch: Latch
) -> tuple[LawState, LawCommand]:
    """Return the code for sample k; the state remembers the code, and contains no later sample.

    A code is within the law's limits and those of the rig. Its change is limited with respect to
    every code that the device may hold.
    """
    committed, codes, first = state.k, state.codes, state.first
    if len(codes) < k - first:  # ticks were skipped: the device holds the newest code
        codes += ((codes[-1] if codes else latch.rest_code),) * (k - first - len(codes))
        state = replace(state, codes=codes)
    ahead = state
    while ahead.k < k:
        ahead = _advance(law, ahead, None, reference[ahead.k], latch)
    if law.monitor and k < law.monitor.prelude:
        gain, offset = law.monitor.forward
        v = gain * reference[k] + offset
    else:
        (v,) = products((law.v_row,), (*ahead.x, reference[k]))
        v += law.u0
    if not isfinite(v):
        return state, LawCommand(latch.rest_code, v, False, False, False, k - committed)
    code = round(min(max(v * CODES_PER_V, -1.0), 65536.0))
    low, high = max(law.lo_code, latch.code_min), min(law.hi_code, latch.code_max)
    is_low, is_high = code < low, code > high
    code = low if is_low else high if is_high else code
    most, within = min(law.slew or latch.slew, latch.slew or law.slew), code
    if most:
        newest = committed - 1 - first  # the newest code that a sample has confirmed
        held = codes[newest:] if newest >= 0 else (latch.rest_code, *codes)
        within = min(max(code, max(held) - most), min(held) + most)
    limited = state.limited + 1 if is_low or is_high else 0
    state = replace(state, codes=(*codes, within), limited=limited)
    return state, LawCommand(within, v, is_low, is_high, within != code, k - committed)


def _advance(
    law: Program, state: LawState, values: Sequence[float] | None, r: float, latch: Latch
) -> LawState:
    """Return the state after one more sample; without `values`, the sample is missing."""
    x, k, codes, first = state.x, state.k, state.codes, state.first
    y, zeros, valid = _outputs(law, state, values)
    x = products(law.rows, (*x, r, _past_v(state, law.input_delay, latch) - law.u0, *y))
    monitor, delay = state.monitor, law.input_delay
    is_closed = True
    if law.monitor and monitor:
        u_v = _past_v(state, law.monitor.input_delay, latch)
        monitor = monitors.advance(law.monitor, monitor, y, valid, u_v)
        delay, is_closed = max(delay, law.monitor.input_delay), k >= law.monitor.prelude
    astray = 0
    if law.tracked is not None and is_closed:
        error = r - products((law.tracked,), (*x, *y, 1.0))[0]
        astray = state.astray + 1 if not abs(error) <= law.most_error else 0
    # The newest latched code is kept for the slew, and the older ones for the dead time.
    kept = max(first, min(k, k + 1 - delay))
    blind = 0 if any(valid) else state.blind + 1
    codes = codes[kept - first :]
    return LawState(k + 1, x, y, zeros, codes, kept, blind, astray, state.limited, monitor)


def _past_v(state: LawState, delay: int, latch: Latch) -> float:
    """Return the voltage that the device latched `delay` samples before the state's sample."""
    i = state.k - delay
    # Before the run, and after the last code of the law, the device holds rest.
    is_decided = 0 <= i < state.first + len(state.codes)
    code = state.codes[i - state.first] if is_decided else latch.rest_code
    # The device rounds a code to its resolution: this is the code that it latches.
    return volts_of(device_code(code, latch.pwm_bits))


def _outputs(
    law: Program, state: LawState, values: Sequence[float] | None
) -> tuple[Row, tuple[float | None, ...], tuple[bool, ...]]:
    """Return Δy of a sample, the zeros of turning outputs, and which outputs are valid."""
    zeros, expected = state.zeros, state.y
    if law.predictions is not None:
        expected = products(law.predictions, state.x)
    elif law.monitor and state.monitor:
        expected = monitors.predict_outputs(law.monitor, state.monitor)
    if values is None:
        return expected, zeros, (False,) * len(expected)
    y, valid = [], []
    for y0, channel, turning, yhat in zip(law.y0, law.channels, law.turning, expected, strict=True):
        value = values[channel]
        valid.append(-inf < value < inf)  # a NaN fails this, too
        if not valid[-1]:
            y.append(yhat)
            continue
        if not turning:
            y.append(value - y0)
            continue
        i = len(y)
        zero = zeros[i]
        if zero is None:
            zero = value - yhat
            zeros = (*zeros[:i], zero, *zeros[i + 1 :])
        turned = value - zero
        turns = (yhat - turned) / tau
        y.append(turned + tau * round(turns) if isfinite(turns) else turned)
    return tuple(y), zeros, tuple(valid)
