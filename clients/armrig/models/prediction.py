"""Simulation, prediction and residuals of a model on measured data, and checks of these data."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from armrig_core.errors import InputError, InputTypeError

from armrig.data.dataset import Dataset, Signals, Vector
from armrig.data.finding import OWN_DATA, Finding, warning
from armrig.data.step import span_of
from armrig.models.innovations import Unknown, errors, prepared, regression, summed_input
from armrig.models.state_space import predicted as of_outputs
from armrig.models.structure import Structure, free_columns, transient_count
from armrig.models.transfer_function import TransferFunction
from armrig.numerics.checks import require_integers
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.noise_filter import NoiseFilter
from armrig.numerics.polynomial import Array, filtered, impulse, lagged, without_integrator
from armrig.numerics.regressors import complete, past

if TYPE_CHECKING:
    from armrig.models.fit import Fit


def simulated(model: Fit, part: Dataset) -> Vector:
    """Return the simulated output of one experiment (N,), from the least-squares initial state.

    With an integrator, or if the model has `offset`, the input offset is estimated too. The
    simulation error is then the same for detrended and for raw data.
    """
    F, u = model.denominator, part.u
    if model.integrator:
        F, u = without_integrator(F), summed_input(u, centred=True)
    count = transient_count(
        numerator_degree=model.B.size - 1,
        denominator_degree=model.denominator.size - 1,
        integrator=model.integrator,
    )
    with np.errstate(over="ignore", invalid="ignore"):
        forced = filtered(model.B, F, u)
        columns = free_columns(F, part.N, count=count, drift=True)
        columns = columns[:, : count + (2 if model.integrator else int(model.offset))]
        if not (np.isfinite(forced).all() and np.isfinite(columns).all()):
            # The output of an unstable model exceeds the range of floating-point numbers.
            return np.full(part.N, np.inf)
    free = orthonormal(columns[part.valid])
    return np.asarray(forced + columns @ free.coefficients(part.y[part.valid] - forced[part.valid]))


def predicted(model: Fit, data: Dataset | Signals, horizon: int | None) -> Array:
    """Return ŷ, as `Fit.predict` documents.

    Raises ValueError if horizon is below 1, or the data differ from the model in signals, units or
    Ts.
    """
    require_same_signals(model, data)
    if horizon is not None:
        require_integers(horizon=(horizon, 1))
    if model.Ts == 0:
        return predicted(model.to_discrete(data.Ts), data, horizon)
    if (model.ny, model.nu) != (1, 1):
        data = cast("Signals", data)
        system = model.form.realised()
        return np.concatenate(
            [
                of_outputs(
                    system,
                    part,
                    horizon=horizon,
                    integrating=model.form.integrators,
                    offset=model.offset,
                    noise_std=np.sqrt(np.diag(model.noise_covariance)),
                )
                for part in data.experiments()
            ]
        )
    parts = _single(data).experiments()
    if horizon is None or structure_of(model).white:
        return np.concatenate([simulated(model, part) for part in parts])
    if model.C.size == model.D.size == model.F.size == 1 and not (model.offset or model.integrator):
        return np.concatenate([_arx_predicted(model, part, horizon) for part in parts])
    return np.concatenate([_innovations_predicted(model, part, horizon) for part in parts])


def structure_of(model: Fit) -> Structure:
    """Return the structure of a model; its orders do not count the root of the integrator."""
    inside = {"a": 0, "f": 0, model.integrating: 1}
    return Structure(
        na=model.A.size - 1 - inside["a"],
        nb=(model.B.size - model.nk,),
        nc=model.C.size - 1,
        nd=model.D.size - 1,
        nf=(model.F.size - 1 - inside["f"],),
        nk=(model.nk,),
        integrator=model.integrating,
        offset=model.offset,
    )


def _innovations_predicted(model: Fit, part: Dataset, horizon: int) -> Vector:
    """Return y(t) minus the contribution of the innovations of the last `horizon` samples."""
    found = prediction_errors(model, part)
    e, ahead = found.e, min(horizon, part.N)
    if found.noise is not None and model.integrating != "a":
        return np.asarray(part.y - found.noise.ahead(np.nan_to_num(e), ahead))
    h = filtered(model.C, np.convolve(model.A, model.D), impulse([1.0], ahead))
    return np.asarray(part.y - lagged(e, range(ahead)) @ h)


def _arx_predicted(model: Fit, part: Dataset, horizon: int) -> Vector:
    known = _known_past(model, part)
    driven = filtered(model.B, [1.0], part.u)
    driven[: model.B.size - 1] = np.nan
    N, k = part.N, min(horizon, part.N)
    y = np.full(N, np.nan)
    ahead = known[: N - k + 1]
    now = np.zeros(0)
    for i in range(k):
        now = driven[i : N - k + 1 + i] - ahead @ model.A[1:]
        ahead = np.column_stack([now, ahead[:, :-1]])
    y[k - 1 :] = now
    return y


def _known_past(model: Fit, part: Dataset) -> Array:
    """Return E[y(t-1) … y(t-na) | data to t-1], (N, na); NaN before na successive measurements."""
    # A Kalman filter estimates samples during and after a gap.
    na = model.A.size - 1
    a = model.A[1:]
    known = past(part.y, range(1, na + 1))
    whole = complete(known)
    driven = filtered(model.B, [1.0], part.u)
    shift = np.vstack([-a, np.eye(na - 1, na)])
    P = np.zeros((na, na))
    for t in np.flatnonzero(~whole):
        if t == 0 or not np.isfinite(known[t - 1]).all():
            continue
        P = np.zeros((na, na)) if whole[t - 1] else P
        x = shift @ known[t - 1]
        x[0] += driven[t - 1]
        P = shift @ P @ shift.T
        P[0, 0] += 1.0  # P is relative to the noise variance, which does not change the gain
        if part.valid[t - 1]:
            gain = P[:, 0] / P[0, 0]
            x = x + gain * (part.y[t - 1] - x[0])
            P = P - np.outer(gain, P[0])
        known[t] = x
    return known


@dataclass(frozen=True, slots=True, kw_only=True)
class Residuals:
    """One-step prediction errors of one experiment, and their derivatives."""

    e: Vector
    """Errors (N,), NaN if y or a necessary past sample is missing. After a gap the errors of a
    model with C or D are scaled to the variance of e."""
    Psi: Array
    """Derivatives of the prediction with respect to the free parameters, (N, d); 0 in rows without
    a prediction error. Their projection on the basis of the unknown past is subtracted."""
    unknown: Unknown
    """Basis of the unknown past."""
    noise: NoiseFilter | None = None
    """Filter of data with gaps, for a model with C or D."""


def prediction_errors(model: Fit, part: Dataset) -> Residuals:
    """Return the residuals of one experiment, with the unknown past estimated by least squares.

    A model in continuous time is sampled, and Psi are the derivatives by its own parameters.
    """
    if isinstance(model.form, TransferFunction):
        sampled, J = model.form.sampled(part.Ts)
        found = prediction_errors(model.to_discrete(part.Ts), part)
        if model.integrator:  # f̃_k = f_1 + … + f_k
            of_f = sampled.slice_of("f", 0, 0)
            J[of_f] = np.cumsum(J[of_f], axis=0)
            J = np.delete(np.delete(J, of_f.stop - 1, axis=0), model.slice_of("f").stop - 1, axis=1)
        return replace(found, Psi=found.Psi @ J)
    structure = structure_of(model)
    p = {letter: getattr(model, letter) for letter in "ABCDF"}
    if model.integrating:
        p[model.integrating.upper()] = without_integrator(p[model.integrating.upper()])
    experiment = prepared(part.u, part.y, structure)
    with np.errstate(over="ignore", invalid="ignore"):
        C, D, F = p["C"], p["D"], p["F"]
        if not np.isfinite(filtered(np.convolve(D, model.B), np.convolve(C, F), part.u)).all():
            # The output of an unstable predictor overflows.
            nothing = Unknown(basis=orthonormal(np.zeros((0, 0))), pulses=0, N=part.N)
            none = np.zeros((part.N, model.parameters))
            return Residuals(e=np.full(part.N, np.nan), Psi=none, unknown=nothing)
        given = regression(experiment, structure, A=p["A"], C=C, D=D, F=[F])
        known = errors(experiment, structure, given, A=p["A"], B=[p["B"]], C=C, D=D, F=[F])
    by_a, others = np.split(known.Psi, [structure.na], axis=1)
    return Residuals(
        e=np.where(experiment.rows, known.e, np.nan),
        Psi=given.unknown.without(np.hstack([by_a, given.X, others])),
        unknown=given.unknown,
        noise=given.noise,
    )


def _single(data: Dataset | Signals) -> Dataset:
    return data if isinstance(data, Dataset) else data.dataset()


def require_same_signals(model: Fit, data: Dataset | Signals) -> None:
    """Refuse data that differ from the model in signals, units or sampling time.

    For one input and one output, an empty name matches any name, and an empty unit any unit. The
    name y counts as empty.
    """
    if (model.ny, model.nu) != (1, 1):
        _require_same_channels(model, data)
        return
    if not isinstance(data, Dataset | Signals):
        raise InputTypeError(
            f"data is a {type(data).__name__}: give a Dataset; for an input, use fit.simulate(u)"
        )
    one = _single(data)
    _require_same_Ts(model, one.Ts)
    names = {model.output, one.output} - {"", "y"}
    units = {model.unit, one.unit} - {""}
    if len(names) > 1 or len(units) > 1:
        of_model, of_data = (f"{x.output} [{x.unit or '–'}]" for x in (model, one))
        raise InputError(
            f"the model's output is {of_model} and the data contain {of_data}; validate with the "
            f"model's output, recording.dataset(output={model.output!r})"
        )


def _require_same_channels(model: Fit, data: object) -> None:
    if not isinstance(data, Signals):
        raise InputTypeError(
            f"data is a {type(data).__name__}: give Signals with {', '.join(model.outputs)} and "
            f"{', '.join(model.inputs)}; for inputs alone, use fit.simulate(u)"
        )
    _require_same_Ts(model, data.Ts)
    for what, own, theirs in (
        ("outputs", model.outputs, data.outputs),
        ("inputs", model.inputs, data.inputs),
    ):
        if own != theirs:
            raise InputError(
                f"the model's {what} are {', '.join(own)} and the data have {', '.join(theirs)}; "
                "choose them with signals.channels(outputs, inputs)"
            )


def _require_same_Ts(model: Fit, Ts: float) -> None:
    if model.Ts and not np.isclose(model.Ts, Ts, rtol=1e-9, atol=0.0):
        raise InputError(
            f"the model has Ts={model.Ts:g} s and the data have Ts={Ts:g} s; "
            "identify and validate at the same rate"
        )


def findings_on_own_data(
    models: Iterable[tuple[str, Any]], data: Dataset | Signals
) -> Iterator[Finding]:
    """Yield warnings about models whose estimation data are these data or overlap these data.

    The models are given with their names. A model without estimation data, such as the physical
    model, has no finding.
    """
    named = list(models)
    same = [name for name, model in named if model.estimated_from(data)]
    if same:
        yield warning("own data", OWN_DATA)
    for name, model in named:
        if name not in same and (both := _overlap(model, data)) is not None:
            start, stop = both
            yield warning(
                "overlap",
                f"{name} was also estimated from {start:g} to {stop:g} s of the same file, which "
                "gives too good results: validate on other data",
                start=start,
                stop=stop,
            )


def _overlap(model: Any, data: Dataset | Signals) -> tuple[float, float] | None:
    """Return start and end, in s of the file, of the overlap of a model's data with these data."""
    source = getattr(model, "source", "")
    if not source or source != data.source:
        return None
    ours, theirs = span_of(getattr(model, "history", ())), span_of(data.history)
    if ours is None or theirs is None:
        return None
    start = max(ours[0], theirs[0])
    stop = min(ours[1], theirs[1], theirs[0] + data.N * data.Ts)
    return (start, stop) if stop - start > 0.5 * data.Ts else None
