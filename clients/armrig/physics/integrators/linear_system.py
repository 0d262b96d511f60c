"""The linear system that is integrated, checked once for all."""

from __future__ import annotations

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray

Matrix = NDArray[np.float64]


def system(
    A: ArrayLike, B: ArrayLike, x0: ArrayLike | None = None
) -> tuple[Matrix, Matrix, Matrix]:
    """Return A (n, n), B (n, m) and x0 (n,) as arrays; a B of shape (n,) has one input.

    Raises
    ------
    ValueError
        The shapes do not belong together, or a number is not finite.
    """
    for name, given in (("A", A), ("B", B), ("x0", x0)):
        if given is not None and np.iscomplexobj(np.asarray(given)):
            raise InputError(
                f"{name} is complex: give the real system of twice the size, [[Re, -Im], [Im, Re]]"
            )
    A_ = np.array(A, dtype=np.float64)
    if A_.ndim != 2 or A_.shape[0] != A_.shape[1] or A_.size == 0:
        raise InputError(f"A has shape {A_.shape}, it must be (n, n)")
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
            raise InputError(f"{name} holds a number that is not finite")
    return A_, B_, x0_


def require_positive(**values: float) -> None:
    """Refuse what is no finite number > 0."""
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name}={value!r} must be finite and > 0")
