"""The output-error problem: residuals and their derivatives for a given denominator."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from armrig.estimation.levenberg_marquardt import Optimum, levenberg_marquardt
from armrig.estimation.orders import Sizes
from armrig.estimation.steiglitz_mcbride import equation_error, high_order_output, steiglitz_mcbride
from armrig.free_response import free_columns
from armrig.least_squares import Basis, orthonormal
from armrig.polynomial import Array, reflected, stable
from armrig.sensitivity import by_denominator, by_numerator


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """The least-squares answer for a given denominator."""

    b: Array
    """Numerator coefficients (nb,)."""
    free: tuple[Array, ...]
    """Coefficients of each experiment's free response."""
    e: Array
    """Residuals in the valid rows of all experiments, (M,)."""
    Psi: Array
    """Derivatives of the model output by (b, f), less the free response, (M, nb + nf)."""
    J: Array
    """The derivatives by f, less what b and the free response explain, (M, nf)."""
    spans: tuple[Array, ...]
    """Orthonormal basis of each experiment's free response in its valid rows."""
    rank: int
    """Number of b's that the data determine."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Given:
    """One experiment for a given denominator."""

    by_b: Array
    """Derivatives of the output by b, (N, nb)."""
    columns: Array
    """Free response, (N, count + 2 drift)."""
    basis: Basis
    """Of the free response in the valid rows."""
    projected: Array
    """[by_b, y] in the valid rows less the free response."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputError:
    """min |y - B/F u - free response| over B, F and the free responses of all experiments.

    B and the free responses enter linearly and are projected out, so the search is over the
    coefficients of F alone (variable projection; Kaufman's Jacobian, whose gradient is exact).

    References
    ----------
    .. [1] G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432.
    .. [2] L. Kaufman, BIT 15 (1975) 49-57.
    """

    experiments: tuple[tuple[Array, Array, Array], ...]
    """(u, y, valid) of each; u is summed where the model integrates."""
    sizes: Sizes
    """Orders and nuisance parameters."""

    def _given(self, F: Array) -> list[_Given]:
        """Return what each experiment is linear in, for a denominator."""
        n = self.sizes
        given = []
        for u, y, valid in self.experiments:
            by_b = by_numerator(u, F, range(n.nk, n.nk + n.nb))
            columns = free_columns(F, y.size, count=n.count, drift=n.drift)
            basis = orthonormal(_rows(columns, valid))
            projected = basis.without(np.column_stack([_rows(by_b, valid), _rows(y, valid)]))
            given.append(_Given(by_b=by_b, columns=columns, basis=basis, projected=projected))
        return given

    def solve(self, f: Array) -> Solution:
        """Return the best b and free responses for F = [1, f]."""
        F, n = np.append(1.0, f), self.sizes
        given = self._given(F)
        whole = np.vstack([g.projected for g in given])
        numerator = orthonormal(whole[:, :-1])
        b = numerator.coefficients(whole[:, -1])
        by_f, states = [], []
        for g, (_, y, valid) in zip(given, self.experiments, strict=True):
            forced = g.by_b @ b
            x = g.basis.coefficients(_rows(y - forced, valid))
            forced = forced + g.columns[:, : n.count] @ x[: n.count]
            by_f.append(g.basis.without(_rows(by_denominator(forced, F, n.nf), valid)))
            states.append(x)
        Psi_f = np.vstack(by_f)
        return Solution(
            b=b,
            free=tuple(states),
            e=numerator.without(whole[:, -1]),
            Psi=np.hstack([whole[:, :-1], Psi_f]),
            J=numerator.without(Psi_f),
            spans=tuple(g.basis.Q for g in given),
            rank=numerator.rank,
        )

    def linearise(self, f: Array) -> tuple[Array, Array]:
        """Return e and J at f."""
        solution = self.solve(f)
        return solution.e, solution.J

    def cost(self, F: Array) -> float:
        """Return |e|² for a denominator."""
        whole = np.vstack([g.projected for g in self._given(F)])
        e = orthonormal(whole[:, :-1]).without(whole[:, -1])
        return float(e @ e)

    def minimise(self, F: Array) -> Optimum:
        """Search from a denominator; F stays stable on the way."""
        return levenberg_marquardt(
            self.linearise, F[1:], admissible=lambda f: stable(np.append(1.0, f))
        )

    def start_values(self) -> Iterator[tuple[str, Array]]:
        """Yield named stable denominators to search from.

        The starts, and only they, need a y without holes: there it is interpolated. The search
        itself leaves the missing rows out.
        """
        signals = [(u, _interpolated(y, valid)) for u, y, valid in self.experiments]
        F, _ = equation_error(signals, np.ones(1), self.sizes)
        yield "ARX", reflected(F)
        smooth = high_order_output(signals, self.sizes)
        at_rest = replace(self.sizes, count=0, drift=False)
        *_, F = steiglitz_mcbride(smooth, np.ones(1), at_rest, iterations=5)
        candidates = [F, *steiglitz_mcbride(signals, F, self.sizes, iterations=5)]
        yield "high-order ARX, Steiglitz-McBride", min(candidates, key=self.cost)


def _rows(x: Array, valid: Array) -> Array:
    return x if valid.all() else np.asarray(x[valid])


def _interpolated(y: Array, valid: Array) -> Array:
    if valid.all():
        return y
    if not valid.any():
        return np.zeros(y.size)
    t = np.arange(y.size)
    return np.interp(t, t[valid], y[valid])
