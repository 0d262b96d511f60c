"""All states of the recursion x(k+1) = Phi x(k) + w(k), computed with few array operations."""

from __future__ import annotations

from math import isqrt

import numpy as np

from armrig.numerics.polynomial import Array, apply_filter, impulse, lag_columns

_SETTLED_SHARE = 1e-18  # share of the largest value below which an impulse response is 0
_MAX_CONDITION = 1e5  # largest condition number of the eigenvectors for a sum over modes


def recursion(Phi: Array, w: Array, x0: Array) -> Array:
    """Return x(0) … x(N) of x(k+1) = Phi x(k) + w(k), for one right-hand side or several.

    Phi is (n, n). For w (N, n), N >= 0, and x0 (n,) the result is (N + 1, n). For m independent
    right-hand sides w (N, m, n) and x0 (m, n) the result is (N + 1, m, n). If Phi is very unstable,
    the states overflow to inf and NaN without a warning.

    The N steps are divided into blocks of about sqrt(N) steps. All blocks are computed in parallel
    from the state zero. The contribution of the actual first state of each block is added
    afterwards. The method needs about 2 sqrt(N) operations on whole arrays instead of N small
    operations. Unlike a transfer function, the recursion loses no digits if poles are close
    together, such as the poles of the arm near 1 at 1 kHz. The method needs no eigenvectors.
    """
    N, n = w.shape[0], Phi.shape[0]
    shape = (N + 1, *w.shape[1:])
    m = w[0].size // n if N else x0.size // n
    length = isqrt(N) + 1
    blocks = N // length + 1
    kind = np.result_type(Phi, w, x0, np.float64)
    padded = np.zeros((blocks * length, m, n), dtype=kind)
    padded[:N] = w.reshape(N, m, n)
    inputs = padded.reshape(blocks, length, m, n)
    from_zero = np.zeros((length + 1, blocks * m, n), dtype=kind)
    powers = np.empty((length + 1, n, n), dtype=kind)
    powers[0] = np.eye(n)
    starts = np.empty((blocks, m, n), dtype=kind)
    starts[0] = x0
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(length):
            from_zero[k + 1] = from_zero[k] @ Phi.T + inputs[:, k].reshape(-1, n)
            powers[k + 1] = Phi @ powers[k]
        ends = from_zero[length].reshape(blocks, m, n)
        for j in range(blocks - 1):
            starts[j + 1] = starts[j] @ powers[length].T + ends[j]
        by_start = starts.reshape(-1, n) @ powers[:length].reshape(-1, n).T
        x = by_start.reshape(blocks, m, length, n).transpose(0, 2, 1, 3)
        x = x + from_zero[:length].reshape(length, blocks, m, n).transpose(1, 0, 2, 3)
    return x.reshape(blocks * length, m, n)[: N + 1].reshape(shape)


def varying_recursion(Phi: Array, w: Array, x0: Array) -> Array:
    """Return x(0) … x(N), (N + 1, m, n), of x(k+1) = Phi(k) x(k) + w(k).

    Phi is (N, n, n). The m right-hand sides w (N, m, n), N >= 1, and the initial states x0 (m, n)
    are independent. The blocks are those of `recursion`; each block has its own products of Phi.
    """
    N, m, n = w.shape
    length = isqrt(N) + 1
    blocks = N // length + 1
    by_block = []
    for values in (Phi, w):
        padded = np.zeros((blocks * length, *values.shape[1:]))
        padded[:N] = values
        by_block.append(padded.reshape(blocks, length, *values.shape[1:]))
    transposed, inputs = by_block[0].swapaxes(2, 3), by_block[1]
    from_zero = np.zeros((length + 1, blocks, m, n))
    products = np.empty((length + 1, blocks, n, n))
    products[0] = np.eye(n)
    starts = np.empty((blocks, m, n))
    starts[0] = x0
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(length):
            from_zero[k + 1] = from_zero[k] @ transposed[:, k] + inputs[:, k]
            products[k + 1] = products[k] @ transposed[:, k]
        for j in range(blocks - 1):
            starts[j + 1] = starts[j] @ products[length, j] + from_zero[length, j]
        x = starts @ products[:length] + from_zero[:length]
    return np.asarray(x.swapaxes(0, 1).reshape(blocks * length, m, n)[: N + 1])


def in_observer_form(Phi: Array, C: Array) -> bool:
    """Return whether C (q - Phi)^-1 e_k is q^-k / c(q) for each unit vector e_k.

    The first column of Phi then contains the coefficients -c_k of the polynomial c.
    """
    n = Phi.shape[0]
    return np.array_equal(C, np.eye(1, n)) and np.array_equal(Phi[:, 1:], np.eye(n, n - 1))


def outputs(Phi: Array, C: Array, w: Array, x0: Array) -> Array:
    """Return C x(0) … C x(N - 1) of x(k+1) = Phi x(k) + w(k), (N, ny)."""
    if not in_observer_form(Phi, C):
        return np.asarray(recursion(Phi, w, x0)[:-1] @ C.T)
    total = np.zeros(w.shape[0])
    for k in range(len(Phi)):
        total[k : k + 1] += x0[k]
        total[k + 1 :] += w[: total.size - k - 1, k]
    return apply_filter([1.0], np.append(1.0, -Phi[:, 0]), total)[:, None]


def free_responses(Phi: Array, C: Array, N: int) -> Array:
    """Return C Phi^t e_k, t = 0 … N - 1, for each unit vector e_k as initial state, (n, ny, N).

    Let L be about sqrt(N). The powers Phi^0 … Phi^L and the powers of Phi^L are computed one by
    one. All other powers are products of these powers.
    """
    n = Phi.shape[0]
    if in_observer_form(Phi, C):
        h = impulse(np.append(1.0, -Phi[:, 0]), N)
        size = np.abs(h)
        settled = np.argmax(size[::-1] > _SETTLED_SHARE * size.max())
        h[N - settled :] = 0.0
        return lag_columns(h, range(n)).T[:, None]
    length = isqrt(N) + 1
    powers = np.empty((length + 1, n, n))
    powers[0] = np.eye(n)
    late = np.empty((length, C.shape[0], n))
    late[0] = C
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(length):
            powers[k + 1] = powers[k] @ Phi
        for j in range(length - 1):
            late[j + 1] = late[j] @ powers[length]
        products = late.reshape(-1, n) @ powers[:length].transpose(1, 0, 2).reshape(n, -1)
    shape = (length, C.shape[0], length, n)
    return products.reshape(shape).transpose(3, 1, 0, 2).reshape(n, -1, length**2)[:, :, :N]


def outputs_from_rest(Phi: Array, C: Array, w: Array) -> Array:
    """Return C x (N, k, ny) of x(t+1) = Phi x + w from rest, for k right-hand sides w (N, k, n).

    As in `responses`, each mode is a first-order filter, unless the eigenvectors are dependent.
    """
    z, V = np.linalg.eig(Phi)
    if np.linalg.cond(V) > _MAX_CONDITION:
        return np.asarray(recursion(Phi, w, np.zeros(w.shape[1:]))[:-1] @ C.T)
    response, to_modes, from_modes = 0.0, np.linalg.inv(V), C @ V
    for i in np.flatnonzero(z.imag >= 0):
        pair = z[i].imag > 0
        along, pole, by = to_modes[i], z[i], from_modes[:, i] * (1 + pair)
        if not pair:
            along, pole, by = along.real, pole.real, by.real
        mode = apply_filter([0.0, 1.0], [1.0, -pole], np.ascontiguousarray((w @ along).T))
        response = response + np.real(mode.T[:, :, None] * by)
    return np.asarray(response)


def responses(Phi: Array, C: Array, signals: Array) -> Array:
    """Return C (q - Phi)^-1 e_k s for each signal s and unit vector e_k, (m, n, ny, N).

    Phi is (n, n) and real, C is (ny, n), and `signals` is (N, m). For each mode, each signal is
    filtered by a first-order filter. If the eigenvectors are nearly dependent, `recursion` is used
    instead, which takes several times as long.
    """
    (N, m), (ny, n) = signals.shape, C.shape
    if in_observer_form(Phi, C):
        each = apply_filter([1.0], np.append(1.0, -Phi[:, 0]), signals.T)
        response = np.zeros((m, n, 1, N))
        for k in range(min(n, N - 1)):
            response[:, k, 0, k + 1 :] = each[:, : N - k - 1]
        return response
    z, V = np.linalg.eig(Phi)
    if np.linalg.cond(V) > _MAX_CONDITION:
        driven = np.zeros((N, m, n, n))
        driven[:, :, range(n), range(n)] = signals[:, :, None]
        x = recursion(Phi, driven.reshape(N, m * n, n), np.zeros((m * n, n)))[:-1]
        return np.ascontiguousarray((x @ C.T).transpose(1, 2, 0)).reshape(m, n, ny, N)
    kept = np.flatnonzero(z.imag >= 0)
    twice = np.where(z[kept].imag > 0, 2.0, 1.0)
    each = np.ascontiguousarray(signals.T)
    modes = np.empty((m, 2 * kept.size, N))  # real parts, then imaginary parts
    for k, i in enumerate(kept):
        pole = z[i] if z[i].imag else z[i].real
        mode = apply_filter([0.0, 1.0], [1.0, -pole], each)
        modes[:, k], modes[:, kept.size + k] = mode.real, mode.imag
    parts = (C @ V[:, kept] * twice)[:, :, None] * np.linalg.inv(V)[kept]  # (ny, modes, n)
    weights = parts.transpose(2, 0, 1).reshape(n * ny, kept.size)
    return np.asarray(np.hstack([weights.real, -weights.imag]) @ modes).reshape(m, n, ny, N)
