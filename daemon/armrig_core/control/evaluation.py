"""Evaluation of a control law at each sample, in plain Python numbers.

Every sum adds its products from left to right in Python floats, so that a replay gives the same
bits on every machine and every version of Python.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite, tau
from operator import mul
from typing import NamedTuple

import msgspec
from msgspec.structs import replace

from armrig_core.rig.volts import CODES_PER_V, applied_code, volts_of

Row = tuple[float, ...]
Rows = tuple[Row, ...]


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

    @property
    def is_finite(self) -> bool:
        """True if all states are finite numbers."""
        return all(map(isfinite, self.x))


class Command(NamedTuple):
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
    return LawState(0, law.x0, (0.0,) * len(law.y0), none)


def observe(
    law: Program,
    state: LawState,
    k: int,
    values: Sequence[float],
    reference: Sequence[float],
    latch: Latch,
) -> LawState:
    """Return the state after sample k; samples between the newest one and k are missing.

    `values` are the values of the rig's channels, NaN for a missing one.
    """
    while state.k < k:
        state = _advanced(law, state, None, reference[state.k], latch)
    return _advanced(law, state, values, reference[k], latch)


def decide(
    law: Program, state: LawState, k: int, reference: Sequence[float], latch: Latch
) -> tuple[LawState, Command]:
    """Return the code for sample k; the state remembers the code, and contains no later sample.

    A code is within the law's limits and those of the rig. Its change is limited with respect to
    every code that the device may hold.
    """
    codes = state.codes
    if len(codes) < k - state.first:  # ticks were skipped: the device holds the newest code
        codes += ((codes[-1] if codes else latch.rest_code),) * (k - state.first - len(codes))
        state = replace(state, codes=codes)
    ahead = state
    while ahead.k < k:
        ahead = _advanced(law, ahead, None, reference[ahead.k], latch)
    v = _dot(law.v_row, (*ahead.x, reference[k])) + law.u0
    low, high = max(law.lo_code, latch.code_min), min(law.hi_code, latch.code_max)
    if not isfinite(v):
        return state, Command(latch.rest_code, v, False, False, False, k - state.k)
    code = round(min(max(v * CODES_PER_V, -1.0), 65536.0))
    is_low, is_high = code < low, code > high
    code = low if is_low else high if is_high else code
    within = _within_slew(law, state, code, latch)
    limited = state.limited + 1 if is_low or is_high else 0
    state = replace(state, codes=(*codes, within), limited=limited)
    return state, Command(within, v, is_low, is_high, within != code, k - state.k)


def _within_slew(law: Program, state: LawState, code: int, latch: Latch) -> int:
    """Return the code nearest to `code` that may follow every code that the device may hold."""
    most = min(law.slew or latch.slew, latch.slew or law.slew)
    if not most:
        return code
    newest = state.k - 1 - state.first  # the newest code that a sample has confirmed
    held = state.codes[newest:] if newest >= 0 else (latch.rest_code, *state.codes)
    return min(max(code, max(held) - most), min(held) + most)


def _advanced(
    law: Program, state: LawState, values: Sequence[float] | None, r: float, latch: Latch
) -> LawState:
    """Return the state after one more sample; without `values`, the sample is missing."""
    x, k = state.x, state.k
    y, zeros, is_blind = _outputs(law, state, values)
    delayed = k - law.input_delay
    code = state.codes[delayed - state.first] if delayed >= 0 else latch.rest_code
    # The device rounds a code to its resolution: this is the code that it latches.
    z = (*x, r, volts_of(applied_code(code, latch.pwm_bits)) - law.u0, *y)
    x = tuple([_dot(row, z) for row in law.rows])
    astray = 0
    if law.tracked is not None:
        error = r - _dot(law.tracked, (*x, *y, 1.0))
        astray = state.astray + 1 if not abs(error) <= law.most_error else 0
    # The newest latched code is kept for the slew, and the older ones for the dead time.
    first = max(state.first, min(k, k + 1 - law.input_delay))
    return LawState(
        k + 1,
        x,
        y,
        zeros,
        state.codes[first - state.first :],
        first,
        state.blind + 1 if is_blind else 0,
        astray,
        state.limited,
    )


def _outputs(
    law: Program, state: LawState, values: Sequence[float] | None
) -> tuple[Row, tuple[float | None, ...], bool]:
    """Return Δy of a sample, the zeros of turning outputs, and True if no output is valid."""
    rows = law.predictions
    expected = state.y if rows is None else tuple([_dot(row, state.x) for row in rows])
    if values is None:
        return expected, state.zeros, True
    y, zeros, is_blind = list(expected), list(state.zeros), True
    for i, channel in enumerate(law.channels):
        value = values[channel]
        if not -inf < value < inf:  # a NaN fails this, too
            continue
        is_blind = False
        if not law.turning[i]:
            y[i] = value - law.y0[i]
            continue
        zero = zeros[i]
        if zero is None:
            zeros[i] = zero = value - expected[i]
        turned = value - zero
        turns = (expected[i] - turned) / tau
        y[i] = turned + tau * round(turns) if isfinite(turns) else turned
    return tuple(y), tuple(zeros), is_blind


def _dot(row: Row, z: Row) -> float:
    """Return the sum of products, from left to right: sum() and numpy round otherwise."""
    s = 0.0
    for product in map(mul, row, z):  # a third faster than a loop over pairs
        s += product
    return s
