"""Prediction-error estimates of models A y = B/F u + C/D e, a function for each structure."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Parameter, signature
from typing import TypeVar, Unpack

from armrig.data.argument import takes_data
from armrig.data.dataset import Dataset, Signals
from armrig.estimation.orders import Orders
from armrig.estimation.prediction_error import SearchOptions, estimated
from armrig.models.fit import Fit
from armrig.models.structure_table import STRUCTURES

F = TypeVar("F", bound=Callable[..., Fit])


def _with_options(f: F) -> F:
    """Name the options of the structure in the signature of f, for help and error messages."""
    called, parameters = signature(f), signature(estimated).parameters
    arguments = [p for p in called.parameters.values() if p.kind is not Parameter.VAR_KEYWORD]
    options = [parameters[name] for name in STRUCTURES[f.__name__].takes]
    f.__signature__ = called.replace(parameters=[*arguments, *options])  # type: ignore[attr-defined]
    return f


@takes_data
@_with_options
def oe(
    data: Dataset | Signals,
    *,
    nb: Orders,
    nf: Orders,
    nk: Orders = 1,
    **options: Unpack[SearchOptions],
) -> Fit:
    """Estimate B and F in y_i(t) = sum of B_ij(q)/F_ij(q) u_j(t) + e_i(t).

    Parameters
    ----------
    data : Dataset or Signals
        N samples. A missing y removes only the equation of its own sample. Each experiment has its
        own initial state.
    nb, nf : int, array_like (ny, nu) or mapping
        Numbers of coefficients of each output and input. A mapping has keys such as
        ("y", "u"). nb is 0 if the input does not affect the output.
    nk : int, array_like (ny, nu) or mapping, default 1
        Number of samples before u reaches y; 0 means a direct term.
    integrator : bool, str or sequence of str, default False
        For all outputs or the named outputs, set F = (1 - q^-1) F̃, with one root at exactly 1. In a
        structure without F, set A = (1 - q^-1) Ã. The root counts as one coefficient of F or A,
        except with a shared denominator. With F the noise is added to the integrated output. The
        level and the input offset of each experiment are estimated too, the offset as a ramp of y.
        With A the input *and noise* are integrated, and the input offset is estimated. For noise
        that is not integrated, such as sensor noise, use `oe` or `bj`.
    offset : bool, default False
        Also estimate an input offset for each experiment: a level of A y. With an integrator the
        offset is always estimated.
    initial : {"estimate", "backcast", "zero", "auto"}
        Treatment of the unknown past (the initial state) of each experiment. With "estimate" or
        "backcast" the past is estimated by least squares. With "zero" the experiment is assumed to
        begin at rest, at y = 0, without an input offset. With "auto" the past is estimated if an
        F-test finds it significant.
    stable : bool, default False
        Reflect poles outside the unit circle into the circle, move poles on the circle into the
        circle, and estimate B again. A finding of the fit reports the reflection. During the search
        all poles of F stay inside or on the circle.
    starts : {"many", "few"}, default "many"
        With "many" the search starts again from copies of the best model in which one mode has
        another frequency or damping. With "few" only complex root pairs of F are changed, and only
        if the first searches end in different minima or the noise is strong. "few" needs a tenth to
        a half of the time of "many", but ends in a poorer minimum more often.
    shared : {"", "denominator"}
        With "denominator" all outputs and inputs have the same F, or the same A in a structure
        without F, and the inverse covariance matrix of e weights the outputs. For an output with an
        integrator, the denominator is multiplied by 1 - q^-1; this root does not count in nf or na.
        Without a shared denominator each output is estimated separately.

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 for (b, f), with the nuisance parameters marginalised.
        `covariance_robust` is the sandwich form with an autoregressive estimate of the residuals'
        autocorrelation. With an integrator both are singular in the direction that would move the
        root at 1.

    Raises
    ------
    ValueError
        An order has a wrong shape, there are too few samples for the orders, or u does not excite
        the numerator.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 7.2, 9.3 and 10.2.

    Examples
    --------
    >>> data = armrig.example_recording().dataset("theta_1")
    >>> fit = armrig.oe(data, nb=4, nf=4, integrator=True)
    >>> fit.heading, fit.white.coloured
    ('OE(nb=4, nf=4, nk=1)', False)
    >>> fit.F.round(2)
    array([ 1.  , -3.51,  4.62, -2.7 ,  0.59])
    >>> fit.poles().values.round(2)
    array([1.  +0.j  , 0.91+0.16j, 0.91-0.16j, 0.69+0.j  ])
    """
    return estimated(data, "oe", {"nb": nb, "nf": nf, "nk": nk}, **options)


@takes_data
@_with_options
def armax(
    data: Dataset | Signals,
    *,
    na: Orders,
    nb: Orders,
    nc: Orders,
    nk: Orders = 1,
    **options: Unpack[SearchOptions],
) -> Fit:
    """Estimate A, B and C in A_i(q) y_i(t) = sum of B_ij(q) u_j(t) + C_i(q) e_i(t).

    Input and noise have the same poles.

    Parameters
    ----------
    data : Dataset or Signals
        N samples. After a missing y the noise is predicted by a Kalman filter, and the search is
        over A, too.
    na, nc : int, array_like (ny,) or mapping
        Numbers of coefficients a and c of each output, >= 0.
    nb, nk, **options
        As in `oe`.

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 for (a, b, c). `covariance_robust` is the estimate of
        Newey and West.

    Raises
    ------
    ValueError
        As for `oe`, or u does not excite A and B.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 4.2, 7.2 and 10.2.

    Examples
    --------
    The noise of the example is white noise on the output, so that C equals A.

    >>> data = armrig.example_recording().dataset("alpha")
    >>> fit = armrig.armax(data, na=3, nb=3, nc=3)
    >>> fit.A.round(1)
    array([ 1. , -2.5,  2.1, -0.6])
    >>> fit.C.round(1)
    array([ 1. , -2.5,  2.1, -0.6])
    """
    return estimated(data, "armax", {"na": na, "nb": nb, "nc": nc, "nk": nk}, **options)


@takes_data
@_with_options
def ararx(
    data: Dataset | Signals,
    *,
    na: Orders,
    nb: Orders,
    nd: Orders,
    nk: Orders = 1,
    **options: Unpack[SearchOptions],
) -> Fit:
    """Estimate A, B and D in A_i(q) y_i(t) = sum of B_ij(q) u_j(t) + 1/D_i(q) e_i(t).

    D whitens the error of an ARX model, as in generalised least squares. Errors and references are
    those of `armax`.

    Parameters
    ----------
    na, nd : int, array_like (ny,) or mapping
        Numbers of coefficients a and d of each output, >= 0.
    data, nb, nk, **options
        As in `armax`.

    Returns
    -------
    Fit
        The covariances are those of `armax`, for (a, b, d).

    Examples
    --------
    Without D the noise biases A.

    >>> data = armrig.example_recording().dataset("alpha")
    >>> armrig.ararx(data, na=3, nb=3, nd=10).A.round(1)
    array([ 1. , -2.5,  2.1, -0.6])
    >>> armrig.arx(data, na=3, nb=3).A.round(1)
    array([ 1. , -1.7,  0.5,  0.2])
    """
    return estimated(data, "ararx", {"na": na, "nb": nb, "nd": nd, "nk": nk}, **options)


@takes_data
@_with_options
def bj(
    data: Dataset | Signals,
    *,
    nb: Orders,
    nc: Orders,
    nd: Orders,
    nf: Orders,
    nk: Orders = 1,
    **options: Unpack[SearchOptions],
) -> Fit:
    """Estimate B, F, C and D in y_i = sum of B_ij(q)/F_ij(q) u_j + C_i(q)/D_i(q) e_i.

    Errors and references are those of `armax`.

    Parameters
    ----------
    data : Dataset or Signals
        N samples. The output of B/F is simulated through a gap in y. After a missing y the noise is
        predicted by a Kalman filter.
    nc, nd : int, array_like (ny,) or mapping
        Numbers of coefficients of C and D of each output, >= 0.
    nb, nf, nk, **options
        As in `oe`.

    Returns
    -------
    Fit
        The covariances are those of `armax`, for (b, c, d, f). For nc = nd = 0 they equal the
        covariances of `oe`.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy.signal import lfilter
    >>> data = armrig.example_recording().dataset("alpha")
    >>> noise = lfilter([1], [1, -0.9], 0.01 * np.random.default_rng(1).standard_normal(data.N))
    >>> noisy = armrig.Dataset(u=data.u, y=data.y + noise, Ts=data.Ts)
    >>> armrig.bj(noisy, nb=3, nc=0, nd=1, nf=3).D.round(1)
    array([ 1. , -0.9])
    """
    return estimated(data, "bj", {"nb": nb, "nc": nc, "nd": nd, "nf": nf, "nk": nk}, **options)


@takes_data
@_with_options
def pem(
    data: Dataset | Signals,
    *,
    nb: Orders,
    na: Orders = 0,
    nc: Orders = 0,
    nd: Orders = 0,
    nf: Orders = 0,
    nk: Orders = 1,
    **options: Unpack[SearchOptions],
) -> Fit:
    """Estimate the polynomials in A_i y_i = sum of B_ij/F_ij u_j + C_i/D_i e_i for given orders.

    Errors and references are those of `armax`.

    Parameters
    ----------
    na, nc, nd : int, array_like (ny,) or mapping
        Numbers of coefficients of A, C and D of each output, >= 0. Combine A with F, or A with D,
        only if input and noise are known to share some poles. Otherwise the data hardly distinguish
        A from F and D.
    data, nb, nf, nk, **options
        As in `armax` and `oe`. There is no option `integrator`.

    Returns
    -------
    Fit
        The covariances are those of `armax`, for (a, b, c, d, f).

    Examples
    --------
    The noise of the example is white, so that d1 is 0 within two standard deviations.

    >>> data = armrig.example_recording().dataset("alpha")
    >>> fit = armrig.pem(data, nb=3, nf=3, nd=1)
    >>> fit.names
    ('b1', 'b2', 'b3', 'd1', 'f1', 'f2', 'f3')
    >>> fit.F.round(2)
    array([ 1.  , -2.51,  2.11, -0.59])
    >>> bool(abs(fit.theta[3]) < 2 * fit.std[3])
    True
    """
    orders = {"na": na, "nb": nb, "nc": nc, "nd": nd, "nf": nf, "nk": nk}
    return estimated(data, "pem", orders, **options)
