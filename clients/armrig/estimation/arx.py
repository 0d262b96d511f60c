"""ARX: equation-error models by linear least squares."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_data
from armrig.data.dataset import Dataset, Signals
from armrig.data.finding import Finding
from armrig.estimation.data_faults import (
    NO_OPTION,
    cause_of_indeterminacy,
    data_faults,
    require_informative,
)
from armrig.estimation.estimated_outputs import EstimatedOutput, fit_of_outputs
from armrig.estimation.fit_warnings import with_doubts
from armrig.estimation.orders import Integers, Orders, as_text, by_channel, by_pair, require_samples
from armrig.estimation.stability import (
    instability,
    reflection_warnings,
    stabilise,
    with_stability_warning,
)
from armrig.models.fit import Fit
from armrig.numerics.covariance import (
    pairwise_covariance,
    spread,
    spread_apart,
    unspread,
    whitening,
)
from armrig.numerics.inference import OutputResiduals
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.polynomial import Array, monic
from armrig.numerics.regressors import complete, past
from armrig.numerics.stretches import Mask

_MAX_ROUNDS = 20
_SAME_TOLERANCE = 1e-8  # relative change of Lambda at which the iteration ends


@takes_data
def arx(
    data: Dataset | Signals, *, na: Orders, nb: Orders, nk: Orders = 1, stable: bool = False
) -> Fit:
    """Estimate A and B in A(q) y(t) = B(q) u(t) + e(t) by least squares.

    The method is a QR decomposition of the scaled regressors, not the normal equations. Rows that
    contain a missing y are not used. The first max(na, nb + nk - 1) rows of each experiment are not
    used either.

    With several outputs A and B are matrices of polynomials. The equations of the outputs are
    seemingly unrelated regressions, weighted by the inverse of Lambda, the covariance of e [2]_.
    The parameters are estimated for a given Lambda, and Lambda is estimated from the residuals.
    These two steps are repeated until Lambda hardly changes. If all outputs have the same
    regressors, the weights have no effect.

    Parameters
    ----------
    data : Dataset or Signals
        N samples, N > na + nb + max(na, nb + nk - 1) for one input and one output.
    na : int, array_like (ny, ny) or mapping
        Number of a's for each pair of outputs, >= 0: na[i][k] past values of output k affect
        output i. A mapping has keys such as ("T2", "T1"). With na = 0 the model is a finite
        impulse response.
    nb : int, array_like (ny, nu) or mapping
        Number of b's for each output and input; 0 if the input does not affect the output.
    nk : int, array_like (ny, nu) or mapping, default 1
        Number of samples before u reaches y; 0 means a direct term.
    stable : bool, default False
        Reflect poles outside the unit circle into the circle, and estimate B again. A finding of
        the fit reports the reflection. No output may then affect another output.

    Returns
    -------
    Fit
        `covariance` is lambda (Phi^T Phi)^-1, or the inverse of the sum of Phi^T inv(Lambda) Phi.
        `covariance_robust` is the estimate of Newey and West.

    Raises
    ------
    ValueError
        An order has a wrong shape, N is too small for the orders, or u does not excite the model.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 4.2 and 7.3.
    .. [2] A. Zellner, J. American Statistical Association 57 (1962) 348-368.

    Examples
    --------
    The noise of the example is added to the output, so that the residuals of this model are
    coloured. `oe` and `bj` describe such noise.

    >>> data = armrig.example_recording().dataset("alpha")
    >>> fit = armrig.arx(data, na=3, nb=3)
    >>> fit.heading
    'ARX(na=3, nb=3, nk=1)'
    >>> print(f"{fit.fit_percent:.0f} % one step ahead, residuals {fit.white}")
    94 % one step ahead, residuals coloured (p < 0.001, Ljung-Box test)
    """
    if isinstance(data, Signals) and (data.nu, data.ny) == (1, 1):
        data = data.dataset()
    na_ = by_pair("na", na, data, least=0)
    nb_ = by_channel("nb", nb, data, least=int(data.signals().nu == 1))
    nk_ = by_channel("nk", nk, data, least=0)
    orders = as_text(na=na_, nb=nb_, nk=nk_)
    if stable and (na_ - np.diag(na_.diagonal())).any():
        raise InputError(
            f"na={na_.tolist()}: with stable=True no output may affect another output; give na 0 "
            "for each pair of different outputs"
        )
    if isinstance(data, Signals):
        require_informative(data)
    outputs = data.signals().outputs
    equations = [_equation(data, i, na_[i], nb_[i], nk_[i]) for i in range(len(outputs))]
    for i, equation in enumerate(equations):
        equation_orders = orders if len(outputs) == 1 else f"{orders} for {outputs[i]}"
        skipped = max(na_[i].max(), (nb_[i] + nk_[i])[nb_[i] > 0].max(initial=1) - 1)
        require_samples(equation_orders, needed=equation.size + int(skipped) + 1, got=data.N)
        equation_orders += " with the gaps left out"
        require_samples(equation_orders, needed=equation.size + 1, got=equation.rows)
    solution = _solve(equations)
    d = sum(equation.size for equation in equations)
    if solution.basis.rank < d:
        raise InputError(
            f"{orders}: the data determine only {solution.basis.rank} of {d} parameters; "
            f"{cause_of_indeterminacy(data)}"
        )
    notes: list[Finding] = []
    if stable:
        solution, notes = _with_stable_poles(equations, solution, na_.diagonal().tolist())
    estimates = [*_outputs(data, equations, solution, na_, nb_, nk_)]
    name = "" if isinstance(data, Dataset) else orders
    fit = fit_of_outputs(
        data, estimates, solution.basis.W, structure="arx", score="correlated", specification=name
    )
    fit = with_doubts(fit)
    if isinstance(data, Signals):
        return replace(fit, findings=(*notes, *instability(fit.form), *fit.findings))
    residuals = [r.e for r in estimates[0].residuals]
    faults = data_faults(data, residuals, way_out=NO_OPTION)
    return with_stability_warning(replace(fit, findings=(*notes, *fit.findings, *faults)))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Equation:
    """Regression y = Phi theta + e of one output."""

    Phi: tuple[Array, ...]
    """Regressors of each experiment, (N, d); 0 in rows that are not usable."""
    y: tuple[Array, ...]
    """Output of each experiment, (N,); 0 in rows that are not usable."""
    usable: tuple[Mask, ...]
    """Rows of each experiment in which y and all regressors are known, (N,)."""

    @property
    def size(self) -> int:
        """Number of parameters."""
        return int(self.Phi[0].shape[1])

    @property
    def rows(self) -> int:
        """Number of usable rows."""
        return sum(int(np.count_nonzero(u)) for u in self.usable)

    def residuals(self, theta: Array) -> list[Array]:
        """Return the residuals of each experiment, NaN in rows that are not usable."""
        parts = zip(self.Phi, self.y, self.usable, strict=True)
        return [np.where(u, y - Phi @ theta, np.nan) for Phi, y, u in parts]


@dataclass(frozen=True, slots=True, kw_only=True)
class _RegressionSolution:
    """Least-squares solution for all outputs."""

    theta: tuple[Array, ...]
    """Parameters of each output."""
    basis: Basis
    """Basis of the whitened regressors of all experiments."""
    weights: tuple[Array, ...]
    """Whitening matrices of each experiment; empty for one output."""


def _equation(
    data: Dataset | Signals, i: int, na: Integers, nb: Integers, nk: Integers
) -> _Equation:
    """Return the regression of output i."""
    Phi, outputs, usable = [], [], []
    for part in data.experiments():
        u, y = part.u.reshape(part.N, -1), part.y.reshape(part.N, -1)
        columns = [-past(y[:, k], range(1, n + 1)) for k, n in enumerate(na.tolist())]
        lags = zip(nb.tolist(), nk.tolist(), strict=True)
        columns += [past(u[:, j], range(k, k + n)) for j, (n, k) in enumerate(lags)]
        X = np.hstack(columns)
        complete_rows = complete(X, y[:, i])
        X[~complete_rows] = 0.0
        Phi.append(X)
        outputs.append(np.where(complete_rows, y[:, i], 0.0))
        usable.append(complete_rows)
    return _Equation(Phi=tuple(Phi), y=tuple(outputs), usable=tuple(usable))


def _solve(equations: Sequence[_Equation]) -> _RegressionSolution:
    """Return the parameters; the covariance of several outputs is estimated with them."""
    if len(equations) == 1:
        (equation,) = equations
        usable = np.concatenate(equation.usable)
        basis = orthonormal(np.vstack(equation.Phi)[usable])
        alone = basis.coefficients(np.concatenate(equation.y)[usable])
        return _RegressionSolution(theta=(alone,), basis=basis.spread(usable), weights=())
    ends = np.cumsum([equation.size for equation in equations])[:-1]
    blocks = [*zip(*(equation.Phi for equation in equations), strict=True)]
    y = [[v[:, None] for v in outputs] for outputs in zip(*(e.y for e in equations), strict=True)]
    masks = [
        np.column_stack(columns) for columns in zip(*(e.usable for e in equations), strict=True)
    ]
    known_y = [np.concatenate(e.y)[np.concatenate(e.usable)] for e in equations]
    Lambda = np.diag([float(np.var(v)) or 1.0 for v in known_y])
    for _ in range(_MAX_ROUNDS):
        G = [whitening(Lambda, mask) for mask in masks]
        basis = orthonormal(
            np.vstack(
                [spread_apart(g, regressors) for g, regressors in zip(G, blocks, strict=True)]
            )
        )
        right = np.concatenate([spread(g, outputs)[:, 0] for g, outputs in zip(G, y, strict=True)])
        theta = tuple(np.split(basis.coefficients(right), ends))
        pairs = zip(equations, theta, strict=True)
        e = np.column_stack(
            [np.concatenate(regression.residuals(parameters)) for regression, parameters in pairs]
        )
        before, Lambda = Lambda, pairwise_covariance(e)
        if np.abs(Lambda - before).max() <= _SAME_TOLERANCE * np.abs(Lambda).max():
            break
    return _RegressionSolution(theta=theta, basis=basis, weights=tuple(G))


def _with_stable_poles(
    equations: Sequence[_Equation], solution: _RegressionSolution, na: list[int]
) -> tuple[_RegressionSolution, list[Finding]]:
    """Return the solution with reflected poles and a new B, and the warnings."""
    free = [monic(theta[:n]) for theta, n in zip(solution.theta, na, strict=True)]
    inside = [stabilise(A) for A in free]
    notes = [w for A, p in zip(free, inside, strict=True) for w in reflection_warnings(A, p)]
    if all(A is p for A, p in zip(free, inside, strict=True)):
        return solution, notes
    B_equations = [
        replace(
            equation,
            Phi=tuple(Phi[:, n:] for Phi in equation.Phi),
            y=tuple(
                y - Phi[:, :n] @ A[1:] for y, Phi in zip(equation.y, equation.Phi, strict=True)
            ),
        )
        for equation, A, n in zip(equations, inside, na, strict=True)
    ]
    pairs = zip(inside, _solve(B_equations).theta, strict=True)
    return replace(solution, theta=tuple(np.concatenate([A[1:], b]) for A, b in pairs)), notes


def _outputs(
    data: Dataset | Signals,
    equations: Sequence[_Equation],
    solution: _RegressionSolution,
    na: Integers,
    nb: Integers,
    nk: Integers,
) -> Iterator[EstimatedOutput]:
    """Yield the polynomials and residuals of each output."""
    parts, (ny, nu), unity = list(data.experiments()), nb.shape, np.ones(1)
    Q = np.split(solution.basis.Q, np.cumsum([ny * part.N for part in parts])[:-1])
    shares = [[M] for M in Q]
    if ny > 1:
        shares = [unspread(G, M) for G, M in zip(solution.weights, Q, strict=True)]
    jacobians = np.split(np.eye(len(solution.basis.W)), np.cumsum([e.size for e in equations])[:-1])
    for i, (equation, theta) in enumerate(zip(equations, solution.theta, strict=True)):
        coefficients = np.split(theta, np.cumsum([*na[i], *nb[i]])[:-1])
        delays = nk[i].tolist()
        yield EstimatedOutput(
            polynomials={
                "A": tuple(np.append(float(i == k), coefficients[k]) for k in range(ny)),
                "B": tuple(
                    np.append(np.zeros(k), b)
                    for k, b in zip(delays, coefficients[ny:], strict=True)
                ),
                "C": unity,
                "D": unity,
                "F": (unity,) * nu,
                "nk": tuple(delays),
                "integrators": False,
            },
            residuals=tuple(
                OutputResiduals(e=e, y=y, H=share[i], Psi=Phi if ny > 1 else None)
                for e, y, share, Phi in zip(
                    equation.residuals(theta), equation.y, shares, equation.Phi, strict=True
                )
            ),
            parameters=equation.size,
            J=jacobians[i],
        )
