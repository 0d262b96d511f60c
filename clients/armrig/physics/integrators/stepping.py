"""Integration of x' = A x + B u: with a fixed step, and exactly for a sinusoidal input."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from numpy.typing import ArrayLike
from scipy.linalg import expm, lu_factor, lu_solve

from armrig.data.columns import Matrix, Vector
from armrig.numerics.checks import require_integers, require_numbers
from armrig.numerics.quantities import plural
from armrig.numerics.recursion import recursion
from armrig.physics.integrators.methods import Multistep, RungeKutta, method_named

Input = Callable[[float], Any]


def system(
    A: ArrayLike, B: ArrayLike, x0: ArrayLike | None = None
) -> tuple[Matrix, Matrix, Matrix]:
    """Return A (n, n), B (n, m) and x0 (n,) as arrays; a B of shape (n,) has one input.

    Raises ValueError if the shapes do not match, or a number is not finite.
    """
    for name, array in (("A", A), ("B", B), ("x0", x0)):
        if array is not None and np.iscomplexobj(np.asarray(array)):
            raise InputError(
                f"{name} is complex: give the real system of twice the size, [[Re, -Im], [Im, Re]]"
            )
    A_ = np.array(A, dtype=np.float64)
    if A_.ndim != 2 or A_.shape[0] != A_.shape[1] or A_.size == 0:
        raise InputError(f"A has shape {A_.shape}, but must be (n, n)")
    n = A_.shape[0]
    B_ = np.array(B, dtype=np.float64)
    if B_.ndim == 1:
        B_ = B_[:, None]
    if B_.ndim != 2 or B_.shape[0] != n or B_.shape[1] == 0:
        raise InputError(
            f"B has shape {np.shape(B)}, with A {A_.shape} it must be ({n},) or ({n}, m)"
        )
    x0_ = np.zeros(n) if x0 is None else np.array(x0, dtype=np.float64)
    if x0_.shape != (n,):
        raise InputError(f"x0 has shape {x0_.shape}, with A {A_.shape} it must be ({n},)")
    for name, value in (("A", A_), ("B", B_), ("x0", x0_)):
        if not np.isfinite(value).all():
            raise InputError(f"{name} contains a number that is not finite")
    return A_, B_, x0_


def require_positive(**values: float) -> None:
    """Refuse a number that is 0, negative, infinite or NaN."""
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name}={value!r} must be finite and > 0")


def exact(
    A: ArrayLike, B: ArrayLike, amplitude: float, omega: float, x0: ArrayLike, t: ArrayLike
) -> Matrix:
    """Return the solution (len(t), nx) of x' = A x + B amplitude sin(omega t), x(0) = x0.

    Sine and cosine are additional states, s' = omega c, c' = -omega s. The solution is then one
    matrix exponential for any A and omega, including integrators and resonance ::

        [x]         [A  B amplitude  0    ]    [x0]
        [s](t) = exp[0  0            omega] t  [0 ]
        [c]         [0  -omega       0    ]    [1 ]

    Parameters
    ----------
    A, B, x0
        As for `armrig.physics.integrate`, with one input.
    amplitude, omega : float
        Amplitude of the input, in its unit, and angular frequency in rad/s.
    t : array_like, shape (N,)
        Times in s, in any order.

    Raises
    ------
    ValueError
        A shape is wrong, there is more than one input, or a number is not finite.

    References
    ----------
    .. [1] C. F. Van Loan, IEEE Trans. Automatic Control 23 (1978) 395-404.

    Examples
    --------
    The integral of sin(pi t) is (1 - cos(pi t))/pi.

    >>> import armrig, numpy as np
    >>> A, B, t = [[0.0]], [1.0], [0.0, 0.5, 1.0]
    >>> x = armrig.physics.exact(A, B, amplitude=1.0, omega=np.pi, x0=[0.0], t=t)
    >>> x[:, 0].round(4)
    array([0.    , 0.3183, 0.6366])
    """
    A_, B_, x0_ = system(A, B, x0)
    require_numbers(amplitude=amplitude, omega=omega)
    times = np.atleast_1d(np.asarray(t, dtype=np.float64))
    if B_.shape[1] != 1 or times.ndim != 1:
        raise InputError(
            f"B has shape {B_.shape} and t {times.shape}; one input and t (N,) are allowed"
        )
    if not (np.isfinite([amplitude, omega]).all() and np.isfinite(times).all()):
        raise InputError(f"amplitude={amplitude!r}, omega={omega!r} and all t must be finite")
    n = A_.shape[0]
    block = np.zeros((n + 2, n + 2))
    block[:n, :n], block[:n, n] = A_, amplitude * B_[:, 0]
    block[n, n + 1], block[n + 1, n] = omega, -omega
    start = np.concatenate([x0_, [0.0, 1.0]])
    # A thousand exponentials at a time, because a million would take 300 MB.
    parts = np.array_split(times, max(1, times.size // 1000))
    return np.concatenate([(expm(block * p[:, None, None]) @ start)[:, :n] for p in parts])


def integrate(
    A: ArrayLike,
    B: ArrayLike,
    u: Input,
    x0: ArrayLike,
    h: float,
    n: int,
    method: str = "forward_euler",
) -> tuple[Vector, Matrix]:
    """Return times t and states x of x' = A x + B u(t), x(0) = x0, computed in n steps of size h.

    With f = A x + B u the multistep methods and the Runge-Kutta methods are ::

        forward_euler  x(k+1) = x(k) + h f(k)                               order 1
        ab2            x(k+1) = x(k) + h (3 f(k) - f(k-1)) / 2              order 2
        trapezoidal    x(k+1) = x(k) + h (f(k) + f(k+1)) / 2                order 2

        heun           x(k+1) = x(k) + h (K1 + K2) / 2                      order 2
                       K1 = f(t, x), K2 = f(t + h, x + h K1)
        midpoint       x(k+1) = x(k) + h f(t + h/2, x + h f(t, x) / 2)      order 2

    The first step of AB(2) is computed by Heun's method. The trapezoidal rule factors I - h A / 2
    once. `armrig.physics.stability_limit` returns the largest stable step of a method.

    Parameters
    ----------
    A : array_like, shape (nx, nx)
        System matrix, in 1/s.
    B : array_like, shape (nx,) or (nx, nu)
        Input matrix.
    u : callable
        Function: time in s -> input, a number or (nu,).
    x0 : array_like, shape (nx,)
        State at t = 0.
    h : float
        Step in s, > 0.
    n : int
        Number of steps, >= 1.
    method : {"forward_euler", "ab2", "trapezoidal", "heun", "midpoint"}
        Name of the method.

    Returns
    -------
    t : ndarray, shape (n + 1,)
        Time in s.
    x : ndarray, shape (n + 1, nx)
        States. If h is above the stability limit, the states grow without bound, up to inf and NaN.

    Raises
    ------
    ValueError
        A shape, the step, the number of steps or the method is not allowed.

    References
    ----------
    .. [1] E. Hairer, S. P. Nørsett, G. Wanner, *Solving Ordinary Differential Equations I*, 1993,
       sections II.1 and III.1.

    Examples
    --------
    >>> import armrig, numpy as np
    >>> t, x = armrig.physics.integrate([[-1.0]], [1.0], lambda t: 1.0, [0.0], 0.1, 10, "heun")
    >>> print(f"x({t[-1]:.0f} s) = {x[-1, 0]:.3f}, exact {1 - np.exp(-1):.3f}")
    x(1 s) = 0.631, exact 0.632
    """
    A_, B_, x0_ = system(A, B, x0)
    require_positive(h=h)
    require_integers(n=(n, 1))
    _require_function(u)
    chosen = method_named(method)
    t = h * np.arange(n + 1, dtype=np.float64)
    if isinstance(chosen, RungeKutta):
        return t, _runge_kutta(chosen, A_, B_, u, x0_, h, n)
    return t, _multistep(chosen, A_, B_, u, x0_, h, n)


def _require_function(u: object) -> None:
    if not callable(u):
        raise InputTypeError(
            f"u is a {type(u).__name__}: give a function of the time in s, such as lambda t: 2.5"
        )


def _input(u: Input, t: Vector, m: int) -> Matrix:
    """Return u at each time, (len(t), m)."""
    values = np.array([np.ravel(u(float(x))) for x in t], dtype=np.float64)
    if values.shape[1] != m:
        raise InputError(f"u(t) returns {plural(values.shape[1], 'number')}, but B takes {m}")
    return values


def _runge_kutta_step(method: RungeKutta, A: Matrix, h: float) -> tuple[Matrix, list[Matrix]]:
    """Return M and W_i of x(k+1) = M x(k) + sum W_i B u(t + c_i h)."""
    size = A.shape[0]
    by_x: list[Matrix] = []
    by_u: list[list[Matrix]] = []
    for row in method.a:
        x_part, u_parts = np.eye(size), [np.zeros((size, size)) for _ in method.b]
        for weight, K_x, K_u in zip(row, by_x, by_u, strict=False):
            x_part = x_part + h * weight * K_x
            u_parts = [old + h * weight * new for old, new in zip(u_parts, K_u, strict=True)]
        u_parts = [A @ part for part in u_parts]
        u_parts[len(by_x)] = u_parts[len(by_x)] + np.eye(size)
        by_x.append(A @ x_part)
        by_u.append(u_parts)
    M = np.eye(size) + h * sum(b * K for b, K in zip(method.b, by_x, strict=True))
    W = [
        np.asarray(h * sum(b * K[i] for b, K in zip(method.b, by_u, strict=True)))
        for i in range(len(method.b))
    ]
    return M, W


def _runge_kutta(
    method: RungeKutta, A: Matrix, B: Matrix, u: Input, x0: Vector, h: float, n: int
) -> Matrix:
    M, W = _runge_kutta_step(method, A, h)
    k = np.arange(n, dtype=np.float64)
    w = np.zeros((n, A.shape[0]))
    for weight, c in zip(W, method.c, strict=True):
        if weight.any():
            w += _input(u, h * (k + c), B.shape[1]) @ (weight @ B).T
    return recursion(M, w, x0)


def _companion(method: Multistep, A: Matrix, h: float) -> Matrix:
    """Return the matrix that advances k successive states by one step, without input."""
    size, k = A.shape[0], len(method.alpha) - 1
    factors = lu_factor(np.eye(size) - h * method.beta[-1] * A)
    M = np.eye(k * size, k=size)
    for j in range(k):
        explicit = -method.alpha[j] * np.eye(size) + h * method.beta[j] * A
        M[-size:, j * size : (j + 1) * size] = lu_solve(factors, explicit)
    return M


def _multistep(
    method: Multistep, A: Matrix, B: Matrix, u: Input, x0: Vector, h: float, n: int
) -> Matrix:
    size, k = A.shape[0], len(method.alpha) - 1
    first = x0[None]
    if k > 1:
        starter = method_named(method.start)
        first = _runge_kutta(starter, A, B, u, x0, h, k - 1)  # type: ignore[arg-type]
    steps = n - k + 1
    if steps < 1:
        return first[: n + 1]
    v = _input(u, h * np.arange(n + 1, dtype=np.float64), B.shape[1])
    blend = sum(beta * v[j : j + steps] for j, beta in enumerate(method.beta) if beta)
    factors = lu_factor(np.eye(size) - h * method.beta[-1] * A)
    w = np.zeros((steps, k * size))
    w[:, -size:] = lu_solve(factors, h * B @ np.transpose(blend)).T
    states = recursion(_companion(method, A, h), w, first.ravel())
    return np.concatenate([first[:-1], states[:, -size:]])
