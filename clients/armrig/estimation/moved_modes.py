"""Start values beside a minimum: one mode of F at another frequency.

In strong noise the prediction error has minima of little difference, in which a weak mode has
settled on the noise of some frequency. Where searches disagree, that mode is tried elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from armrig.estimation.prediction_error import PredictionError
from armrig.numerics.polynomial import Array, roots

_ANGLES = np.linspace(0.1, 3.0, 15)  # of the moved mode, in rad a sample
_RADIUS = 0.93


def moved_modes(problem: PredictionError, theta: Array, *, most: int) -> Iterator[Array]:
    """Yield the `most` start values of least cost in which one pair of F's roots is moved."""
    C, D, F = problem.polynomials(theta)
    candidates = []
    for kept in _without_one_pair(roots(F)):
        for angle in _ANGLES:
            moved = _RADIUS * np.exp(1j * np.array([angle, -angle]))
            f = np.real(np.poly(np.concatenate([kept, moved])))[1:]
            start = np.concatenate([C[1:], D[1:], f])
            candidates.append((problem.cost(start), start))
    candidates.sort(key=lambda candidate: candidate[0])
    yield from (start for _, start in candidates[:most])


def _without_one_pair(z: Array) -> Iterator[Array]:
    """Yield what is left without each complex pair, and without the two smallest real roots."""
    rest = np.arange(z.size)
    for i in np.flatnonzero(z.imag > 1e-9):
        partner = int(np.argmin(np.abs(z - np.conj(z[i]))))
        yield z[(rest != i) & (rest != partner)]
    real = np.flatnonzero(np.abs(z.imag) <= 1e-9)
    if real.size >= 2:
        smallest = real[np.argsort(np.abs(z[real]))[:2]]
        yield z[~np.isin(rest, smallest)]
