"""Errors and Jacobian of one output and one input without gaps, in few operations.

A search evaluates them a thousand times on short data, on which layers of values would take most
of the time. The equations are those of `models.innovations`. The linear parameters are the pulses
z and x, the trend, A and B. A QR decomposition of their columns W and of the signal D/C y projects
them out::

    [W, D/C y] = Q [R, r; 0, rho],   J = rows d+1 … N of Q^T Psi,   e = (rho, 0 … 0)
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import accumulate

import numpy as np
from scipy.linalg.blas import dtrsv
from scipy.linalg.lapack import dgeqrf, dormqr

from armrig.models.innovations import Experiment, response, trend
from armrig.models.structure import Structure
from armrig.numerics.least_squares import column_norms, upper_ones
from armrig.numerics.polynomial import Array, apply_filter, monic, shift_into

# A longer response would contain many denormal numbers, which make a processor ten times slower.
_MAX_WHOLE_RESPONSE = 1024  # samples
_ONE = np.ones(1)
_MIN_COLUMN_REST = 1e-8  # least share of a column that the columns before it do not explain


def project_errors(
    x: Experiment, n: Structure, *, C: Array, D: Array, F: Array
) -> tuple[Array, Callable[[], Array]] | None:
    """Return e (N - d,) and a function that returns J (N - d, n), both multiplied by Q^T.

    The result is None if the linear parameters are nearly dependent.
    """
    N, (pulses, level, begin, first, d) = x.y.size, _ends(n)
    if d >= N:
        return None
    by_input, by_pulse = _with_response(_times(C, F), x.u[:, 0])
    by_output, by_past = _with_response(C, x.y) if n.nc else (x.y, x.y)
    W = np.zeros((N, d + 1), order="F")
    shift_into(W[:, :pulses], by_past, 0)
    shift_into(W[:, pulses:level], _times(D, by_pulse), 0)
    if n.trend:
        ramps = trend(n, N)
        W[:, level:begin] = apply_filter(D, C, ramps.T).T if n.nc + n.nd else ramps
    W[:, d] = y = _times(D, by_output)[:N]
    if n.na:
        shift_into(W[:, begin:first], -y)
    shift_into(W[:, first:d], _times(D, by_input), n.nk[0])
    reflectors, tau, *_ = dgeqrf(W)
    R = reflectors[: d + 1] * upper_ones(d + 1, d + 1)
    if not (np.abs(R.diagonal()) > _MIN_COLUMN_REST * column_norms(R))[:d].all():
        return None
    e = np.zeros(N - d)
    e[0] = R[d, d]

    def J() -> Array:
        solution = dtrsv(R[:d, :d], R[:d, d])
        state, a = solution[pulses:level], solution[begin:first]
        # The response B/F u from the estimated state, filtered by 1/C.
        B = np.zeros(n.nk[0] + n.nb[0])
        B[n.nk[0] :] = solution[first:]
        driven = np.convolve(B, by_input)[:N]
        if state.size:
            free = np.convolve(state, by_pulse)[:N]
            driven[: free.size] += free
        Psi = np.zeros((N, n.nc + n.nd + n.nf[0]), order="F")
        if n.nc:
            shift_into(Psi[:, : n.nc], apply_filter(_ONE, C, y - W[:, :d] @ solution))
        if n.nd:
            v = np.convolve(monic(a), by_output)[:N] if n.na else by_output
            # The trend in v needs no term: filtered by 1/C, it is in the span of W.
            shift_into(Psi[:, n.nc : n.nc + n.nd], driven - v)
            driven = np.convolve(D, driven)[:N]
        if n.nf[0]:
            shift_into(Psi[:, n.nc + n.nd :], apply_filter(-_ONE, F, driven))
        Psi, *_ = dormqr("L", "T", reflectors, tau, Psi, 64 * Psi.shape[1], overwrite_c=1)
        return np.asarray(Psi[d:])

    return e, J


def _with_response(P: Array, x: Array) -> tuple[Array, Array]:
    """Return x (N,) filtered by 1/P, and the impulse response of 1/P."""
    if x.size > _MAX_WHOLE_RESPONSE:
        return apply_filter(_ONE, P, x), response([1.0], P, x.size)
    both = np.zeros((2, x.size))
    both[0], both[1, 0] = x, 1.0
    filtered_x, pulse = apply_filter(_ONE, P, both)
    return filtered_x, pulse


def _times(P: Array, x: Array) -> Array:
    """Return the product of the polynomials P and x; a leading 1 alone is no factor."""
    return x if P.size == 1 else np.convolve(P, x)


@lru_cache
def _ends(n: Structure) -> tuple[int, int, int, int, int]:
    """Return the ends of the pulses z, of x, the trend, A and B in the linear parameters."""
    pulses = n.past_pulse_count(0) if n.nc else 0
    sizes = n.counts[0], n.trend, n.na, n.nb[0]
    pulses, level, begin, first, d = accumulate(sizes, initial=pulses)
    return pulses, level, begin, first, d
