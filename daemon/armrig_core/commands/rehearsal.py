"""Rehearsal of a run: simulation of its input on the rig's model, and check of the limits."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from math import ceil, inf, sqrt, tau
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armrig_core.commands.commands import Rehearsal
from armrig_core.errors import InputError

if TYPE_CHECKING:
    from armrig_core.rig.arm import ArmParameters
    from armrig_core.rig.description import Description

_Array = NDArray[np.float64]
_Ends = tuple[_Array, _Array, _Array]
"""Lowest and highest changes of the outputs, (N, ny), and the last changes, of a part of a run."""

MOST_POINTS = 20_000_000
"""Largest number of points in time of one rehearsal; they take half a second to compute."""
_BLOCK_SAMPLES = 64  # samples that one matrix product advances
_PART_SAMPLES = 1 << 14  # samples that are simulated at once: 40 states then have 5 MB
_STEP_PHASE_RAD = 0.2  # phase of the oscillation between points: 0.5 % error at a peak
_MAX_STEPS = 1000  # points in one sampling interval
_EQUATIONS_S = 4  # longest processor time of own equations


class _Limits(NamedTuple):
    unit: str = "rad"
    low: float = -inf
    high: float = inf
    turns: float = 0.0
    """Rotation from the start, in turns, that is not allowed; 0 sets no limit."""


def rehearse(
    u: ArrayLike,
    Ts: float,
    *,
    parameters: ArmParameters | None = None,
    arm_removed: bool = False,
    theta_1_rad: float | None = None,
    revolutions: float = 0.0,
    alpha_rad: float = 0.0,
) -> Rehearsal:
    """Return the response of the arm to `u`, each value held for Ts, from standstill and alpha 0.

    The states at the samples are exact (zero-order hold) except for rounding. The outputs are also
    computed between the samples, often enough for the arm's oscillation, but at most at
    `MOST_POINTS` points in all. A peak is underestimated by more than 0.5 % only in runs of more
    than a day.

    Parameters
    ----------
    u : array_like, shape (N,)
        Motor voltage, in V; N >= 1.
    Ts : float
        Sampling time, in s.
    parameters : ArmParameters, optional
        Parameters of the rig; by default, the parameters of the handout.
    arm_removed : bool, default False
        True if the rotating part is removed: the chassis turns alone, and alpha is 0.
    theta_1_rad : float, optional
        Angle of the chassis at the start, in rad.
    revolutions, alpha_rad : float, default 0
        Limits of the chassis' rotation from its start, in turns, and of the arm's deflection, in
        rad; 0 sets no limit.

    Raises
    ------
    InputError
        The rotation reaches its limit, or the deflection exceeds its limit. During the run, the
        device stops as soon as `revolutions` is reached, and the daemon if alpha exceeds its limit.

    Examples
    --------
    >>> import armrig
    >>> u = armrig.step(300, low=0.0, high=4.0)
    >>> found = armrig.rehearse(u, 0.01)
    >>> print(f"{found.revolutions:.1f} turns, alpha up to {found.alpha_rad:.2f} rad")
    3.5 turns, alpha up to 0.29 rad
    >>> armrig.rehearse(u, 0.01, revolutions=3)
    Traceback (most recent call last):
        ...
    armrig_core.errors.InputError: the rehearsal turns theta_1 by up to 3.47 turns: ...
    """
    most = alpha_rad or inf
    limits = {"theta_1": _Limits(turns=revolutions), "alpha": _Limits(low=-most, high=most)}
    return _of_arm(u, Ts, parameters, limits, theta_1_rad, arm_removed=arm_removed)


def rehearse_outputs(
    u: ArrayLike,
    Ts: float,
    described: Description,
    *,
    parameters: ArmParameters | None = None,
    arm_removed: bool = False,
    start_rad: float | None = None,
) -> Rehearsal:
    """Return the response of a described rig to `u`, from its values at rest.

    The states at the samples are exact, and a dead time is rounded to whole samples. Own equations
    are simulated in a process of their own, for at most 4 s of processor time, and only at the
    samples. The last three arguments are those of `rehearse`, and belong to a rig whose model is
    that of the arm.

    Raises
    ------
    InputError
        An output leaves its limits, or the model in a file has another sampling time.
    OperationError
        Own equations took too long.
    """
    # Imported here: a reader of a stored rehearsal does not need scipy.
    from armrig_core.rig.description import require_model

    limits = {
        name: _Limits(o.unit, o.low, o.high, o.turns) for name, o in described.outputs.items()
    }
    if described.arm:
        return _of_arm(u, Ts, parameters, limits, start_rad, arm_removed=arm_removed)
    model, system = require_model(described, cpu_s=_EQUATIONS_S)
    every = max(1, round(system.Ts / Ts)) if system.Ts else 1
    if system.Ts is not None and abs(system.Ts - every * Ts) > 1e-9:
        raise InputError(
            f"Ts = {Ts:g} s: the model in {model.file} has Ts = {system.Ts:g} s; record with this "
            "sampling time, or identify a model from a recording at yours"
        )
    u, Ts = np.asarray(u)[::every], every * Ts  # the emulator, too, reads u at these instants
    # Own equations take the voltage at the pin, and matrices its difference from the rest.
    pad, rest_v = 0.0, described.input.rest_v
    volts = np.asarray(u, dtype=np.float64)
    if system.process is not None:
        pad = rest_v
    else:
        volts = volts - rest_v
    late = min(round(model.delay_s / Ts), volts.size)
    delayed = np.concatenate([np.full(late, pad), volts[: volts.size - late]]) if late else volts
    rest = np.array(model.offset or [0.0] * len(limits))
    if system.process is not None:
        with closing(system.process) as process:
            outputs = (process.run(part.tolist(), Ts) for part in _parts(delayed))
            lowest, highest, _ = _checked(limits, ((y, y, y[-1]) for y in outputs), rest, Ts)
    else:
        A, B, C = (np.array(matrix) for matrix in system[:3])
        poles = np.linalg.eigvals(A)
        swings = np.abs(poles[np.abs(poles.imag) > 0])
        swing = None if system.Ts else float(swings.max(initial=0.0))
        ends = _extremes(A, B, C, delayed, Ts, swing)
        lowest, highest, _ = _checked(limits, ends, rest, Ts)
    ranges = zip(limits.items(), lowest.tolist(), highest.tolist(), strict=True)
    return Rehearsal(outputs={name: (low, high, o.unit) for (name, o), low, high in ranges})


def _of_arm(
    u: ArrayLike,
    Ts: float,
    parameters: ArmParameters | None,
    limits: dict[str, _Limits],
    start_rad: float | None,
    *,
    arm_removed: bool,
) -> Rehearsal:
    """Return the response of the arm, or of the chassis alone; `limits` are of both outputs."""
    # Imported here: a reader of a stored rehearsal does not need scipy.
    from armrig_core.rig.arm import ArmParameters, arm_matrices, chassis_matrices

    p = parameters or ArmParameters()
    A, B, C = chassis_matrices(p) if arm_removed else arm_matrices(p)
    swing = 0.0 if arm_removed else sqrt(p.K_lin / p.J_1 + p.K_lin / p.J_2)  # undamped
    ends = _extremes(A, B, C, np.asarray(u, dtype=np.float64), Ts, swing)
    lowest, highest, last = _checked(limits, ends, np.zeros(len(C)), Ts)
    largest, turned = np.abs(np.maximum(highest, -lowest)), float(last[0])
    return Rehearsal(
        revolutions=float(largest[0]) / tau,
        alpha_rad=0.0 if arm_removed else float(largest[1]),
        turned_rad=turned,
        theta_1_rad=None if start_rad is None else start_rad + turned,
    )


def _parts(u: _Array) -> Iterator[_Array]:
    """Yield the samples of an input in parts."""
    for begin in range(0, u.size, _PART_SAMPLES):
        yield u[begin : begin + _PART_SAMPLES]


def _checked(
    limits: dict[str, _Limits], ends: Iterable[_Ends], rest: _Array, Ts: float
) -> tuple[_Array, _Array, _Array]:
    """Return the lowest and the highest value of each output, and their last changes.

    `ends` are changes from `rest`, the outputs at rest. Raises InputError if a value is outside
    the limits.
    """
    low, high = (np.array([getattr(x, side) for x in limits.values()]) for side in ("low", "high"))
    turns = np.array([x.turns for x in limits.values()])[: len(rest)]
    low, high = low[: len(rest)], high[: len(rest)]
    lowest, highest, last = np.zeros((3, len(rest)))
    first: dict[int, tuple[int, str]] = {}  # by output: the first sample outside, and the limit
    begin = 0
    for fall, rise, now in ends:
        above = ~(rest + rise <= high)  # also a NaN
        turned = (np.maximum(rise, -fall) / tau >= turns) & (turns > 0)
        outside = above | ~(rest + fall >= low) | turned
        for i in np.flatnonzero(outside.any(axis=0)).tolist():
            k = int(np.argmax(outside[:, i]))
            key = "turns" if turned[k, i] else "high" if above[k, i] else "low"
            first.setdefault(i, (begin + k, key))
        lowest = np.minimum(lowest, fall.min(axis=0))
        highest = np.maximum(highest, rise.max(axis=0))
        begin, last = begin + len(rise), now
    if first:
        i, (k, key) = min(first.items())
        name, limit = [*limits.items()][i]
        does = f"takes {name} from {rest[i] + lowest[i]:.3g} to {rest[i] + highest[i]:.3g}"
        does += f" {limit.unit}"
        if key == "turns":
            does = f"turns {name} by up to {max(highest[i], -lowest[i]) / tau:.3g} turns"
        raise InputError(
            f"the rehearsal {does}: {name}.{key} = {getattr(limit, key):g} is reached at u[{k}], "
            f"{k * Ts:.3g} s; shorten the input or change its voltages, or change the limit "
            "([limits], or the rig's description)"
        )
    return rest + lowest, rest + highest, last


def _extremes(
    A: _Array, B: _Array, C: _Array, u: _Array, Ts: float, swing: float | None
) -> Iterator[_Ends]:
    """Yield the lowest and highest y = C x of each interval without its start, and the last y.

    The run is simulated in parts. The state x is 0 at first. `swing` is the frequency of the
    fastest oscillation, in rad/s; with None, A and B are those of one interval.
    """
    from armrig_core.rig.arm import zero_order_hold

    n, m = len(A), 1
    if swing is None:
        step = _augmented(A, B)
    else:
        m = max(1, min(ceil(Ts * swing / _STEP_PHASE_RAD), MOST_POINTS // u.size, _MAX_STEPS))
        step = _augmented(*zero_order_hold(A, B, Ts / m))
    whole = np.linalg.matrix_power(step, m)
    start = np.zeros(n)
    for part in _parts(u):
        x = _states(whole[:n, :n], whole[:n, n], part, start)
        start = x[-1]
        lowest = x[1:] @ C.T
        highest = lowest.copy()
        point = np.eye(n + 1)
        for _ in range(m - 1):
            point = step @ point
            between = x[:-1] @ (C @ point[:n, :n]).T
            between += np.outer(part, C @ point[:n, n])
            np.minimum(lowest, between, out=lowest)
            np.maximum(highest, between, out=highest)
        yield lowest, highest, C @ start


def _augmented(Phi: _Array, Gamma: _Array) -> _Array:
    """Return the matrix that maps (x, u) to (x, u) of the next step, with u held."""
    n = len(Phi)
    both = np.eye(n + 1)
    both[:n, :n], both[:n, n:] = Phi, Gamma
    return both


def _states(Phi: _Array, Gamma: _Array, u: _Array, start: _Array) -> _Array:
    """Return x (N + 1, n) of x[k+1] = Phi x[k] + Gamma u[k] from x[0] = start, block by block."""
    # Within a block, the responses to its first state and to its input are products with powers of
    # Phi. Only the first state of each block is computed recursively.
    n, N = Phi.shape[0], u.size
    blocks = -(-N // _BLOCK_SAMPLES)
    powers = [np.eye(n)]
    for _ in range(_BLOCK_SAMPLES):
        powers.append(Phi @ powers[-1])
    impulse = np.array([power @ Gamma for power in powers[:-1]])
    forcing = np.zeros((_BLOCK_SAMPLES, _BLOCK_SAMPLES, n))
    for i in range(_BLOCK_SAMPLES):
        forcing[i, i:] = impulse[: _BLOCK_SAMPLES - i]
    padded = np.zeros(blocks * _BLOCK_SAMPLES)
    padded[:N] = u
    x = padded.reshape(blocks, _BLOCK_SAMPLES) @ forcing.reshape(_BLOCK_SAMPLES, _BLOCK_SAMPLES * n)
    first = np.empty((blocks, n))
    first[0] = start
    for b in range(1, blocks):
        first[b] = powers[-1] @ first[b - 1] + x[b - 1, -n:]
    x += first @ np.concatenate([power.T for power in powers[1:]], axis=1)
    return np.concatenate([start[None], x.reshape(-1, n)[:N]])
