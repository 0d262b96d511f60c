"""Start values beside a minimum: one mode of C, D or F at another place.

In strong noise the prediction error has minima of little difference, in which a weak mode has
settled on the noise of some frequency. Slow noise and slow inputs have others, in which a real root
has. So each mode is tried elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, product

import numpy as np

from armrig.estimation.prediction_error import PredictionError
from armrig.estimation.steiglitz_mcbride import high_order_output, steiglitz_mcbride
from armrig.numerics.polynomial import Array, filtered, roots

_ANGLES = np.linspace(0.1, 3.0, 15)  # of the moved mode, in rad a sample
_REAL = (0.99, 0.95, 0.8, 0.3, -0.3, -0.8)
_MOST_REAL = 0.998
_IS_REAL = 1e-9
_RADII = (0.98, 0.85, 0.6)
_EACH = 6  # starts of a kind
_OF_F = 2  # its place among the polynomials


def moved_modes(
    problem: PredictionError, theta: Array, *, all_kinds: bool = True
) -> Iterator[Array]:
    """Yield start values in which one mode of C, D or F is moved; those of least cost of each kind.

    A complex pair, or the two smallest real roots, becomes a pair at another frequency, or two
    other real roots; a real root becomes another one.

    Parameters
    ----------
    all_kinds : bool
        Or only pairs of F at other frequencies.
    """
    polynomials = problem.polynomials(theta)
    kinds = (_other_pairs, _other_reals, _other_real) if all_kinds else (_other_pairs,)
    for which, polynomial in enumerate(polynomials):
        for kind in kinds if all_kinds or which == _OF_F else ():
            starts = []
            for moved in kind(roots(polynomial)):
                others = [*polynomials]
                others[which] = np.real(np.poly(moved))
                start = np.concatenate([other[1:] for other in others])
                starts.append((problem.cost(start), start))
            starts.sort(key=lambda start: start[0])
            yield from (start for _, start in starts[:_EACH])
    if all_kinds:
        yield from _moved_together(problem, theta)
        yield from _with_white_noise(problem, theta)


def _moved_together(problem: PredictionError, theta: Array) -> Iterator[Array]:
    """Yield starts in which a real root of C and one of D nearly cancel at another place."""
    C, D, F = problem.polynomials(theta)
    starts = []
    for z, w in product(_without_one_real(roots(C)), _without_one_real(roots(D))):
        for root, share in product(_REAL, (0.9, 1 / 0.9)):
            near = np.clip(root * share, -_MOST_REAL, _MOST_REAL)
            c, d = np.real(np.poly(np.append(z, near))), np.real(np.poly(np.append(w, root)))
            start = np.concatenate([c[1:], d[1:], F[1:]])
            starts.append((problem.cost(start), start))
    starts.sort(key=lambda start: start[0])
    yield from (start for _, start in starts[:_EACH])


def _with_white_noise(problem: PredictionError, theta: Array) -> Iterator[Array]:
    """Yield starts in which F is estimated again, from signals filtered by D/C."""
    n = problem.structure
    C, D, _ = problem.polynomials(theta)
    if n.nf == 0 or n.nc + n.nd == 0:
        return
    signals = [(filtered(D, C, x.u), filtered(D, C, x.y)) for x in problem.experiments]
    smooth = high_order_output(signals, n)
    for F, on in ((np.ones(1), smooth), (np.ones(1), signals)):
        for better in steiglitz_mcbride(on, F, n, iterations=5):
            yield np.concatenate([theta[: n.nc + n.nd], better[1:]])


def _other_pairs(z: Array) -> Iterator[Array]:
    for kept in _without_one_pair(z):
        for radius, angle in product(_RADII, _ANGLES):
            yield np.concatenate([kept, radius * np.exp(1j * np.array([angle, -angle]))])


def _other_reals(z: Array) -> Iterator[Array]:
    for kept in _without_one_pair(z):
        for pair in combinations(_REAL, 2):
            yield np.concatenate([kept, pair])


def _other_real(z: Array) -> Iterator[Array]:
    for kept in _without_one_real(z):
        for root in _REAL:
            yield np.append(kept, root)


def _without_one_real(z: Array) -> Iterator[Array]:
    for i in np.flatnonzero(np.abs(z.imag) <= _IS_REAL):
        yield np.delete(z, i)


def _without_one_pair(z: Array) -> Iterator[Array]:
    """Yield what is left without each complex pair, and without the two smallest real roots."""
    rest = np.arange(z.size)
    for i in np.flatnonzero(z.imag > _IS_REAL):
        partner = int(np.argmin(np.abs(z - np.conj(z[i]))))
        yield z[(rest != i) & (rest != partner)]
    real = np.flatnonzero(np.abs(z.imag) <= _IS_REAL)
    if real.size >= 2:
        smallest = real[np.argsort(np.abs(z[real]))[:2]]
        yield z[~np.isin(rest, smallest)]
