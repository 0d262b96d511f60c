"""Rehearsal of a run: simulation of its input on the arm's model, and check of the limits."""

from __future__ import annotations

from math import ceil, sqrt, tau
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armrig_core.commands.commands import Rehearsal
from armrig_core.errors import InputError

if TYPE_CHECKING:
    from armrig_core.rig.arm import ArmParameters
    from armrig_core.rig.description import Description

_Array = NDArray[np.float64]

MOST_POINTS = 20_000_000
"""Largest number of points in time of one rehearsal; they take half a second to compute."""
_BLOCK_SAMPLES = 64  # samples that one matrix product advances
_STEP_PHASE_RAD = 0.2  # phase of the oscillation between points: 0.5 % error at a peak


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
        A limit is reached or exceeded. During the run, the device enters FAULT as soon as
        `revolutions` is reached; the device does not check alpha.

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
    armrig_core.errors.InputError: the rehearsal turns the chassis by up to 3.47 turns: ...
    """
    volts = np.asarray(u, dtype=np.float64)
    Phi, Gamma, m = _steps(parameters, arm_removed, Ts, volts.size)
    whole = np.linalg.matrix_power(_augmented(Phi, Gamma), m)
    x = _states(whole[:4, :4], whole[:4, 4], volts)
    # Largest rotation and deflection in each sampling interval, without the start of the interval.
    peaks = np.abs(x[1:, :2])
    point = np.eye(5)
    for _ in range(m - 1):
        point = _augmented(Phi, Gamma) @ point
        between = x[:-1] @ point[:2, :4].T
        between += np.outer(volts, point[:2, 4])
        np.maximum(peaks, np.abs(between), out=peaks)
    turns = peaks[:, 0] / tau
    _check("revolutions", turns, revolutions, "turns the chassis by", "turns", Ts)
    text = "deflects the arm by"
    _check("alpha_rad", peaks[:, 1], alpha_rad, text, "rad", Ts)
    turned = float(x[-1, 0])
    return Rehearsal(
        revolutions=float(turns.max()),
        alpha_rad=float(peaks[:, 1].max()),
        turned_rad=turned,
        theta_1_rad=None if theta_1_rad is None else theta_1_rad + turned,
    )


def rehearse_outputs(u: ArrayLike, Ts: float, described: Description) -> Rehearsal:
    """Return the response of a described rig with matrices to `u`, from its values at u = 0.

    The values at the samples are exact; a dead time is rounded to whole samples.

    Raises
    ------
    InputError
        An output leaves its limits, or the model in a file has another sampling time.
    """
    # Imported here: a reader of a stored rehearsal does not need scipy.
    from armrig_core.rig.arm import zero_order_hold
    from armrig_core.rig.description import require_model

    model, system = require_model(described)
    Phi, Gamma = np.array(system.A), np.array(system.B)
    if system.Ts is None:
        Phi, Gamma = zero_order_hold(Phi, Gamma, Ts)
    elif abs(system.Ts - Ts) > 1e-9:
        raise InputError(
            f"Ts = {Ts:g} s: the model in {model.file} has Ts = {system.Ts:g} s; record with this "
            "sampling time, or identify a model from a recording at yours"
        )
    volts = np.asarray(u, dtype=np.float64)
    late = min(round(model.delay_s / Ts), volts.size)
    x = _states(Phi, Gamma[:, 0], np.concatenate([np.zeros(late), volts[: volts.size - late]]))
    y = x @ np.array(system.C).T + (model.offset or [0.0] * len(described.outputs))
    for i, (name, output) in enumerate(described.outputs.items()):
        outside = ~((y[:, i] >= output.low) & (y[:, i] <= output.high))
        if outside.any():
            k = int(np.argmax(outside))
            end = "high" if y[k, i] > output.high else "low"
            raise InputError(
                f"the rehearsal takes {name} from {y[:, i].min():.3g} to {y[:, i].max():.3g} "
                f"{output.unit}: {name}.{end} = {getattr(output, end):g} is passed after "
                f"{k * Ts:.3g} s; shorten the input or change its voltages"
            )
    ranges = {
        name: (float(y[:, i].min()), float(y[:, i].max()), output.unit)
        for i, (name, output) in enumerate(described.outputs.items())
    }
    return Rehearsal(outputs=ranges)


def _check(key: str, values: _Array, limit: float, does: str, unit: str, Ts: float) -> None:
    """Refuse the input if any of `values`, one for each sample of u, reaches the limit."""
    reached = values >= limit
    if not limit or not reached.any():
        return
    i = int(np.argmax(reached))
    raise InputError(
        f"the rehearsal {does} up to {values.max():.3g} {unit}: limits.{key} = {limit:g} is "
        f"reached at u[{i}], {i * Ts:.3g} s; shorten the input or lower its voltages, "
        f"or raise limits.{key}"
    )


def _steps(
    parameters: ArmParameters | None, arm_removed: bool, Ts: float, N: int
) -> tuple[_Array, _Array, int]:
    """Return Phi (4, 4) and Gamma (4, 1) of one step, and the number of steps in one Ts."""
    # Imported here: a reader of a stored rehearsal does not need scipy.
    from armrig_core.rig.arm import ArmParameters, arm_matrices, chassis_matrices, zero_order_hold

    p = parameters or ArmParameters()
    swing = 0.0 if arm_removed else sqrt(p.K_lin / p.J_1 + p.K_lin / p.J_2)  # undamped, rad/s
    m = max(1, min(ceil(Ts * swing / _STEP_PHASE_RAD), MOST_POINTS // N))
    A, B, _ = arm_matrices(p)
    if arm_removed:
        A, B = np.zeros_like(A), np.zeros_like(B)
        A[np.ix_([0, 2], [0, 2])], B[[0, 2]], _ = chassis_matrices(p)
    Phi, Gamma = zero_order_hold(A, B, Ts / m)
    return Phi, Gamma, m


def _augmented(Phi: _Array, Gamma: _Array) -> _Array:
    """Return the matrix that maps (x, u) to (x, u) of the next step, with u held."""
    both = np.eye(5)
    both[:4, :4], both[:4, 4:] = Phi, Gamma
    return both


def _states(Phi: _Array, Gamma: _Array, u: _Array) -> _Array:
    """Return x (N + 1, 4) of x[k+1] = Phi x[k] + Gamma u[k] from x[0] = 0, block by block."""
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
    first = np.zeros((blocks, n))
    for b in range(1, blocks):
        first[b] = powers[-1] @ first[b - 1] + x[b - 1, -n:]
    x += first @ np.concatenate([power.T for power in powers[1:]], axis=1)
    return np.concatenate([np.zeros((1, n)), x.reshape(-1, n)[:N]])
