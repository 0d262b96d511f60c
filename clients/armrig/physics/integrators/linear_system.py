"""Checks of a linear system, and its exact solution."""

from __future__ import annotations

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from armrig.numerics.checks import require_numbers

Matrix = NDArray[np.float64]


def system(
    A: ArrayLike, B: ArrayLike, x0: ArrayLike | None = None
) -> tuple[Matrix, Matrix, Matrix]:
    """Return A (n, n), B (n, m) and x0 (n,) as arrays; a B of shape (n,) has one input.

    Raises
    ------
    ValueError
        The shapes do not match, or a number is not finite.
    """
    for name, given in (("A", A), ("B", B), ("x0", x0)):
        if given is not None and np.iscomplexobj(np.asarray(given)):
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
    A: ArrayLike,
    B: ArrayLike,
    amplitude: float,
    omega: float,
    x0: ArrayLike,
    t: ArrayLike,
) -> Matrix:
    """Return the solution (len(t), nx) of x' = A x + B amplitude sin(omega t), x(0) = x0.

    Sine and cosine are additional states, s' = omega c, c' = -omega s. The solution is then one
    matrix exponential for any A and omega, including integrators and resonance ::

        [x]         [A  B amplitude  0    ]    [x0]
        [s](t) = exp[0  0            omega] t  [0 ]
        [c]         [0  -omega       0    ]    [1 ]

    Parameters
    ----------
    A : array_like, shape (nx, nx)
    B : array_like, shape (nx,) or (nx, 1)
    amplitude : float
        Amplitude of the input, in its unit.
    omega : float
        Angular frequency in rad/s.
    x0 : array_like, shape (nx,)
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
    >>> x = armrig.exact([[0.0]], [1.0], amplitude=1.0, omega=np.pi, x0=[0.0], t=[0.0, 0.5, 1.0])
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
