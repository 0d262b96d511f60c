"""A run before it is run: the whole input on the model of the arm, held against the limits."""

from __future__ import annotations

from math import ceil, degrees, sqrt, tau
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from armrig_core.errors import InputError

if TYPE_CHECKING:
    from armrig_core.arm import ArmParameters

_Array = NDArray[np.float64]

MOST_POINTS = 20_000_000
"""Points in time that one rehearsal looks at: half a second's work."""
_BLOCK = 64  # samples that one product advances
_PHASE_RAD = 0.2  # of the arm's own swing, between two points: misses 0.5 % of its peak


class Rehearsal(msgspec.Struct, frozen=True, kw_only=True):
    """What the model does under an input, from standstill."""

    revolutions: float
    """Farthest that the chassis gets from where it starts, either way, in turns."""
    alpha_rad: float
    """Largest deflection of the arm, either way, in rad."""
    turned_rad: float
    """Angle by which the chassis has turned at the end, in rad."""
    theta_1_rad: float | None = None
    """Where the chassis then is, turns counted from its start, in rad; None if that is unknown."""


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
    """Return what the arm does under `u`, each held for Ts: exact, from standstill, alpha 0.

    The states at the samples are exact (zero-order hold) but for rounding. Between them the outputs
    are looked at as often as the arm's own swing asks for, at most `MOST_POINTS` times in all: more
    than 0.5 % of a peak is missed only in runs of more than a day.

    Parameters
    ----------
    u : array_like, shape (N,)
        Motor voltage, in V; N >= 1.
    Ts : float
        Sampling time, in s.
    parameters : ArmParameters, optional
        Of the rig; the handout's where they are left out.
    arm_removed : bool, default False
        The rotating part is taken off: the chassis turns alone, and alpha is 0.
    theta_1_rad : float, optional
        Where the chassis starts, in rad.
    revolutions, alpha_rad : float, default 0
        Limits in turns from the start and in rad; 0 is none.

    Raises
    ------
    InputError
        A limit is reached: the device stops at as many turns, too, not beyond them.
    """
    volts = np.asarray(u, dtype=np.float64)
    Phi, Gamma, m = _steps(parameters, arm_removed, Ts, volts.size)
    whole = np.linalg.matrix_power(_augmented(Phi, Gamma), m)
    x = _states(whole[:4, :4], whole[:4, 4], volts)
    # Largest turn and deflection while each u is held, its end included, its beginning not.
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


def sentence(rehearsal: Rehearsal) -> str:
    """Return what was found, in a line for a person."""
    return (
        f"rehearsed on the model: the chassis turns {rehearsal.revolutions:.1f} times and ends "
        f"{degrees(rehearsal.turned_rad):.0f}° from its start; "
        f"the arm deflects by up to {degrees(rehearsal.alpha_rad):.1f}°"
    )


def _check(key: str, values: _Array, limit: float, does: str, unit: str, Ts: float) -> None:
    """Refuse values, one for each sample's hold, that reach a limit."""
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
    """Return Phi (4, 4) and Gamma (4, 1) of one step, and how many steps make one Ts."""
    # Here, not above: who only reads what a rehearsal has said need not load scipy.
    from armrig_core.arm import ArmParameters, arm_matrices, chassis_matrices, zero_order_hold

    p = parameters or ArmParameters()
    swing = 0.0 if arm_removed else sqrt(p.K_lin / p.J_1 + p.K_lin / p.J_2)  # undamped, rad/s
    m = max(1, min(ceil(Ts * swing / _PHASE_RAD), MOST_POINTS // N))
    A, B, _ = arm_matrices(p)
    if arm_removed:
        A, B = np.zeros_like(A), np.zeros_like(B)
        A[np.ix_([0, 2], [0, 2])], B[[0, 2]], _ = chassis_matrices(p)
    Phi, Gamma = zero_order_hold(A, B, Ts / m)
    return Phi, Gamma, m


def _augmented(Phi: _Array, Gamma: _Array) -> _Array:
    """Return the matrix that advances (x, u) with u held."""
    both = np.eye(5)
    both[:4, :4], both[:4, 4:] = Phi, Gamma
    return both


def _states(Phi: _Array, Gamma: _Array, u: _Array) -> _Array:
    """Return x (N + 1, 4) of x[k+1] = Phi x[k] + Gamma u[k] from x[0] = 0, block by block.

    Within a block both responses are products with powers of Phi; only the blocks' first states
    follow one from the other.
    """
    n, N = Phi.shape[0], u.size
    blocks = -(-N // _BLOCK)
    powers = [np.eye(n)]
    for _ in range(_BLOCK):
        powers.append(Phi @ powers[-1])
    impulse = np.array([power @ Gamma for power in powers[:-1]])
    forcing = np.zeros((_BLOCK, _BLOCK, n))
    for i in range(_BLOCK):
        forcing[i, i:] = impulse[: _BLOCK - i]
    padded = np.zeros(blocks * _BLOCK)
    padded[:N] = u
    x = padded.reshape(blocks, _BLOCK) @ forcing.reshape(_BLOCK, _BLOCK * n)
    first = np.zeros((blocks, n))
    for b in range(1, blocks):
        first[b] = powers[-1] @ first[b - 1] + x[b - 1, -n:]
    x += first @ np.concatenate([power.T for power in powers[1:]], axis=1)
    return np.concatenate([np.zeros((1, n)), x.reshape(-1, n)[:N]])
