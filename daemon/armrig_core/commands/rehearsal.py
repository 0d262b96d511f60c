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
    from armrig_core.rig.equations_file import EquationsProcess

_Array = NDArray[np.float64]
Ends = tuple[_Array, _Array, _Array]
"""Lowest and highest changes of the outputs, (N, ny), and the last changes, of a part of a run."""

MOST_POINTS = 20_000_000
"""Largest number of points in time of one rehearsal; they take half a second to compute."""
PART_SAMPLES = 1 << 14
"""Number of samples that are simulated at once; 40 states then have 5 MB."""
EQUATIONS_S = 4
"""Longest processor time of own equations, in s."""
_BLOCK_SAMPLES = 64  # samples that one matrix product advances
_STEP_PHASE_RAD = 0.2  # phase of the oscillation between points: 0.5 % error at a peak
_MAX_STEPS = 1000  # points in one sampling interval


class OutputLimits(NamedTuple):
    """Limits of an output in a run."""

    unit: str = "rad"
    low: float = -inf
    high: float = inf
    turns: float = 0.0
    """Rotation from the start, in turns, that is not allowed; 0 sets no limit."""


class RigModel(NamedTuple):
    """Model of a rig about its rest: x' = A x + B v, or x(t + Ts) = A x + B v; y = rest + C x."""

    A: _Array
    B: _Array
    C: _Array
    rest: _Array
    """Outputs at rest, (ny,)."""
    limits: dict[str, OutputLimits]
    """Limits of the outputs, by name; of an arm without its rotating part, those of more outputs
    than the model has."""
    swing: float | None
    """Frequency of the fastest oscillation, in rad/s; None for a model in discrete time."""
    Ts: float | None = None
    """Sampling time of a model in discrete time, in s."""
    delay_s: float = 0.0
    """Dead time of the input, in s."""
    origin_v: float = 0.0
    """Voltage at the pin at which v is 0."""
    process: EquationsProcess | None = None
    """Process of own equations, whose small motions the matrices describe; otherwise None."""
    file: str = ""
    """File of the model, as the description names it."""
    is_arm: bool = False

    def step(self, Ts: float, N: int) -> tuple[_Array, int]:
        """Return the matrix of (x, v) for each of m parts of Ts, and m, for a run of N samples."""
        from armrig_core.rig.arm import zero_order_hold

        if self.swing is None:
            return _augment(self.A, self.B), 1
        m = max(1, min(ceil(Ts * self.swing / _STEP_PHASE_RAD), MOST_POINTS // N, _MAX_STEPS))
        return _augment(*zero_order_hold(self.A, self.B, Ts / m)), m

    def rehearsal(
        self, lowest: _Array, highest: _Array, last: _Array, start_rad: float | None
    ) -> Rehearsal:
        """Return the ranges of the outputs as the result of a rehearsal."""
        if not self.is_arm:
            ranges = zip(self.limits.items(), lowest.tolist(), highest.tolist(), strict=True)
            return Rehearsal(outputs={name: (low, high, o.unit) for (name, o), low, high in ranges})
        largest, turned = np.abs(np.maximum(highest, -lowest)), float(last[0])
        return Rehearsal(
            revolutions=float(largest[0]) / tau,
            alpha_rad=float(largest[1]) if len(largest) > 1 else 0.0,
            turned_rad=turned,
            theta_1_rad=None if start_rad is None else start_rad + turned,
        )


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
    >>> found = armrig.physics.rehearse(u, 0.01)
    >>> print(f"{found.revolutions:.1f} turns, alpha up to {found.alpha_rad:.2f} rad")
    3.5 turns, alpha up to 0.29 rad
    >>> armrig.physics.rehearse(u, 0.01, revolutions=3)
    Traceback (most recent call last):
        ...
    armrig_core.errors.InputError: the rehearsal turns theta_1 by up to 3.47 turns: ...
    """
    most = alpha_rad or inf
    limits = {
        "theta_1": OutputLimits(turns=revolutions),
        "alpha": OutputLimits(low=-most, high=most),
    }
    model = _arm_model(parameters, limits, arm_removed=arm_removed)
    return _response(model, np.asarray(u, dtype=np.float64), Ts, theta_1_rad)


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
    model = rig_model(described, parameters, arm_removed=arm_removed)
    volts = np.asarray(u, dtype=np.float64) - model.origin_v
    every = max(1, round(model.Ts / Ts)) if model.Ts else 1
    if model.Ts is not None and abs(model.Ts - every * Ts) > 1e-9:
        raise InputError(
            f"Ts = {Ts:g} s: the model in {model.file} has Ts = {model.Ts:g} s; record with this "
            "sampling time, or identify a model from a recording at yours"
        )
    volts, Ts = volts[::every], every * Ts  # the emulator, too, reads u at these instants
    late = min(round(model.delay_s / Ts), volts.size)
    before = described.input.rest_v - model.origin_v
    volts = np.concatenate([np.full(late, before), volts[: volts.size - late]]) if late else volts
    return _response(model, volts, Ts, start_rad)


def rig_model(
    described: Description,
    parameters: ArmParameters | None,
    *,
    arm_removed: bool = False,
    cpu_s: int = EQUATIONS_S,
) -> RigModel:
    """Return the model of a described rig; own equations have `cpu_s` s of processor time.

    Raises InputError if the rig has no model.
    """
    # Imported here: a reader of a stored rehearsal does not need scipy.
    from armrig_core.rig.description import require_model

    limits = {
        name: OutputLimits(o.unit, o.low, o.high, o.turns) for name, o in described.outputs.items()
    }
    if described.arm:
        return _arm_model(parameters, limits, arm_removed=arm_removed)
    model, system = require_model(described, cpu_s=cpu_s)
    A, B, C = (np.array(matrix) for matrix in system[:3])
    poles = np.linalg.eigvals(A)
    swing = float(np.abs(poles[np.abs(poles.imag) > 0]).max(initial=0.0))
    return RigModel(
        A,
        B,
        C,
        rest=np.array(model.offset or [0.0] * len(limits)),
        limits=limits,
        swing=None if system.Ts else swing,
        Ts=system.Ts,
        delay_s=model.delay_s,
        # Own equations take the voltage at the pin, and matrices its difference from the rest.
        origin_v=described.input.rest_v if system.process is None else 0.0,
        process=system.process,
        file=model.file,
    )


def _arm_model(
    parameters: ArmParameters | None, limits: dict[str, OutputLimits], *, arm_removed: bool
) -> RigModel:
    """Return the model of the arm, or of the chassis alone; `limits` are of both outputs."""
    # Imported here: a reader of a stored rehearsal does not need scipy.
    from armrig_core.rig.arm import ArmParameters, arm_matrices, chassis_matrices

    p = parameters or ArmParameters()
    A, B, C = chassis_matrices(p) if arm_removed else arm_matrices(p)
    swing = 0.0 if arm_removed else sqrt(p.K_lin / p.J_1 + p.K_lin / p.J_2)  # undamped
    return RigModel(A, B, C, np.zeros(len(C)), limits, swing, is_arm=True)


def _response(model: RigModel, v: _Array, Ts: float, start_rad: float | None) -> Rehearsal:
    """Return the response of a model to an input in V, each value held for Ts."""
    if model.process is not None:
        with closing(model.process) as process:
            outputs = (process.run(part.tolist(), Ts) for part in _parts(v))
            return check_ends(model, ((y, y, y[-1]) for y in outputs), Ts, start_rad)
    return check_ends(model, _extremes(model, v, Ts), Ts, start_rad)


def _parts(u: _Array) -> Iterator[_Array]:
    """Yield the samples of an input in parts."""
    for begin in range(0, u.size, PART_SAMPLES):
        yield u[begin : begin + PART_SAMPLES]


def check_ends(
    model: RigModel,
    ends: Iterable[Ends],
    Ts: float,
    start_rad: float | None,
    wrong: str = "u[{}], {:.3g} s; shorten the input or change its voltages",
) -> Rehearsal:
    """Return the result of a rehearsal in which the outputs change by `ends`.

    Raises InputError if a value is outside the limits. `wrong` is the end of its sentence, with
    places for the number of the sample and its time.
    """
    limits, rest_y = model.limits, model.rest
    low, high = (np.array([getattr(x, side) for x in limits.values()]) for side in ("low", "high"))
    turns = np.array([x.turns for x in limits.values()])[: len(rest_y)]
    low, high = low[: len(rest_y)], high[: len(rest_y)]
    lowest, highest, last = np.zeros((3, len(rest_y)))
    first: dict[int, tuple[int, str]] = {}  # by output: the first sample outside, and the limit
    begin = 0
    for fall, rise, now in ends:
        above = ~(rest_y + rise <= high)  # also a NaN
        turned = (np.maximum(rise, -fall) / tau >= turns) & (turns > 0)
        outside = above | ~(rest_y + fall >= low) | turned
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
        does = f"takes {name} from {rest_y[i] + lowest[i]:.3g} to {rest_y[i] + highest[i]:.3g}"
        does += f" {limit.unit}"
        if key == "turns":
            does = f"turns {name} by up to {max(highest[i], -lowest[i]) / tau:.3g} turns"
        raise InputError(
            f"the rehearsal {does}: {name}.{key} = {getattr(limit, key):g} is reached at "
            f"{wrong.format(k, k * Ts)}, or change the limit ([limits], or the rig's description)"
        )
    return model.rehearsal(rest_y + lowest, rest_y + highest, last, start_rad)


def _extremes(model: RigModel, v: _Array, Ts: float) -> Iterator[Ends]:
    """Yield the ends of a run, part by part; the state x is 0 at first."""
    n = len(model.A)
    step, m = model.step(Ts, v.size)
    transition = np.linalg.matrix_power(step, m)
    start = np.zeros(n)
    for part in _parts(v):
        x = _states(transition[:n, :n], transition[:n, n], part, start)
        start = x[-1]
        yield interval_ends(model.C, step, m, x, part)


def interval_ends(C: _Array, step: _Array, m: int, x: _Array, v: _Array) -> Ends:
    """Return the lowest and highest y = C x of each interval without its start, and the last y.

    `x` are the states (N + 1, n) at the samples, and `v` is the input (N,), held between them. The
    matrix `step` maps (x, v) to (x, v) after one of the m parts of an interval.
    """
    n = C.shape[1]
    lowest = x[1:] @ C.T
    highest = lowest.copy()
    point = np.eye(n + 1)
    for _ in range(m - 1):
        point = step @ point
        between = x[:-1] @ (C @ point[:n, :n]).T
        between += np.outer(v, C @ point[:n, n])
        np.minimum(lowest, between, out=lowest)
        np.maximum(highest, between, out=highest)
    return lowest, highest, C @ x[-1]


def _augment(Phi: _Array, Gamma: _Array) -> _Array:
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
