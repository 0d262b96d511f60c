"""One-step prediction errors of A y = (B/F) u + (C/D) e for data with an unknown past.

For given C, D and F the prediction errors are linear in A, B and all unknown quantities::

    e = (D/C) (A y - (B u + x) / F - trend) - z/C

The pulses x represent the state of B/F at the start of an experiment. The pulses z represent the
unknown past of the noise model, at the start of an experiment and after each gap in y. No pulses x
are needed after a gap, because u is known during the gap. The trend is a level, or a level and a
ramp if F has an integrator.

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 3.2 and 10.2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from armrig.data.dataset import Dataset
from armrig.models.structure import Structure
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.polynomial import Array, filtered, lagged
from armrig.numerics.stretches import Mask, stretches

_SETTLED_SHARE = 1e-18  # share of the largest value below which an impulse response is 0
_FIRST_RESPONSE_SAMPLES = 256  # samples


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """Signals of one experiment with interpolated y, and a mask of the prediction errors."""

    u: Array
    """Input (N,), summed if F integrates."""
    y: Array
    """Output (N,), missing values interpolated; differenced if A integrates."""
    rows: Mask
    """Rows (N,) that have a prediction error."""
    stretches: tuple[slice, ...]
    """Slices of the segments that have prediction errors; a segment contains no gap in y."""
    whole: bool
    """True if every sample has a prediction error."""


def prepared(part: Dataset, structure: Structure) -> Experiment:
    """Return the signals of one experiment for a structure.

    A gap in y divides the experiment into segments. Without C, the first errors of a segment depend
    on unknown samples and are not used. With C, these errors are used, and the unknown past is
    estimated. A segment that is not longer than its unknown past is left out.
    """
    u, y, valid = part.u, part.y, part.valid
    if structure.integrator == "f":
        u = summed_input(u, centred=not structure.at_rest)
    if structure.integrator == "a":
        y = np.diff(y, prepend=0.0 if structure.at_rest else np.nan)
        valid = np.isfinite(y)
    if structure.white:
        rows, used = valid, [slice(0, valid.size)]
    else:
        rows = np.zeros_like(valid)
        used = []
        for s in stretches(valid):
            unknown = forgotten(structure, s.start)
            if s.stop - s.start > unknown:
                rows[s.start + (0 if structure.nc else unknown) : s.stop] = True
                used.append(s)
    return Experiment(
        u=u, y=_filled(y, valid), rows=rows, stretches=tuple(used), whole=bool(rows.all())
    )


def forgotten(structure: Structure, start: int) -> int:
    """Return the number of pulses that represent the past of a segment that begins at `start`."""
    if start == 0 and structure.at_rest:
        return 0
    return max(structure.memory, structure.first - start)


def summed_input(u: Array, *, centred: bool) -> Array:
    """Return the sum U of u, so that B/F u = B/F̃ U for F = (1 - q^-1) F̃.

    If a ramp is estimated, the mean of u is subtracted first (`centred`).
    """
    return np.cumsum(u - np.mean(u)) if centred else np.cumsum(u)


@dataclass(frozen=True, slots=True, kw_only=True)
class Unknown:
    """Orthonormal basis of the effects of the unknown past on the prediction errors."""

    noise: tuple[tuple[slice, Array], ...]
    """Rows and basis of z for each segment. The rows end where the impulse response of 1/C has
    decayed to 0."""
    state: Basis
    """Basis of the effects of x and of the trend, minus the projection of these effects on `noise`.
    Only the first rows are stored; the other rows are 0."""
    volumes: tuple[Callable[[], tuple[float, Array]], ...]
    """For each segment, a function that returns log |Z^T Z| and its gradient with respect to the
    coefficients c of C. The columns of Z are the filtered pulses z. The estimator does not use the
    function of the first segment of all data."""
    N: int
    """Number of samples."""

    def without(self, M: Array) -> Array:
        """Return M (N, k) minus its projection on the basis; M is 0 where e is not known."""
        M = np.array(M, order="F")
        for s, Q in self.noise:
            M[s] -= Q @ (Q.T @ M[s])
        Q = self.state.Q
        if Q.shape[1]:
            M[: Q.shape[0]] -= Q @ (Q.T @ M[: Q.shape[0]])
        return M

    def state_of(self, y: Array) -> Array:
        """Return x and the trend's coefficients, estimated from y (N,) with z projected out."""
        return self.state.coefficients(y[: self.state.Q.shape[0]])

    @property
    def rank(self) -> int:
        """Dimension of the basis."""
        return self.state.rank + sum(int(Q.shape[1]) for _, Q in self.noise)

    @property
    def span(self) -> Array:
        """The basis as columns (N, rank)."""
        whole = np.zeros((self.N, self.rank))
        begin = 0
        for s, Q in (*self.noise, (slice(0, self.state.Q.shape[0]), self.state.Q)):
            whole[s, begin : begin + Q.shape[1]] = Q
            begin += Q.shape[1]
        return whole


def masked(M: Array, experiment: Experiment) -> Array:
    """Return M with zeros in the rows without a prediction error."""
    if experiment.whole:
        return M
    return np.where(experiment.rows if M.ndim == 1 else experiment.rows[:, None], M, 0.0)


def unknown(
    experiment: Experiment, structure: Structure, *, C: Array, D: Array, F: Array
) -> Unknown:
    """Return the basis of the effects of the unknown past on the prediction errors."""
    N = experiment.y.size
    noise, volumes = _noise_bases(experiment, structure, C)
    k = structure.count
    W = _pulses(response(D, np.convolve(C, F), N), k, N) if k else np.zeros((0, 0))
    n = N if structure.trend else W.shape[0]
    for s, Q in noise:
        n = max(n, s.start + Q.shape[0]) if s.start < n else n
    if n > W.shape[0]:
        W = np.vstack([W, np.zeros((n - W.shape[0], k))])
    if structure.trend:
        W = np.hstack([W, *(_noise(D, C, x)[:, None] for x in trend(structure, N).T)])
    if not experiment.whole:
        W = np.where(experiment.rows[:n, None], W, 0.0)
    W = np.array(W, order="F")
    for s, Q in noise:
        if s.start < n:
            W[s] -= Q @ (Q.T @ W[s])
    return Unknown(noise=noise, state=orthonormal(W), volumes=volumes, N=N)


_Bases = tuple[tuple[slice, Array], ...]
_Volumes = tuple[Callable[[], tuple[float, Array]], ...]


def _noise_bases(experiment: Experiment, structure: Structure, C: Array) -> tuple[_Bases, _Volumes]:
    """Return the fields `noise` and `volumes` of `Unknown`, for the pulses z filtered by 1/C."""
    if structure.nc == 0:
        return (), ()
    longest = max((s.stop - s.start for s in experiment.stretches), default=1)
    pulse = response([1.0], C, longest)
    known: dict[tuple[int, int], tuple[Array, Callable[[], tuple[float, Array]]]] = {}
    none = 0.0, np.zeros(structure.nc)
    noise, volumes = [], []
    for s in experiment.stretches:
        k = forgotten(structure, s.start)
        n = min(s.stop - s.start, pulse.size + k - 1)
        if k == 0:
            volumes.append(lambda: none)
            continue
        if (
            k,
            n,
        ) not in known:  # most stretches are longer than the response and have the same basis
            Q, R = np.linalg.qr(_pulses(pulse, k, n))
            known[k, n] = Q, cache(partial(_volume, Q, R, C))
        Q, volume = known[k, n]
        noise.append((slice(s.start, s.start + n), Q))
        volumes.append(volume)
    return tuple(noise), tuple(volumes)


def _volume(Q: Array, R: Array, C: Array) -> tuple[float, Array]:
    """Return log |Z^T Z|, and its gradient with respect to the coefficients c of C.

    The columns of Z = Q R are pulses that were filtered by 1/C.

    d log |Z^T Z| is 2 trace(Z^+ dZ), and the derivative of 1/C with respect to c_k is -q^-k / C².
    """
    n, k = Q.shape
    slope = response([1.0], np.convolve(C, C), n)
    slope = np.append(slope, np.zeros(n - slope.size))
    by_c = np.empty(C.size - 1)
    for j in range(by_c.size):
        columns = lagged(slope, range(j + 1, j + 1 + k))
        by_c[j] = -2 * np.trace(np.linalg.solve(R, Q.T @ columns))
    return 2 * float(np.sum(np.log(np.abs(np.diag(R))))), by_c


def response(numerator: Array | list[float], denominator: Array, N: int) -> Array:
    """Return the impulse response until it has decayed to 1e-18 of its maximum, at most N samples.

    Later samples would be denormal numbers, which make a processor ten times slower.
    """
    n = min(N, _FIRST_RESPONSE_SAMPLES)
    while True:
        pulse = np.zeros(n)
        pulse[0] = 1.0
        h = filtered(numerator, denominator, pulse)
        size = np.abs(h)
        above = size > _SETTLED_SHARE * size.max()
        end = n - int(np.argmax(above[::-1])) if above.any() else 1
        # An oscillation may be small for some samples only. The response ends where all later
        # samples are small.
        if n == N or end < n // 2:
            return h[:end]
        n = min(N, 4 * n)


def _pulses(h: Array, k: int, N: int) -> Array:
    """Return the impulse response h, delayed by 0 … k - 1 samples, as columns of at most N rows."""
    n = min(N, h.size + k - 1)
    return lagged(np.append(h, np.zeros(max(n - h.size, 0)))[:n], range(k))


def trend(structure: Structure, N: int) -> Array:
    """Return the columns of the trend (N, `structure.trend`): ones, then the ramp t + 1."""
    return np.column_stack([np.ones(N), np.arange(1.0, N + 1.0)])[:, : structure.trend]


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearPart:
    """Linear equation of the errors for given C, D and F: y = X [a, b] + unknown + e."""

    X: Array
    """Derivatives of the prediction with respect to (a, b), (N, na + nb); 0 in rows without a
    prediction error."""
    y: Array
    """Signal D/C y, (N,); 0 where the prediction error e is not known."""
    unknown: Unknown
    """Basis of the unknown past."""


def regression(
    experiment: Experiment, structure: Structure, *, C: Array, D: Array, F: Array
) -> LinearPart:
    """Return the linear equation of the errors, for given C, D and F."""
    n = structure
    y = _noise(D, C, experiment.y)
    u = filtered(D, np.convolve(C, F), experiment.u)
    X = lagged(u, range(n.nk, n.nk + n.nb))
    if n.na:
        X = np.hstack([-lagged(y, range(1, n.na + 1)), X])
    return LinearPart(
        X=masked(X, experiment),
        y=masked(y, experiment),
        unknown=unknown(experiment, n, C=C, D=D, F=F),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Prediction errors of one experiment, and their derivatives with respect to c, d and f."""

    e: Array
    """Prediction errors e (N,), 0 where e is not known."""
    Psi: Array
    """Derivatives of the prediction with respect to (c, d, f), (N, nc + nd + nf). Their projection
    on the basis of the unknown past is subtracted."""
    driven: Array
    """Response B/F u from the estimated state, with the trend, (N,)."""
    state: Array
    """Pulses x, then the trend's coefficients."""


def errors(
    experiment: Experiment,
    structure: Structure,
    given: LinearPart,
    *,
    A: Array,
    B: Array,
    C: Array,
    D: Array,
    F: Array,
) -> Errors:
    """Return the errors for given polynomials, with the unknown past estimated by least squares.

    With v = A y - w and w = (B u + x)/F the derivatives of the prediction are ::

        c_k: q^-k e / C,   d_k: -q^-k v / C,   f_k: -(D/C) q^-k w / F

    For each polynomial, one signal is filtered and then shifted.
    """
    n, N = structure, experiment.y.size
    raw = given.y - given.X @ np.append(A[1:], B[n.nk :])
    x = given.unknown.state_of(raw)
    e = given.unknown.without(raw)
    w = filtered(B, F, experiment.u)
    if n.count:
        free = response(x[: n.count], F, N)
        w[: free.size] += free
    driven = w + trend(n, N) @ x[n.count :] if n.trend else w
    Psi = np.zeros((N, n.nc + n.nd + n.nf), order="F")
    by_c, by_d, by_f = np.split(Psi, [n.nc, n.nc + n.nd], axis=1)
    if n.nc:
        _shift_into(by_c, filtered([1.0], C, e))
    if n.nd:
        v = driven - (filtered(A, [1.0], experiment.y) if n.na else experiment.y)
        _shift_into(by_d, filtered([1.0], C, v))
    if n.nf:
        _shift_into(by_f, -filtered(D, np.convolve(C, F), w))
    return Errors(e=e, Psi=given.unknown.without(masked(Psi, experiment)), driven=driven, state=x)


def _shift_into(columns: Array, x: Array) -> None:
    """Write q^-1 x, q^-2 x … into the columns."""
    for k in range(columns.shape[1]):
        columns[k + 1 :, k] = x[: max(x.size - k - 1, 0)]


def _noise(D: Array, C: Array, x: Array) -> Array:
    return x if C.size == D.size == 1 else filtered(D, C, x)


def _filled(y: Array, valid: Mask) -> Array:
    """Return y with missing values interpolated."""
    if valid.all():
        return y
    if not valid.any():
        return np.zeros(y.size)
    t = np.arange(y.size)
    return np.interp(t, t[valid], y[valid])
