"""Start values of a search over the matrices Abar and C of a state-space model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from armrig_core.errors import InputError

from armrig.estimation.state_space_problem import (
    StateSpaceProblem,
    reflect_eigenvalues,
    stable_matrix,
)
from armrig.estimation.subspace import (
    complete_stretches,
    long_regression,
    projection,
    realise,
    windows,
)
from armrig.models.innovations import interpolate
from armrig.numerics.polynomial import Array

_MIN_LAGS = 10
_MOVED_MODES = 2  # weakest modes that are moved
_MOVED_MODULUS = 0.8  # modulus of a moved mode


def starts(
    problem: StateSpaceProblem, signals: Sequence[tuple[Array, Array]]
) -> dict[str, tuple[Array, Array]]:
    """Return the pairs (Abar, C) of subspace estimates and of reduced ARX models, by name."""
    n = problem.order
    ny = signals[0][1].shape[1]
    signals = [(u, np.apply_along_axis(interpolate, 0, y)) for u, y in signals]
    pairs: dict[str, tuple[Array, Array]] = {}
    N = sum(u.shape[0] for u, _ in signals)
    width = signals[0][0].shape[1] + ny
    most = max(N // (6 * width), 1)
    for horizon in dict.fromkeys(
        max(min(h, most), -(-n // ny) + 1) for h in (n + 2, max(_MIN_LAGS, 2 * n + 2))
    ):
        stretches = complete_stretches(signals, 4 * horizon)
        if not stretches:
            continue
        w = windows(stretches, past=horizon, future=horizon)
        for weights in ("cva", "moesp"):
            space = realise(w, projection(w, weights), n)
            Abar = space.A - space.gain() @ space.C if problem.noise else space.A
            pairs[f"n4sid, {weights}, horizon {horizon}"] = (Abar, space.C)
    for lags in dict.fromkeys(max(min(k, most), n + 1) for k in (2 * n + 2, 4 * n + 10)):
        stretches = complete_stretches(signals, 2 * lags)
        if not stretches:
            continue
        psi = long_regression(stretches, lags, direct=problem.direct)
        if not problem.noise:
            psi = _simulate_impulses(psi, signals[0][0].shape[1], 2 * lags)
        pairs[f"ARX of order {lags}"] = _from_impulses(psi, n)
    stable = {
        name: (reflect_eigenvalues(Abar), C)
        for name, (Abar, C) in pairs.items()
        if np.isfinite(C).all() and stable_matrix(reflect_eigenvalues(Abar))
    }
    if not stable:
        raise InputError(
            f"order={n}: no start value was found; lower the order, or interpolate missing samples"
        )
    return stable


def starts_with_moved_eigenvalue(
    problem: StateSpaceProblem, Abar: Array, C: Array
) -> dict[str, tuple[Array, Array]]:
    """Return start values (Abar, C) in which one weak mode has another frequency.

    The mode, a complex pair or two real eigenvalues, is moved into the widest gap between the
    frequencies of the other modes.
    """
    z, V = np.linalg.eig(Abar)
    at = problem.linear(Abar, C).at
    inputs = np.linalg.norm(np.linalg.solve(V, np.hstack([at.Bbar, at.K])), axis=1)
    strength = np.linalg.norm(C @ V, axis=0) * inputs / (1 - np.abs(z))
    real = [int(i) for i in np.argsort(z.real) if z[i].imag == 0]
    modes = [(int(i), int(np.argmin(np.abs(z - z[i].conj())))) for i in np.flatnonzero(z.imag > 0)]
    modes += list(zip(real[::2], real[1::2], strict=False))
    modes.sort(key=lambda mode: float(strength[list(mode)].max()))
    pairs = {}
    for i, k in modes[:_MOVED_MODES]:
        others = np.delete(z, [i, k])
        angles = np.sort(np.concatenate([[0.0, np.pi], np.abs(np.angle(others))]))
        gaps = np.diff(angles)
        omega = float(angles[np.argmax(gaps)] + gaps.max() / 2)
        pole = _MOVED_MODULUS * np.exp(1j * omega)
        first = V[:, i] if z[i].imag else V[:, i] + 1j * V[:, k]
        eigenvalues, vectors = z.astype(complex), V.astype(complex)
        eigenvalues[[i, k]] = pole, pole.conjugate()
        vectors[:, i], vectors[:, k] = first, first.conj()
        moved = np.real(vectors @ np.diag(eigenvalues) @ np.linalg.inv(vectors))
        if stable_matrix(moved):
            pairs[f"mode at {abs(np.angle(z[i])):.2f} moved to {omega:.2f} rad"] = (moved, C)
    return pairs


def _simulate_impulses(psi: Array, nu: int, length: int) -> Array:
    """Return the responses (length, ny, nu) from u to y, given the predictor's responses psi."""
    lags, ny, _ = psi.shape
    g = np.zeros((length, ny, nu))
    g[:lags] = psi[:length, :, :nu]
    for k in range(length):
        for m in range(min(k, lags)):
            g[k] += psi[m, :, nu:] @ g[k - m - 1]
    return g


def _from_impulses(impulses: Array, order: int) -> tuple[Array, Array]:
    """Return A and C of the impulse response (k, ny, m), from its Hankel matrix (Ho and Kalman)."""
    k, ny, _ = impulses.shape
    r = (k + 1) // 2
    H = np.block([[impulses[a + b] for b in range(k - r + 1)] for a in range(r)])
    U, s, _ = np.linalg.svd(H, full_matrices=False)
    Gamma = U[:, :order] * np.sqrt(s[:order])
    return np.linalg.pinv(Gamma[:-ny]) @ Gamma[ny:], Gamma[:ny]
