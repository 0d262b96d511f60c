"""The inertia from the torque balance: an estimate that is independent of `greybox`.

    theta_1'' = (1/J_1) (a (u - u0) - d theta_1') - (b_1/J_1) theta_1' - (T_c/J_1) sign theta_1'

Here a = N K_m / R_m and d = (N K_m)² / R_m. The method is least squares on smoothed and decimated
signals.

References
----------
.. [1] M. Gautier, P. Poignet, Control Engineering Practice 9 (2001) 1361-1372 (inverse dynamics
   with zero-phase filtering and decimation).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from armrig_core.errors import InputError
from armrig_core.rig.arm import ArmParameters
from armrig_core.telemetry.telemetry import THETA_1

from armrig.data.argument import takes_recordings
from armrig.data.columns import Matrix, Vector
from armrig.data.dataset import Dataset
from armrig.data.treatment.wrong_samples import quantum
from armrig.numerics.inference import Inference, infer, least_squares_residuals
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.quantities import p_relation
from armrig.numerics.whiteness import WHITE_LEVEL
from armrig.physics.grey_box.fit import GreyFit, below_zero, carried, named_std
from armrig.physics.grey_box.least_squares_problem import bipolar
from armrig.physics.grey_box.sampled_model import (
    COULOMB,
    Friction,
    Physics,
    checked_fixed_std,
    free_names,
    require_output,
)
from armrig.physics.grey_box.smoothing import (
    MIN_WIDTH,
    SMOOTHED_NOISE,
    kernels,
    near_standstill,
    reach,
    smoothed,
    smoothed_noise_p_value,
)
from armrig.physics.systems import chassis

_WIDTHS_PER_ROW = 1.5  # distance of the rows, in standard deviations of the kernel
_HELD_NAMES = ("N", "R_m", "K_m")
_MIN_ROWS_PER_UNKNOWN = 10  # with fewer rows the standard deviations are too small
_WIDTH_RATIO = 2**0.5  # between successive widths
_MIN_KERNELS = 6  # least length of the longest experiment, in lengths of the kernel


@takes_recordings
def inverse_dynamics(
    data: Dataset,
    fixed: ArmParameters | None = None,
    *,
    friction: Friction | None = None,
    width: float | None = None,
    fixed_std: Mapping[str, float] | None = None,
) -> GreyFit:
    """Estimate J_1 of the chassis without the arm from its torque balance, by least squares.

    The acceleration, the noisiest signal, is on the left side of the equation. The noise of the
    velocity on the right side causes the `bias` of J_1.

    Parameters
    ----------
    data : Dataset
        u in V and theta_1 in rad.
    fixed : ArmParameters, optional
        Values of N, R_m, K_m and, if b_1 is not estimated, b_1; by default the values of the
        handout.
    friction : {"viscous", "coulomb", "both"}, optional
        As for `greybox`. The offset of the input is estimated in the same cases as in `greybox`. If
        T_c is estimated, samples near standstill are not used.
    width : float, optional
        Standard deviation of the smoothing kernel in s. By default, several widths are tried, each
        sqrt(2) times as wide as the previous width. The width with the least std² + bias² is used.
        A narrow kernel passes more noise of the velocity, which biases J_1. A wide kernel loses
        excitation and data.
    fixed_std : mapping of str to float, optional
        As for `greybox`.

    Returns
    -------
    GreyFit
        `std` and `std_robust` are equal, because smoothed noise is never white. They are the larger
        of two values: the sandwich form, and the form for white noise on the angle. `whiteness` is
        the p value of the hypothesis that the residuals are smoothed white noise of the angle.
        `width` is the width that was used. `bias` is the first-order bias due to the noise of the
        velocity; the bias is not subtracted.

    Raises
    ------
    ValueError
        An option is unknown, the kernel is longer than the data, or too few values are left after
        smoothing.

    Notes
    -----
    X (M rows) contains the regressors, and β contains their coefficients. g_i is the derivative of
    column i with respect to the velocity. λ is the variance of the white noise on the angle, and h'
    is the kernel of the velocity. The bias (attenuation by errors in variables) is ::

        bias = -(X^T X / M)^-1 λ |h'|² g g^T β

    λ is computed from the residuals of the narrowest width.

    Examples
    --------
    The data are simulated with J_1 = 0.0017 kg m².

    >>> import armrig, control, numpy as np
    >>> u = armrig.telegraph(1000, 0.05)
    >>> chassis = armrig.chassis(armrig.ArmParameters()).sample(0.01)
    >>> theta_1 = control.forced_response(chassis, inputs=u).outputs
    >>> theta_1 += 0.003 * np.random.default_rng(1).standard_normal(1000)
    >>> data = armrig.Dataset(u=u, y=theta_1, Ts=0.01, output="theta_1", unit="rad")
    >>> fit = armrig.inverse_dynamics(data)
    >>> print(f"J_1 = {fit.values['J_1']:.4f} kg m², {100 * fit.relative_std['J_1']:.1f} %")
    J_1 = 0.0017 kg m², 0.2 %
    """
    p = ArmParameters() if fixed is None else fixed
    require_output(data.output, THETA_1)
    names = free_names(("J_1",), friction)
    given = checked_fixed_std(fixed_std or {}, names)
    tried = _tried(data, p, names, width)
    least = np.min([one.std for one in tried], axis=0)
    # The least sum of (std² + bias²) / (least std over all widths)² over the parameters.
    chosen = min(tried, key=lambda one: float(np.sum((one.std**2 + one.bias**2) / least**2)))
    solution, values, slope = chosen.solution, chosen.values, chosen.slope
    drift = solution.beta[-1] / solution.beta[0] if _offset_is_free(data, names) else 0.0
    found = solution.inference.transformed(slope)
    physics, held = Physics(model=chassis, fixed=p, output=THETA_1), _held(names)
    by_held = slope @ solution.by_held
    # Wide kernels leave few values, for which the sandwich form may be too small.
    raised = chosen.std / np.sqrt(np.diag(found.covariance_robust))
    noise = found.covariance_robust * np.outer(raised, raised)
    covariance = noise + carried(by_held, [given.get(k, 0.0) for k in held])
    std = named_std(names, covariance)
    white = smoothed_noise_p_value(solution.residuals, chosen.h, _every(chosen.s, data.Ts))
    shares = by_held[0] * [getattr(p, k) for k in held] / values["J_1"]
    return GreyFit(
        method="inverse dynamics",
        names=names,
        values=values,
        std=std,
        std_noise=named_std(names, noise),
        std_robust=std,
        covariance=covariance,
        covariance_robust=covariance,
        condition=solution.condition,
        influence={"J_1": dict(zip(held, shares.tolist(), strict=True))},
        fixed=physics.parameters(values),
        fixed_std=given,
        initial=(),
        offset=(float(-drift / p.torque_per_volt),) * len(data.starts),
        noise_variance=found.noise_variance,
        loss=found.quality[0].loss,
        fit_percent=found.quality[0].fit_percent,
        whiteness=white,
        whiteness_test=SMOOTHED_NOISE,
        quantum=quantum(data),
        N=found.quality[0].N,
        Ts=data.Ts,
        physics=physics,
        width=chosen.s,
        bias=dict(zip(names, chosen.bias.tolist(), strict=True)),
        warnings=(*below_zero(values, std), *_warnings(white, chosen)),
        **data.origin(),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Tried:
    """Estimate for one width of the kernel."""

    s: float
    """Standard deviation of the kernel, in s."""
    solution: _Solution
    """Least-squares solution."""
    values: dict[str, float]
    """Estimates by name."""
    slope: Matrix
    """Derivatives of the values with respect to the coefficients."""
    h: Vector
    """Kernel through which the white noise of the angle enters the residuals."""
    noise: float
    """Variance of the white noise on the angle, from the residuals of the narrowest width."""
    bias: Vector
    """Bias of each value due to the noise of the velocity."""
    std: Vector
    """Standard deviations due to the noise: the larger of the sandwich and the white-noise form."""


def _tried(
    data: Dataset, p: ArmParameters, names: tuple[str, ...], width: float | None
) -> list[_Tried]:
    """Return the estimates for all widths that leave enough data, or for the given width."""
    longest = max(part.N for part in data.experiments())
    least = MIN_WIDTH * data.Ts
    if width is not None:
        s = max(width, least)
        if 2 * reach(s, data.Ts) + 1 > longest:
            raise InputError(
                f"width={width:g} s: the kernel needs {2 * reach(s, data.Ts) + 1} samples, the "
                f"longest experiment has {longest}; give {longest * data.Ts / 10:.2g} s or less"
            )
        return [_at(data, p, names, s)]
    found: list[_Tried] = []
    s = least
    while 2 * reach(s, data.Ts) + 1 <= longest / (_MIN_KERNELS if found else 1):
        try:
            found.append(_at(data, p, names, s, noise=found[0].noise if found else None))
        except ValueError:
            if found:
                break
        s *= _WIDTH_RATIO
    if not found:
        msg = f"no kernel from {least:.2g} to {max(s / _WIDTH_RATIO, least):.2g} s leaves "
        msg += f"{_MIN_ROWS_PER_UNKNOWN} values for each unknown: record longer"
        if COULOMB in names:
            msg += ', or with fewer stops; friction="viscous" also uses the data near a stop'
        raise InputError(msg)
    return found


def _at(
    data: Dataset, p: ArmParameters, names: tuple[str, ...], s: float, noise: float | None = None
) -> _Tried:
    """Return the estimate for the kernel width s; `noise` is the variance of the angle's noise."""
    balance = _torque_balance(data, p, names, s)
    solution = _solved(balance, s)
    values, slope = _parameters(solution.beta, names)
    k = kernels(s, data.Ts)
    braking = p.damping - p.b_1 + values.get("b_1", p.b_1)
    # The noise of the angle enters the residual through theta_1'' + (d + b_1)/J_1 theta_1'.
    h = k.second + braking / values["J_1"] * k.first
    own = solution.inference.noise_variance / float(h @ h)
    known = own if noise is None else noise
    g = balance.by_velocity
    spread = known * float(k.first @ k.first) * np.outer(g, g)
    robust = solution.inference.transformed(slope).covariance_robust
    bread = slope @ np.linalg.inv(solution.moment) / solution.inference.quality[0].N
    white = known * np.diag(bread @ _meat(solution.blocks, h, _every(s, data.Ts)) @ bread.T)
    beta_bias = -np.linalg.solve(solution.moment, spread @ solution.beta)
    return _Tried(
        s=s,
        solution=solution,
        values=values,
        slope=slope,
        h=h,
        noise=known,
        bias=slope @ beta_bias,
        std=np.sqrt(np.maximum(np.diag(robust), white)),
    )


def _meat(blocks: Sequence[Matrix], h: Vector, m: int) -> Matrix:
    """Return the sum of x(i) x(j)^T r(j - i) over all pairs of rows i, j of each block.

    r is the autocovariance of h at lags of m samples.
    """
    r = np.correlate(h, h, "full")[h.size - 1 :: m]
    total = np.zeros((blocks[0].shape[1],) * 2)
    for X in blocks:
        for lag, weight in enumerate(r[: X.shape[0]].tolist()):
            part = weight * X[: X.shape[0] - lag].T @ X[lag:]
            total += part + part.T if lag else part
    return total


def _warnings(p_value: float, chosen: _Tried) -> Iterator[str]:
    """Yield warnings of coloured residuals, and of a bias of J_1 above its standard deviation."""
    if p_value < WHITE_LEVEL:
        yield (
            f"the residuals are more than smoothed noise (p {p_relation(p_value)}): the model "
            "lacks a property of the rig (friction?), or the noise is not white"
        )
    if abs(chosen.bias[0]) > chosen.std[0]:
        yield (
            f"the noise of the velocity shifts J_1 by {chosen.bias[0]:+.2g}, more than its "
            "standard deviation: give a larger width, or compare with greybox"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _TorqueBalance:
    """Equations of the torque balance for decimated signals of all experiments."""

    target: Vector
    """Acceleration (M,), NaN where it is not known."""
    X: Matrix
    """Regressors (M, columns): torque; then velocity, sign and offset if they are estimated."""
    moved: Matrix
    """Derivatives of the torque with respect to the fixed parameters, (M, held)."""
    by_velocity: Vector
    """Derivatives of the columns with respect to the velocity, (columns,)."""
    sizes: tuple[int, ...]
    """Number of rows of each experiment."""


def _held(names: tuple[str, ...]) -> tuple[str, ...]:
    return _HELD_NAMES if "b_1" in names else (*_HELD_NAMES, "b_1")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Solution:
    """Least-squares solution of the torque balance."""

    beta: Vector
    """Coefficients of the columns, (columns,)."""
    by_held: Matrix
    """Derivatives of beta with respect to the fixed parameters, which change the first column."""
    condition: float
    """Condition number of the scaled columns."""
    moment: Matrix
    """Matrix X^T X / M, (columns, columns)."""
    inference: Inference
    """Covariance of beta, and loss."""
    residuals: list[Vector]
    """Residuals of each experiment, NaN where a residual is not known."""
    blocks: list[Matrix]
    """Columns of each experiment, 0 in rows where the residual is not known."""


def _solved(balance: _TorqueBalance, s: float) -> _Solution:
    """Return the least-squares solution of the complete rows."""
    kept = np.isfinite(balance.target)
    X, target, moved = balance.X[kept], balance.target[kept], balance.moved[kept]
    columns = X.shape[1]
    if target.size < _MIN_ROWS_PER_UNKNOWN * columns:
        raise InputError(
            f"smoothing over {s:.3g} s leaves {target.size} values for {columns} unknowns, "
            f"{_MIN_ROWS_PER_UNKNOWN} for each are needed; give longer data, or another width"
        )
    basis = orthonormal(X)
    if basis.rank < columns:
        raise InputError(
            "the data do not distinguish torque, friction and offset: excite the rig more"
        )
    beta, e = basis.coefficients(target), basis.without(target)
    e_of_rows = np.full(kept.size, np.nan)
    e_of_rows[kept] = e
    edges = np.cumsum(balance.sizes)[:-1]
    residuals = np.split(e_of_rows, edges)
    bread = basis.W @ basis.W.T
    return _Solution(
        beta=beta,
        by_held=np.outer(bread[:, 0], e @ moved) - beta[0] * basis.W @ (basis.Q.T @ moved),
        condition=float(np.linalg.cond(X / np.linalg.norm(X, axis=0))),
        moment=X.T @ X / target.size,
        inference=infer(
            least_squares_residuals(residuals, basis.spread(kept), y=balance.target),
            basis.W,
            score="exogenous",
            test=None,
        ),
        residuals=residuals,
        blocks=np.split(np.where(kept[:, None], balance.X, 0.0), edges),
    )


def _every(s: float, Ts: float) -> int:
    return max(1, int(_WIDTHS_PER_ROW * s / Ts))


def _offset_is_free(data: Dataset, names: tuple[str, ...]) -> bool:
    """Return whether u0 is estimated; if T_c is estimated, too, u0 requires a bipolar input."""
    return COULOMB not in names or bipolar(data.u)


def _torque_balance(
    data: Dataset, p: ArmParameters, names: tuple[str, ...], s: float
) -> _TorqueBalance:
    targets, rows, moved = [], [], []
    by_velocity: Vector = np.empty(0)
    every = _every(s, data.Ts)
    by_motor = p.damping - p.b_1
    damping = by_motor if "b_1" in names else p.damping
    for part in data.experiments():
        x = smoothed(part, s)
        driving, braking = p.torque_per_volt * x.u, by_motor * x.velocity
        columns = [driving - damping * x.velocity]
        slopes = [-damping]
        by = {
            "N": (driving - 2 * braking) / p.N,
            "R_m": (braking - driving) / p.R_m,
            "K_m": (driving - 2 * braking) / p.K_m,
            "b_1": -x.velocity,
        }
        moved.append(np.column_stack([by[k] for k in _held(names)])[::every])
        target = x.acceleration.copy()
        if "b_1" in names:
            columns.append(-x.velocity)
            slopes.append(-1.0)
        if COULOMB in names:
            columns.append(-np.sign(x.velocity))
            slopes.append(0.0)
            target[near_standstill(part, s)] = np.nan
        if _offset_is_free(data, names):
            columns.append(np.ones(part.N))
            slopes.append(0.0)
        by_velocity = np.array(slopes)
        targets.append(target[::every])
        rows.append(np.column_stack(columns)[::every])
    return _TorqueBalance(
        target=np.concatenate(targets),
        X=np.vstack(rows),
        moved=np.vstack(moved),
        by_velocity=by_velocity,
        sizes=tuple(t.size for t in targets),
    )


def _parameters(beta: Vector, names: tuple[str, ...]) -> tuple[dict[str, float], Matrix]:
    """Return J_1 = 1/beta_1 and the frictions beta_i/beta_1, with the derivatives by beta."""
    values = {"J_1": float(1 / beta[0])}
    slope = np.zeros((len(names), beta.size))
    slope[0, 0] = -1 / beta[0] ** 2
    for i, name in enumerate(names[1:], start=1):
        values[name] = float(beta[i] / beta[0])
        slope[i, 0], slope[i, i] = -beta[i] / beta[0] ** 2, 1 / beta[0]
    return values, slope
