"""The one-step prediction errors of A y = (B/F) u + (C/D) e and what the unknown past does to them.

For given C, D and F the prediction errors are linear in A, B and in everything unknown::

    e = (D/C) (A y - (B u + x) / F - trend) - z/C

where x are pulses for the state of B/F at the start of an experiment, and z pulses for what the
noise model remembers: of before the experiment, and after each gap in y of what was missed. B/F
runs through a gap, since u is known there.

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

_SETTLED = 1e-18  # share of the largest value below which an impulse response is over
_FIRST_LOOK = 256  # samples


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """One experiment as filters need it: without holes, and where there were some."""

    u: Array
    """Input (N,), summed where F integrates."""
    y: Array
    """Output (N,), interpolated where it is missing; differenced where A integrates."""
    rows: Mask
    """(N,), where there is a prediction error."""
    stretches: tuple[slice, ...]
    """Samples without a gap that have prediction errors, where the noise model remembers."""
    whole: bool
    """There is an error at every sample."""


def prepared(part: Dataset, structure: Structure) -> Experiment:
    """Return one experiment's signals for a structure.

    Without C the first errors of a stretch, which look back on what is not known, are left out;
    with C they are kept and the past is estimated, if the stretch is longer than what is unknown.
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
    """Return how many pulses through 1/C stand for the past of a stretch that begins there."""
    if start == 0 and structure.at_rest:
        return 0
    return max(structure.memory, structure.first - start)


def summed_input(u: Array, *, centred: bool) -> Array:
    """Return U with B/F u = B/F̃ U for F = (1 - q^-1) F̃; centred where a ramp is free anyway."""
    return np.cumsum(u - np.mean(u)) if centred else np.cumsum(u)


@dataclass(frozen=True, slots=True, kw_only=True)
class Unknown:
    """Orthonormal basis of what an experiment's unknown past can add to its errors."""

    noise: tuple[tuple[slice, Array], ...]
    """Of each stretch, on its first rows: until the impulse response of 1/C is over."""
    state: Basis
    """Of x and trend, less their projection on the others, on the first rows."""
    volumes: tuple[Callable[[], tuple[float, Array]], ...]
    """Of each stretch log |Z^T Z|, with Z the noise's columns, and its derivatives by c; when they
    are asked for, which is of the second stretch and those after it."""
    N: int
    """Samples."""

    def without(self, M: Array) -> Array:
        """Return M (N, k), zero where there is no error, less its projection on the basis."""
        M = np.array(M, order="F")
        for s, Q in self.noise:
            M[s] -= Q @ (Q.T @ M[s])
        Q = self.state.Q
        if Q.shape[1]:
            M[: Q.shape[0]] -= Q @ (Q.T @ M[: Q.shape[0]])
        return M

    def state_of(self, y: Array) -> Array:
        """Return x and the trend's coefficients for errors y (N,), the noise's past free too."""
        return self.state.coefficients(y[: self.state.Q.shape[0]])

    @property
    def rank(self) -> int:
        """Number of dimensions."""
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
    """Return M with zeros where there is no error."""
    if experiment.whole:
        return M
    return np.where(experiment.rows if M.ndim == 1 else experiment.rows[:, None], M, 0.0)


def unknown(
    experiment: Experiment, structure: Structure, *, C: Array, D: Array, F: Array
) -> Unknown:
    """Return the basis of what the unknown past adds to the errors."""
    N = experiment.y.size
    noise, volumes = _noise_bases(experiment, structure, C)
    k = structure.count
    W = _pulses(response(D, np.convolve(C, F), N), k, N) if k else np.zeros((0, 0))
    n = N if structure.trend else W.shape[0]
    for s, Q in noise:
        n = max(n, s.start + Q.shape[0]) if s.start < n else n
    W = np.vstack([W, np.zeros((n - W.shape[0], k))])
    if structure.trend:
        W = np.hstack([W, *(_noise(D, C, x)[:, None] for x in trend(structure, N).T)])
    W = np.array(np.where(experiment.rows[:n, None], W, 0.0), order="F")
    for s, Q in noise:
        if s.start < n:
            W[s] -= Q @ (Q.T @ W[s])
    return Unknown(noise=noise, state=orthonormal(W), volumes=volumes, N=N)


_Bases = tuple[tuple[slice, Array], ...]
_Volumes = tuple[Callable[[], tuple[float, Array]], ...]


def _noise_bases(experiment: Experiment, structure: Structure, C: Array) -> tuple[_Bases, _Volumes]:
    """Return basis and volume of each stretch's pulses through 1/C."""
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
        if (k, n) not in known:  # most stretches are longer than the response, and so alike
            Q, R = np.linalg.qr(_pulses(pulse, k, n))
            known[k, n] = Q, cache(partial(_volume, Q, R, C))
        Q, volume = known[k, n]
        noise.append((slice(s.start, s.start + n), Q))
        volumes.append(volume)
    return tuple(noise), tuple(volumes)


def _volume(Q: Array, R: Array, C: Array) -> tuple[float, Array]:
    """Return log |Z^T Z| of pulses Z = Q R through 1/C, and its derivatives by c.

    d log |Z^T Z| is 2 trace(Z^+ dZ), and d(1/C) by c_k is -q^-k / C².
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
    """Return the impulse response until it is over, N samples at most.

    Beyond lie denormal numbers, which a processor takes ten times as long for.
    """
    n = min(N, _FIRST_LOOK)
    while True:
        pulse = np.zeros(n)
        pulse[0] = 1.0
        h = filtered(numerator, denominator, pulse)
        largest = float(np.abs(h).max())
        above = np.flatnonzero(np.abs(h) > _SETTLED * largest)
        end = int(above[-1]) + 1 if above.size else 1
        # An oscillation may be small for a while: over is what stays small.
        if n == N or end < n // 2:
            return h[:end]
        n = min(N, 4 * n)


def _pulses(h: Array, k: int, N: int) -> Array:
    """Return pulses at 0 … k - 1 with the response h, until they are over, in N rows at most."""
    n = min(N, h.size + k - 1)
    return lagged(np.append(h, np.zeros(max(n - h.size, 0)))[:n], range(k))


def trend(structure: Structure, N: int) -> Array:
    """Return (N, trend): ones, and the ramp t + 1, which is the sum of a unit input."""
    return np.column_stack([np.ones(N), np.arange(1.0, N + 1.0)])[:, : structure.trend]


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearPart:
    """What is linear in a and b, for given C, D and F: y = X [a, b] + unknown + e."""

    X: Array
    """Derivatives of the prediction by a and b, (N, na + nb), zero where there is no error."""
    y: Array
    """D/C y, (N,), the same."""
    unknown: Unknown
    """What the unknown past adds."""


def regression(
    experiment: Experiment, structure: Structure, *, C: Array, D: Array, F: Array
) -> LinearPart:
    """Return what the errors are linear in, for given C, D and F."""
    n = structure
    y = _noise(D, C, experiment.y)
    u = filtered(D, np.convolve(C, F), experiment.u)
    X = np.hstack([-lagged(y, range(1, n.na + 1)), lagged(u, range(n.nk, n.nk + n.nb))])
    return LinearPart(
        X=masked(X, experiment),
        y=masked(y, experiment),
        unknown=unknown(experiment, n, C=C, D=D, F=F),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """One experiment's prediction errors and how they depend on c, d and f."""

    e: Array
    """(N,), zero where there is none."""
    Psi: Array
    """Derivatives of the prediction by c, d and f, less their projection, (N, nc + nd + nf)."""
    driven: Array
    """B/F u from the estimated state, trend included, (N,)."""
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
    """Return the errors for all polynomials, the unknown past estimated by least squares.

    With v = A y - w and w = (B u + x)/F the derivatives of the prediction are ::

        q^-k e / C  by c_k,   -q^-k v / C  by d_k,   -(D/C) q^-k w / F  by f_k

    Each is a filtered signal, one filter and then shifts.
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
    """Return y, interpolated where it is missing."""
    if valid.all():
        return y
    if not valid.any():
        return np.zeros(y.size)
    t = np.arange(y.size)
    return np.interp(t, t[valid], y[valid])
