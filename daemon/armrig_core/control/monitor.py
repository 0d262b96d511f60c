"""Monitor of a control law: a copy of the plant's model that compares each output with itself.

The model, with its observer, is

    x[k+1] = A x[k] + B Δu[k-d] + L e[k],    e[k] = y[k] - z - C x[k],    x[0] = x0

The innovation e of a missing output is 0. The zero z of an output is the difference at its first
valid sample, so that the monitor compares changes. Two gates trip, each after 5 valid samples in a
row with a difference beyond its bound:

- innovation: the difference e, and 6 of its deviations;
- simulation, for an output that settles: the difference of y from the same model without L, and 6
  deviations or 25 % of the range that this model has reached, whichever is larger. If |z| is more
  than 6 deviations, the output was not at rest and may return to it: |z| is added.

A missing output changes no count of a gate. It is lost after a number of samples, and a turning
one after a turn (`find_lost_output`). A difference that is not finite is beyond each bound.

The innovation sees a fast change that the input does not explain. The simulation sees a slow one,
which the observer follows.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from math import inf
from typing import NamedTuple

import msgspec

from armrig_core.control.sums import Row, Rows, products

DEVIATIONS = 6.0
"""Largest difference that may recur, in deviations of the innovation."""
IN_A_ROW = 5
"""Number of consecutive valid samples beyond a gate after which it trips."""
RANGE_SHARE = 0.25
"""Largest difference from the simulation that may recur, as a share of its range."""


class Gate(StrEnum):
    """Gate of a monitor."""

    INNOVATION = "innovation"
    SIMULATION = "simulation"


class MonitorProgram(msgspec.Struct, frozen=True, kw_only=True, array_like=True, gc=False):
    """A monitor as the core evaluates it."""

    outputs: tuple[str, ...]
    """Names of the law's outputs."""
    rows: Rows
    """(m, m + 1 + ny): A, B and L side by side."""
    predictions: Rows
    """C, (ny, m)."""
    x0: Row
    u0: float
    """Voltage at which Δu is 0, in V."""
    deviations: Row
    """Deviation of each innovation, in the unit of its output."""
    settling: tuple[bool, ...]
    """True for each output that settles."""
    input_delay: int
    """Dead time d, in samples."""
    prelude: int
    """Number of samples of feed-forward at the beginning of a run."""
    forward: tuple[float, float]
    """Feed-forward: v = forward[0] · r + forward[1], in V."""
    most_blind: int
    """Number of consecutive samples without a valid value after which an output is lost."""
    most_turned: tuple[float | None, ...]
    """For a turning output in place of `most_blind`: the largest change of its prediction, in rad,
    since its newest valid sample. None for another output."""


class MonitorState(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """State of a monitor in a run, after the same samples as the state of its law."""

    x: Row
    simulated: Row
    """State of the model without L; x0 if no output settles."""
    zeros: tuple[float | None, ...]
    """Zero z of each output; None before its first valid sample."""
    low: Row
    """Lowest value of each simulated output."""
    high: Row
    unlike: tuple[int, ...]
    """Number of consecutive valid samples beyond the innovation gate, for each output."""
    astray: tuple[int, ...]
    """Number of consecutive valid samples beyond the simulation gate, for each output."""
    missing: tuple[int, ...]
    """Number of consecutive samples without a valid value, for each output."""
    seen: Row
    """Newest valid value of each output; its first prediction before that."""


class Alarm(NamedTuple):
    """Gate that has tripped."""

    gate: Gate
    output: int
    """Number of the output in the law."""
    name: str
    """Name of the output."""


def begin(monitor: MonitorProgram) -> MonitorState:
    """Return the state of a monitor before the first sample of a run."""
    y, none = products(monitor.predictions, monitor.x0), (0,) * len(monitor.deviations)
    return MonitorState(monitor.x0, monitor.x0, (None,) * len(y), y, y, none, none, none, y)


def advance(
    monitor: MonitorProgram, state: MonitorState, y: Row, valid: Sequence[bool], u_v: float
) -> MonitorState:
    """Return the state after one more sample; only the outputs `y` that are `valid` count.

    `u_v` is the voltage that the device latched `input_delay` samples before, in V.
    """
    expected, du = products(monitor.predictions, state.x), u_v - monitor.u0
    simulated, free, low, high = expected, state.simulated, state.low, state.high
    if any(monitor.settling):
        simulated = products(monitor.predictions, free)
        low, high = tuple(map(min, low, simulated)), tuple(map(max, high, simulated))
        free = products(monitor.rows, (*free, du, *(0.0,) * len(y)))
    zeros, unlike, astray = [*state.zeros], [*state.unlike], [*state.astray]
    missing, seen, e = [*state.missing], [*state.seen], [0.0] * len(y)
    for i, is_valid in enumerate(valid):
        if not is_valid:
            missing[i] += 1
            continue
        missing[i], seen[i] = 0, y[i]
        if (zero := zeros[i]) is None:
            zero = zeros[i] = y[i] - expected[i]
        value, most = y[i] - zero, DEVIATIONS * monitor.deviations[i]
        e[i] = value - expected[i]
        # A difference from a number that is not finite is beyond each bound.
        unlike[i] = 0 if abs(e[i]) <= most < inf else unlike[i] + 1
        if monitor.settling[i]:
            start = abs(zero) if abs(zero) > most else 0.0
            most = max(most, RANGE_SHARE * (high[i] - low[i])) + start
            astray[i] = 0 if abs(value - simulated[i]) <= most < inf else astray[i] + 1
    x = products(monitor.rows, (*state.x, du, *e))
    counts = tuple(unlike), tuple(astray), tuple(missing)
    return MonitorState(x, free, tuple(zeros), low, high, *counts, tuple(seen))


def alarm(monitor: MonitorProgram, state: MonitorState) -> Alarm | None:
    """Return the first gate that has tripped; None if no gate has."""
    for gate, counts in ((Gate.INNOVATION, state.unlike), (Gate.SIMULATION, state.astray)):
        for i, count in enumerate(counts):
            if count >= IN_A_ROW:
                return Alarm(gate, i, monitor.outputs[i])
    return None


def find_lost_output(monitor: MonitorProgram, state: MonitorState) -> str:
    """Return the name of an output that has had no valid value for too long; "" for none.

    A turning output passes its dead band at any speed, so its predicted turn counts, not the time.
    The turns of two samples are left out: a dead band begins and ends between two samples.
    """
    if not any(state.missing):
        return ""
    now = predict_outputs(monitor, state)
    for i, count in enumerate(state.missing):
        turn, turned = monitor.most_turned[i], abs(now[i] - state.seen[i])
        if count == 0:
            continue
        if turn is None:
            is_lost = count >= monitor.most_blind
        else:  # a turn that is not finite is too large
            is_lost = not turned * (count - 2) <= turn * count
        if is_lost:
            return monitor.outputs[i]
    return ""


def predict_outputs(monitor: MonitorProgram, state: MonitorState) -> Row:
    """Return the outputs that the monitor predicts for the next sample."""
    y = products(monitor.predictions, state.x)
    return tuple(value + (zero or 0.0) for value, zero in zip(y, state.zeros, strict=True))
