"""Sampling time, lengths and levels of experiments that suit the model of a described rig."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import replace
from math import floor, inf, isfinite, log10, tau
from typing import Any

import msgspec
import numpy as np
from armrig_core.commands.commands import LONGEST_TS, samples_of
from armrig_core.commands.rehearsal import rehearse_outputs
from armrig_core.errors import InputError
from armrig_core.rig.description import Description, Output, require_model
from armrig_core.rig.saved_model import System
from numpy.typing import NDArray

from armrig.excitation.binary import telegraph
from armrig.excitation.levels import step
from armrig.numerics.quantities import digits

_LOW_V, _HIGH_V = 0.5, 4.5
_MIN_TS = 0.001  # s
_FASTEST, _SLOWEST = 10, 10  # samples in the fastest time constant, slowest ones in an experiment
_FEWEST_SAMPLES, _MOST_SAMPLES = 400, 20_000  # of a random input
_FEWEST_SWITCHES = 20  # of a random input, in the mean
_MOST_OF_EQUATIONS = 6000  # samples of a random input of a rig of own equations
_SHARE = 0.9  # of the highest voltage, and of the way of an output to its limit
_RISEN = 0.63  # share of a step's end that is reached in a time constant
_SETTLED = 0.02  # largest change of a settled response between its last two quarters
_HORIZONS_S = (0.25, 1.0, 4.0, 16.0, 64.0, 256.0, 1024.0, 4096.0)  # of own equations
_HORIZON_SAMPLES = 400
_MAX_ROUNDS = 6  # largest number of corrections of the levels
_NO_LIMITS: dict[str, Any] = {"low": -inf, "high": inf, "turns": 0.0, "rail_is_outside": None}
_SMALL, _ENOUGH = 0.1, 0.6  # share of the range that is small, and of the largest levels tried
_SEEDS = (1, 2)
_MIN_STEPS = 8  # least difference of the levels, and least motion of an output, in steps
_COUNTS = 65_536
_STEP_V, _STEP_COUNTS = 5 / 1024, _COUNTS / 1024  # steps of the Uno's input, and of its converter


class Pace(msgspec.Struct, frozen=True, kw_only=True):
    """Sampling time and levels of experiments, and the lengths of the experiments, in s."""

    Ts: float = 0.01
    every: int = 1
    """Number of samples of the device in a Ts."""
    seconds: float = 30.0
    """Length of a random input."""
    switch: float = 0.05
    """Probability that a telegraph signal switches at a sample."""
    step_s: float = 3.0
    """Length of a step; the step is after a sixth of it."""
    high: float = _HIGH_V
    """Highest voltage of the inputs."""
    rest_v: float = 0.0
    """Voltage at rest; if it is not 0 V, the levels are at equal distances from it."""

    @property
    def low(self) -> float:
        """Lowest voltage of the inputs: as far below the rest, or a ninth of the highest."""
        if self.rest_v:
            return round(2 * self.rest_v - self.high, 9)
        return round(self.high * _LOW_V / _HIGH_V, 3)

    @property
    def row(self) -> str:
        """Return the pace as text: sampling time, levels and lengths."""
        low, high = digits(self.low, 3), digits(self.high, 3)
        return (
            f"Ts {self.Ts:g} s, {low} to {high} V, a step of {self.step_s:g} s, a random input of "
            f"{self.seconds:g} s"
        )

    def step(self) -> NDArray[np.float64]:
        """Return a step."""
        N = round(self.step_s / self.Ts)
        return step(N, low=self.low, high=self.high, at=max(1, N // 6))

    def telegraph(self, seed: int) -> NDArray[np.float64]:
        """Return a telegraph signal."""
        N = round(self.seconds / self.Ts)
        return telegraph(N, self.switch, low=self.low, high=self.high, seed=seed)


def pace_of(described: Description, seconds: float | None = None) -> Pace:
    """Return the pace of a rig, by the time constants, the range and the limits of its model.

    Parameters
    ----------
    described : Description
        Description with a model; that of the arm has a fixed pace.
    seconds : float, optional
        Length of a random input; by default ten times the slowest time constant.

    Raises
    ------
    InputError
        The description has no model, or no levels suit its limits.

    Examples
    --------
    >>> from armrig_core.rig.description import builtin
    >>> from armrig.excitation.pace import pace_of
    >>> pace = pace_of(builtin("tclab"))
    >>> pace.Ts, pace.step_s
    (2.0, 905.0)
    """
    if described.arm:
        return Pace() if seconds is None else Pace(seconds=seconds)
    model, system = require_model(described)
    if system.process is None:
        fast, slow = _time_constants(system)
    else:
        system.process.close()
        fast = slow = _time_to_settle(described)
    port = described.input
    reach = min(_HIGH_V, _SHARE * port.u_max_v)
    if port.rest_v:
        reach = _SHARE * min(port.rest_v, port.u_max_v - port.rest_v)
    rest_y = np.array(model.offset or [0.0] * len(described.outputs))

    def of_length(length: float, step_s: float) -> Pace:
        Ts = system.Ts or _sampling_time(fast, length)
        pace = Pace(
            Ts=Ts,
            every=samples_of(Ts, described.longest_sample_s),
            seconds=max(length, Ts),
            switch=float(np.clip(max(2 / slow, _FEWEST_SWITCHES / length) * Ts, 0.01, 0.5)),
            step_s=max(step_s, 12 * Ts),
            high=port.rest_v + reach,
            rest_v=port.rest_v,
        )
        return _within_limits(pace, described, rest_y)

    # A rehearsal of own equations takes 4 s of the processor at most.
    most = _MOST_SAMPLES if described.equations is None else _MOST_OF_EQUATIONS
    least_s = float(np.ceil(_SLOWEST * slow + model.delay_s))
    length = seconds or max(least_s, min(30.0, most * _sampling_time(fast, 30.0)))
    step_s = max(3.0, float(np.ceil(5 * slow + 2 * model.delay_s)))
    tried = [of_length(length, step_s)]
    if seconds is None and tried[0].high - port.rest_v < _SMALL * reach:
        # An output that integrates goes less far in a shorter experiment.
        tried += [of_length(length / n, step_s / n) for n in (2, 4, 8)]
    levels = [pace.high - pace.rest_v for pace in tried]
    best = next(p for p, v in zip(tried, levels, strict=True) if v >= _ENOUGH * max(levels))
    _require_motion(best, described, rest_y)
    return best


def pace_inside(described: Description, u_max_v: float) -> Pace | None:
    """Return the pace of a rig with matrices, up to a voltage; None for the arm, or without one."""
    if described.arm or described.system is None:
        return None
    port = msgspec.structs.replace(described.input, u_max_v=min(u_max_v, described.input.u_max_v))
    with suppress(InputError):  # no levels suit the limits: a rehearsal refuses with the reason
        return pace_of(replace(described, input=port))
    return None


def _sampling_time(fast: float, length: float) -> float:
    """Return a sampling time for the fastest time constant and the length of an experiment."""
    most = min(LONGEST_TS, fast / _FASTEST, length / _FEWEST_SAMPLES)
    wanted = max(_MIN_TS, most, length / _MOST_SAMPLES) * (1 + 1e-9)
    power = 10.0 ** floor(log10(wanted))
    return float(f"{max(n for n in (1, 2, 5) if n * power <= wanted) * power:.0e}")


def _time_constants(system: System) -> tuple[float, float]:
    """Return the fastest and the slowest time constant of a linear model, in s."""
    poles = np.linalg.eigvals(np.array(system.A)).astype(complex)
    with np.errstate(divide="ignore"):
        rates = np.abs(poles.real if system.Ts is None else np.log(np.abs(poles)) / system.Ts)
    rates = rates[(rates > 1e-9) & np.isfinite(rates)]
    return (float(1 / rates.max()), float(1 / rates.min())) if rates.size else (1.0, 1.0)


def _time_to_settle(described: Description) -> float:
    """Return the time constant of own equations: 63 % of a step to half of the range, in s."""
    port, time_s = described.input, 1.0
    u = [(port.rest_v + port.u_max_v) / 2] * _HORIZON_SAMPLES
    for horizon in _HORIZONS_S:
        process = require_model(described)[1].process
        if process is None:
            break
        with closing(process):
            y = process.run(u, horizon / len(u))
        moved = np.abs(y[:, int(np.argmax(np.abs(y[-1])))])
        before, end = moved.reshape(4, -1).mean(axis=1)[2:]
        time_s = horizon / len(u) * float(1 + np.argmax(moved >= _RISEN * end))
        if 0 < abs(end - before) <= _SETTLED * end:
            break
    return time_s


def _within_limits(pace: Pace, described: Description, rest_y: NDArray[np.float64]) -> Pace:
    """Return the pace with levels at which each output stays within its limits."""
    outputs = described.outputs
    for _ in range(_MAX_ROUNDS):
        fall, rise = _motion(pace, described, rest_y)
        share = _SHARE * min(_rooms(outputs.values(), rest_y, fall, rise), default=inf)
        if share >= 1:
            break
        reach = floor(100 * share * (pace.high - pace.rest_v)) / 100
        pace = msgspec.structs.replace(pace, high=pace.rest_v + reach)
    return pace


def _require_motion(pace: Pace, described: Description, rest_y: NDArray[np.float64]) -> None:
    """Raise InputError if the input or each output hardly moves, or an output reaches a limit."""
    fall, rise = _motion(pace, described, rest_y)
    room = min(_rooms(described.outputs.values(), rest_y, fall, rise), default=inf)
    steps = [abs(c.step(_COUNTS / 2)) * _STEP_COUNTS for c in described.conversions]
    moves = (rise - fall) / np.array(steps)[: len(rest_y)]
    if room < 1 or pace.high - pace.low < _MIN_STEPS * _STEP_V or moves.max() < _MIN_STEPS:
        raise InputError(
            f"within the limits the input goes to {digits(pace.high, 3)} V, where "
            f"{next(iter(described.outputs))} moves by {moves[0]:.1f} steps of the converter; "
            f"{_MIN_STEPS} are necessary"
        )


def _motion(
    pace: Pace, described: Description, rest_y: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least and the largest change of each output from rest in all experiments."""
    free = {name: msgspec.structs.replace(o, **_NO_LIMITS) for name, o in described.outputs.items()}
    unlimited = replace(described, outputs=free)
    inputs = (np.rint(u / _STEP_V) * _STEP_V for u in (pace.step(), *map(pace.telegraph, _SEEDS)))
    runs = [[*(rehearse_outputs(u, pace.Ts, unlimited).outputs or {}).values()] for u in inputs]
    fall, rise = (np.array([[o[side] for o in run] for run in runs]) for side in (0, 1))
    return fall.min(axis=0) - rest_y, rise.max(axis=0) - rest_y


def _rooms(
    outputs: Iterable[Output],
    rest_y: NDArray[np.float64],
    fall: NDArray[np.float64],
    rise: NDArray[np.float64],
) -> Iterator[float]:
    """Yield the way to each limit, as a multiple of the way that the output makes."""
    for o, y, down, up in zip(outputs, rest_y, fall, rise, strict=True):
        turns = o.turns * tau or inf
        for way, room in ((up, min(o.high - y, turns)), (-down, min(y - o.low, turns))):
            if way > 0 and isfinite(room):
                yield max(room, 0.0) / way
