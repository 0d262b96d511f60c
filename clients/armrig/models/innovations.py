"""One-step prediction errors of A y = sum of (B_j/F_j) u_j + (C/D) e with an unknown past.

For given C, D and F the prediction errors are linear in A, B and all unknown quantities::

    e = (D/C) (A y - sum of (B_j u_j + x_j) / F_j - trend) - z/C

The pulses x represent the state of each B/F at the start of an experiment. The pulses z represent
the unknown past of the noise model. The trend is a level, or a level and a ramp if F has an
integrator. After a gap in y, the filter D A/C becomes a Kalman filter: `NoiseFilter`. It depends on
A, so that the errors are then linear in A no more. No pulses x are needed after a gap, because u is
known during the gap.

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 3.2 and 10.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise

import numpy as np

from armrig.models.noise_filter import NoiseFilter, NoiseProjection, noise_filter, noise_projection
from armrig.models.structure import Structure
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.polynomial import Array, apply_filter, lag_columns, shift_into
from armrig.numerics.stretches import Mask, stretches

_SETTLED_SHARE = 1e-18  # share of the largest value below which an impulse response is 0
_FIRST_RESPONSE_SAMPLES = 256  # samples


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """Signals of one experiment with interpolated y, and a mask of the prediction errors."""

    u: Array
    """Inputs (N, nu), summed if F integrates."""
    y: Array
    """Output (N,), missing values interpolated; differenced if A integrates."""
    known: Mask
    """Rows (N,) in which y is measured."""
    rows: Mask
    """Rows (N,) that have a prediction error."""
    begin: int
    """First sample of y."""
    gaps: bool
    """True if y has gaps and the structure has a C or a D."""
    whole: bool
    """True if every sample has a prediction error."""


def prepare(u: Array, y: Array, structure: Structure) -> Experiment:
    """Return the signals of one experiment for a structure, from u (N, nu) or (N,) and y (N,).

    A missing y is NaN. Without C, the first errors depend on samples before the data and are not
    used. With C, these errors are used, and the unknown past is estimated. If the measured samples
    are not more than the unknown past, no error is used. Without C and D, the first errors after
    each gap are not used either.
    """
    u = u.reshape(y.size, -1)
    if structure.integrator == "f":
        u = np.column_stack([input_sum(x, centred=not structure.at_rest) for x in u.T])
    if structure.integrator == "a":
        y = np.diff(y, prepend=0.0 if structure.at_rest else np.nan)
    measured = np.isfinite(y)
    parts = stretches(measured)
    begin = parts[0].start if parts else 0
    gaps = len(parts) > 1 and structure.nc + structure.nd > 0
    rows = measured.copy()
    if gaps or (structure.nc and parts):
        rows &= np.count_nonzero(measured) > structure.past_pulse_count(begin)
    elif not structure.white:
        for s in parts:
            rows[s.start : min(s.start + structure.past_pulse_count(s.start), s.stop)] = False
    return Experiment(
        u=np.asfortranarray(u),
        y=interpolate(y),
        known=measured,
        rows=rows,
        begin=begin,
        gaps=gaps,
        whole=bool(rows.all()),
    )


def interpolate(y: Array) -> Array:
    """Return y (N,) with missing values interpolated; 0 if all are missing."""
    measured = np.isfinite(y)
    if measured.all():
        return y
    t = np.arange(y.size)
    return np.interp(t, t[measured], y[measured]) if measured.any() else np.zeros(y.size)


def with_output(x: Experiment, structure: Structure, y: Array) -> Experiment:
    """Return the experiment with the output y (N,) in place of an output with gaps."""
    rows = np.arange(y.size) >= x.begin
    pulses = 0 if structure.nc else structure.past_pulse_count(x.begin)
    rows[x.begin : x.begin + pulses] = False
    return replace(
        x, y=y, known=np.arange(y.size) >= x.begin, rows=rows, gaps=False, whole=bool(rows.all())
    )


def input_sum(u: Array, *, centred: bool) -> Array:
    """Return the sum U of u, so that B/F u = B/F̃ U for F = (1 - q^-1) F̃.

    If a ramp is estimated, the mean of u is subtracted first (`centred`).
    """
    return np.cumsum(u - np.mean(u)) if centred else np.cumsum(u)


@dataclass(frozen=True, slots=True, kw_only=True)
class UnknownPast:
    """Orthonormal basis of the effects of the unknown past on the prediction errors."""

    basis: Basis
    """Basis of the effects of z, of x and of the trend. Only the first rows are stored; the other
    rows are 0."""
    pulses: int
    """Number of pulses z."""
    N: int
    """Number of samples."""

    def without(self, M: Array) -> Array:
        """Return M (N, k) minus its projection on the basis; M is 0 where e is not known."""
        M = np.array(M, order="F")
        Q = self.basis.Q
        if Q.shape[1]:
            M[: Q.shape[0]] -= Q @ (Q.T @ M[: Q.shape[0]])
        return M

    def along(self, y: Array) -> Array:
        """Return the coefficients (r,) of the projection of y (N,) on the basis."""
        return np.asarray(self.basis.Q.T @ y[: self.basis.Q.shape[0]])

    def coefficients(self, y: Array) -> Array:
        """Return z, x and the trend's coefficients, estimated from y (N,)."""
        return np.asarray(self.basis.W @ self.along(y))

    @property
    def rank(self) -> int:
        """Dimension of the basis."""
        return self.basis.rank

    @property
    def span(self) -> Array:
        """The basis as columns (N, rank)."""
        columns = np.zeros((self.N, self.rank))
        columns[: self.basis.Q.shape[0]] = self.basis.Q
        return columns


def mask_rows(M: Array, experiment: Experiment) -> Array:
    """Return M with zeros in the rows without a prediction error."""
    if experiment.whole:
        return M
    return np.where(experiment.rows if M.ndim == 1 else experiment.rows[:, None], M, 0.0)


def unknown(
    x: Experiment, structure: Structure, *, C: Array, D: Array, F: Sequence[Array]
) -> UnknownPast:
    """Return the basis of the effects of the unknown past on the errors of data without a gap."""
    n, N = structure, x.y.size
    columns: list[tuple[int, Array]] = []  # first sample, and effect from this sample on
    pulses = n.past_pulse_count(x.begin) if n.nc else 0
    if pulses:
        z = response([1.0], C, N - x.begin)
        columns += [(x.begin + k, z) for k in range(pulses)]
    for count, group in zip(n.counts, n.groups, strict=True):
        if count:
            h = response(D, np.convolve(C, F[group[0]]), N)
            columns += [(k, h) for k in range(count)]
    columns += [(0, _noise(D, C, column)) for column in trend(n, N).T]
    ends = [begin + h.size for begin, h in columns]
    W = np.zeros((min(N, max(ends, default=0)), len(columns)), order="F")
    for j, (begin, h) in enumerate(columns):
        W[begin : begin + h.size, j] = h[: max(W.shape[0] - begin, 0)]
    if not x.whole:
        W = np.where(x.rows[: W.shape[0], None], W, 0.0)
    return UnknownPast(basis=orthonormal(W), pulses=pulses, N=N)


def volume(x: Experiment, structure: Structure, C: Array) -> tuple[float, Array]:
    """Return log |Z^T Z|, and its gradient with respect to the coefficients c of C.

    The columns of Z are the pulses z at the start of an experiment, filtered by 1/C. The logarithm
    changes by 2 trace(Z^+ dZ), and the derivative of 1/C with respect to c_k is -q^-k / C².
    """
    k, N = structure.past_pulse_count(x.begin), x.y.size - x.begin
    if structure.nc == 0 or k == 0 or not x.rows.any():
        return 0.0, np.zeros(structure.nc)
    Q, R = np.linalg.qr(_pulses(response([1.0], C, N), k, N))
    n = Q.shape[0]
    slope = response([1.0], np.convolve(C, C), n)
    slope = np.append(slope, np.zeros(n - slope.size))
    by_c = np.empty(C.size - 1)
    for j in range(by_c.size):
        columns = lag_columns(slope, range(j + 1, j + 1 + k))
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
        h = apply_filter(numerator, denominator, pulse)
        size = np.abs(h)
        above = np.flatnonzero(size > _SETTLED_SHARE * size.max())
        end = int(above[-1]) + 1 if above.size else 1
        # An oscillation may be small for some samples only. The response ends where all later
        # samples are small.
        if n == N or end < n // 2:
            return h[:end]
        n = min(N, 4 * n)


def _pulses(h: Array, k: int, N: int) -> Array:
    """Return the impulse response h, delayed by 0 … k - 1 samples, as columns of at most N rows."""
    n = min(N, h.size + k - 1)
    return lag_columns(np.append(h, np.zeros(max(n - h.size, 0)))[:n], range(k))


def trend(structure: Structure, N: int) -> Array:
    """Return the columns of the trend (N, `structure.trend`): ones, then the ramp t + 1."""
    return np.column_stack([np.ones(N), np.arange(1.0, N + 1.0)])[:, : structure.trend]


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearPart:
    """Linear equation of the errors for given polynomials: y = X [a, b] + unknown + e."""

    X: Array
    """Derivatives of the prediction with respect to (a, b), (N, na + nb), or to b alone if A is
    given; 0 in rows without a prediction error."""
    y: Array
    """Signal D/C y, or D/C A y if A is given, (N,); 0 where the prediction error is not known."""
    unknown: UnknownPast
    """Basis of the unknown past."""
    noise: NoiseFilter | NoiseProjection | None = None
    """Filter of data with gaps."""

    @property
    def log_scale(self) -> float:
        """Sum of log s(t) over the measured samples, 0 for data without a gap."""
        return 0.0 if self.noise is None else self.noise.log_scale


def regression(
    x: Experiment,
    structure: Structure,
    *,
    C: Array,
    D: Array,
    F: Sequence[Array],
    A: Array | None = None,
    innovations: bool = False,
) -> LinearPart:
    """Return the linear equation of the errors, for given C, D and F of each input.

    A may be given, too; after gaps in y it must be given. The errors of data with gaps are scaled
    `innovations`, or have the same sum of squares, and are computed much faster.
    """
    n = structure
    if x.gaps and n.nc + n.nd:
        product = D if A is None else np.convolve(A, D)
        noise = None if innovations else noise_projection(C, product, x.rows)
        return _regression_with_gaps(x, n, noise or noise_filter(C, product, x.rows), F=F, d=D)
    inputs = [
        lag_columns(apply_filter(D, np.convolve(C, F[j]), x.u[:, j]), n.lags(j))
        for j in range(len(n.nb))
    ]
    y = _noise(D, C, x.y)
    if n.na and A is None:
        inputs.insert(0, -lag_columns(y, range(1, n.na + 1)))
    elif n.na and A is not None:
        y = apply_filter(A, [1.0], y)
    X = inputs[0] if len(inputs) == 1 else np.hstack(inputs)
    return LinearPart(X=mask_rows(X, x), y=mask_rows(y, x), unknown=unknown(x, n, C=C, D=D, F=F))


def _regression_with_gaps(
    x: Experiment,
    n: Structure,
    noise: NoiseFilter | NoiseProjection,
    *,
    F: Sequence[Array],
    d: Array,
) -> LinearPart:
    """Return the linear equation of the errors of a filter, whose D is the product of d and A."""
    N = x.y.size
    inputs = [lag_columns(apply_filter(d, F[j], x.u[:, j]), n.lags(j)) for j in range(len(n.nb))]
    pulse = np.append(1.0, np.zeros(N - 1))
    pulses = n.past_pulse_count(0)
    past = [lag_columns(pulse, range(pulses))]
    for count, group in zip(n.counts, n.groups, strict=True):
        past.append(lag_columns(apply_filter(d, F[group[0]], pulse), range(count)))
    past += [apply_filter(d, [1.0], column)[:, None] for column in trend(n, N).T]
    widths = sum(n.nb)
    both = noise.responses(np.hstack([*inputs, *past]))
    return LinearPart(
        X=both[:, :widths],
        y=noise.innovations(x.y),
        unknown=UnknownPast(basis=orthonormal(both[:, widths:]), pulses=pulses, N=N),
        noise=noise,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Prediction errors of one experiment, and their derivatives."""

    e: Array
    """Prediction errors e (N,), 0 where e is not known. After gaps the errors are scaled to the
    variance of e."""
    Psi: Array
    """Derivatives of the prediction with respect to (c, d, f of each group), or to (a, c, d, f) if
    A was given, (N, n). Their projection on the basis of the unknown past is not subtracted."""
    driven: Array
    """Sum of the responses B/F u from the estimated state, with the trend, (N,)."""
    state: Array
    """Pulses x, then the trend's coefficients."""
    by_scale: Array
    """Derivatives of the sum of log s(t) with respect to the same parameters as Psi, (n,)."""
    y: Array
    """Output (N,), predicted from its past where it is missing in data with gaps."""


def errors(
    x: Experiment,
    structure: Structure,
    linear: LinearPart,
    *,
    A: Array,
    B: Sequence[Array],
    C: Array,
    D: Array,
    F: Sequence[Array],
    along: Array | None = None,
) -> Errors:
    """Return the errors for given polynomials, with the unknown past estimated by least squares.

    With w_j = (B_j u_j + x_j)/F_j and v = A y - sum of w_j the derivatives of the prediction are ::

        a_k: -(D/C) q^-k y,   c_k: q^-k e / C,   d_k: -q^-k v / C,   f_jk: -(D/C) q^-k w_j / F_j

    For each polynomial, one signal is filtered and then shifted. `along` (r,) are the coefficients
    of the basis of the unknown past, if they are estimated from other outputs, too.
    """
    n, N = structure, x.y.size
    b = np.concatenate([p[k:] for p, k in zip(B, n.nk, strict=True)])
    linear_a = n.na > 0 and linear.X.shape[1] > b.size
    raw = linear.y - linear.X @ (np.append(A[1:], b) if linear_a else b)
    past = linear.unknown
    along = past.along(raw) if along is None else along
    unknowns = past.basis.W @ along
    pulses, state = unknowns[: past.pulses], unknowns[past.pulses :]
    e = raw.copy()
    e[: past.basis.Q.shape[0]] -= past.basis.Q @ along
    driven = trend(n, N) @ state[sum(n.counts) :] if n.trend else np.zeros(N)
    responses, begin = [], 0
    if n.white and x.whole and len(n.groups) == 1:  # e is y - driven: no filter is needed
        responses.append((x.y - e - driven, F[n.groups[0][0]]))
        driven = x.y - e
    else:
        for count, group in zip(n.counts, n.groups, strict=True):
            w = apply_filter(B[group[0]], F[group[0]], x.u[:, group[0]])
            for j in group[1:]:
                w += apply_filter(B[j], F[j], x.u[:, j])
            if count:
                free = response(state[begin : begin + count], F[group[0]], N)
                w[: free.size] += free
            begin += count
            driven += w
            responses.append((w, F[group[0]]))
    sizes = (0 if linear_a else n.na, n.nc, n.nd, *n.sizes)
    Psi = np.zeros((N, sum(sizes)), order="F")
    ends = pairwise(accumulate(sizes, initial=0))
    by_a, by_c, by_d, *by_f = (Psi[:, begin:end] for begin, end in ends)
    by_scale = np.zeros(Psi.shape[1])
    if linear.noise is not None:
        z = apply_filter(D, [1.0], driven)
        z[: pulses.size] += pulses
        of_noise, of_scale = linear.noise.derivatives(x.y, z)
        by_c[:], by_product = -of_noise[:, : n.nc], -of_noise[:, n.nc :]
        for columns, factor, at in ((by_a, D, 0), (by_d, A, n.na + n.nc)):
            T = lag_columns(np.append(factor, np.zeros(n.na + n.nd)), range(columns.shape[1]))
            T = T[: n.na + n.nd]
            columns[:] = by_product @ T
            by_scale[at : at + columns.shape[1]] = of_scale[n.nc :] @ T
        by_scale[n.na : n.na + n.nc] = of_scale[: n.nc]
        by_d += linear.noise.responses(lag_columns(driven, range(1, n.nd + 1)))
        for columns, (w, p) in zip(by_f, responses, strict=True):
            moved = lag_columns(apply_filter(D, p, w), range(1, columns.shape[1] + 1))
            columns[:] = -linear.noise.responses(moved)
        y = np.where(x.known, x.y, linear.noise.predictions(x.y, z))
        return Errors(e=e, Psi=Psi, driven=driven, state=state, by_scale=by_scale, y=y)
    if by_a.size:
        shift_into(by_a, -_noise(D, C, x.y))
    if n.nc:
        shift_into(by_c, apply_filter([1.0], C, e))
    if n.nd:
        v = driven - (apply_filter(A, [1.0], x.y) if n.na else x.y)
        shift_into(by_d, apply_filter([1.0], C, v))
    for columns, (w, p) in zip(by_f, responses, strict=True):
        if columns.size:
            shift_into(columns, -apply_filter(D, np.convolve(C, p), w))
    Psi = mask_rows(Psi, x)
    return Errors(e=e, Psi=Psi, driven=driven, state=state, by_scale=by_scale, y=x.y)


def _noise(D: Array, C: Array, x: Array) -> Array:
    return x if C.size == D.size == 1 else apply_filter(D, C, x)
