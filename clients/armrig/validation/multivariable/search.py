"""Search over models of several signals for a simple model that is as good as the best."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, cast, get_args

import numpy as np
from armrig_core.errors import InputError

from armrig.data.signals import Signals
from armrig.estimation.channel_orders import integrating_outputs
from armrig.estimation.multivariable.n4sid import n4sid
from armrig.estimation.multivariable.ss import ss
from armrig.estimation.oe import oe
from armrig.models.multivariable.fit import MultivariableFit, require_same_channels
from armrig.numerics.checks import require_integers, several, several_of
from armrig.numerics.criteria import batch_means, simplest_as_good, standard_error
from armrig.numerics.polynomial import Array
from armrig.validation.data_parts import estimation_and_validation

SearchedName = Literal["ss", "n4sid", "oe"]
FAMILIES: tuple[SearchedName, ...] = get_args(SearchedName)
"""Structures that are searched; oe has a shared denominator."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SignalsCandidate:
    """A structure of one order, with its errors on the validation data."""

    family: SearchedName
    """Name of the structure."""
    order: int
    """Number of poles, without the poles of integrators."""
    fit: MultivariableFit | None
    """The model; None if the estimate failed."""
    reason: str
    """Reason why there is no usable model, or ""."""
    error: Array
    """Sum over the outputs of (y - ŷ)² / var y at each instant, (N,); empty without a model."""

    @property
    def name(self) -> str:
        """Structure and order as text, such as "ss of order 3"."""
        return f"{self.family} of order {self.order}"

    @property
    def parameters(self) -> int:
        """Number of free parameters, 0 without a model."""
        return 0 if self.fit is None else _free(self.fit)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SignalsSearch:
    """Models of several signals, ranked on validation data, with the choice."""

    ranked: tuple[SignalsCandidate, ...]
    """Usable candidates, least error first."""
    failed: tuple[SignalsCandidate, ...]
    """Candidates without a usable model."""
    excess: Array
    """Mean error of each candidate minus the mean error of the best candidate, (n,)."""
    excess_std: Array
    """Standard error of `excess`, (n,)."""
    chosen_index: int
    """Index of the simplest candidate that is as good as the best."""
    halved: bool
    """True if the second part of the data was used for validation."""
    horizon: int | None
    """Number of samples predicted ahead; None for simulation."""
    nk: int
    """Number of samples before each input affects the outputs."""

    @property
    def chosen(self) -> SignalsCandidate:
        """The chosen candidate."""
        return self.ranked[self.chosen_index]

    @property
    def fit(self) -> MultivariableFit:
        """The chosen model."""
        found = self.chosen.fit
        if found is None:
            raise InputError(self.chosen.reason)
        return found

    def explain(self) -> str:
        """Return the reasons for the choice, one sentence per line."""
        best, chosen = self.ranked[0], self.chosen
        where = "the second part of the data" if self.halved else "the validation data"
        how = "simulated" if self.horizon is None else f"predicted {self.horizon} ahead"
        lines = [f"{best.name}, {how}, has the least error on {where}."]
        if chosen is not best:
            lines.append(
                f"{chosen.name} has fewer parameters ({chosen.parameters} instead of "
                f"{best.parameters}), and its error exceeds the least by no more than the "
                "standard error of the difference."
            )
        return "\n".join(lines)

    def __repr__(self) -> str:
        """Return the table of the candidates, and the reasons."""
        lines = [f"{'model':16} {'parameters':>10} {'error':>10} {'excess':>10} {'± ':>9}"]
        rows = zip(self.ranked, self.excess, self.excess_std, strict=True)
        for candidate, excess, std in rows:
            mark = "  chosen" if candidate is self.chosen else ""
            lines.append(
                f"{candidate.name:16} {candidate.parameters:10} {_mean(candidate.error):10.4g} "
                f"{excess:10.2g} {std:9.2g}{mark}"
            )
        lines += [f"{candidate.name:16} {candidate.reason}" for candidate in self.failed]
        return "\n".join([*lines, self.explain()])


def search(
    data: Signals,
    validation: Signals | None = None,
    *,
    families: Sequence[SearchedName] = FAMILIES,
    orders: Iterable[int] = range(1, 9),
    nk: int = 1,
    integrator: bool | str | Sequence[str] = False,
    horizon: int | None = None,
    progress: Callable[[int, int, str], object] | None = None,
) -> SignalsSearch:
    """Estimate models of several orders, rank them on other data, and choose a simple good model.

    The error of a model is the sum over the outputs of the mean of (y - ŷ)² / var y. The excess of
    a model is its error minus the error of the best model. A model is as good as the best if its
    excess is at most the standard error of the excess. The standard error is computed from 30 batch
    means. Of the models that are as good as the best, the simplest is chosen.

    Parameters
    ----------
    data : Signals
        Data to estimate from.
    validation : Signals, optional
        Data to rank the models on; by default the second half of `data`, or
        a second part in which each input moves.
    families : sequence of {"ss", "n4sid", "oe"}
        Structures to try. "oe" has a shared denominator. If samples are missing, "ss" has no K.
    orders : iterable of int
        Numbers of poles, >= 1, without the poles of integrators.
    nk : int, default 1
        Number of samples before each input affects the outputs.
    integrator : bool, str or sequence of str, default False
        Outputs with a pole at 1. With such an output, only "oe" is tried, because a state-space
        model has no fixed pole.
    horizon : int, optional
        Samples to predict ahead, >= 1; by default the models are simulated.
    progress : callable, optional
        Called with the number of finished candidates, the number of all candidates, and the name of
        the next candidate.

    Returns
    -------
    SignalsSearch
        `fit` is the chosen model, and `ranked` contains the usable models.

    Raises
    ------
    ValueError
        No model could be estimated, or an argument is out of range.
    """
    orders = several("orders", orders)
    halved = validation is None
    if validation is None:
        data, validation = estimation_and_validation(data)
    families = several_of("families", families, FAMILIES)
    if any(integrating_outputs(integrator, data)):
        families = ["oe"]
    plan = [(family, int(n)) for family in families for n in orders]
    for _, n in plan:
        require_integers(orders=(n, 1))
    scored = []
    for k, (family, n) in enumerate(plan):
        if progress is not None:
            progress(k, len(plan), f"{family} of order {n}")
        scored.append(_scored(family, n, data, validation, nk, integrator, horizon))
    if progress is not None:
        progress(len(plan), len(plan), "")
    found = _ranked(scored, halved=halved, horizon=horizon, nk=nk)
    chosen = found.chosen
    if chosen.family != "n4sid":
        return found
    # Only the chosen n4sid model has a covariance, because the covariance costs a hundred
    # estimates.
    ranked = [*found.ranked]
    ranked[found.chosen_index] = replace(chosen, fit=n4sid(data, chosen.order, nk=nk))
    return replace(found, ranked=tuple(ranked))


def _scored(
    family: SearchedName,
    n: int,
    data: Signals,
    validation: Signals,
    nk: int,
    integrator: bool | str | Sequence[str],
    horizon: int | None,
) -> SignalsCandidate:
    """Estimate a candidate, and return its errors."""
    none = np.zeros(0)
    try:
        with np.errstate(all="ignore"):
            fit = _estimated(family, n, data, nk, integrator)
            require_same_channels(fit, validation)
            e = np.where(validation.valid, validation.y - fit.predict(validation, horizon), np.nan)
    except (ValueError, np.linalg.LinAlgError) as err:
        return SignalsCandidate(family=family, order=n, fit=None, reason=str(err), error=none)
    error = np.nansum((e / np.nanstd(validation.y, axis=0)) ** 2, axis=1)
    reason = "" if np.isfinite(error).all() else "its output is unbounded"
    return SignalsCandidate(family=family, order=n, fit=fit, reason=reason, error=error)


def _estimated(
    family: SearchedName, n: int, data: Signals, nk: int, integrator: bool | str | Sequence[str]
) -> MultivariableFit:
    if family == "oe":
        integrating = integrating_outputs(integrator, data)
        nb = {
            (output, input): n + int(of)
            for output, of in zip(data.outputs, integrating, strict=True)
            for input in data.inputs
        }
        fit: Any = oe(data, nb=nb, nf=n, nk=nk, integrator=integrator, shared="denominator")
        return cast("MultivariableFit", fit)
    if family == "ss":
        return ss(data, order=n, nk=nk, noise=not data.missing)
    return n4sid(data, n, nk=nk, replicates=0)


def _ranked(
    scored: Sequence[SignalsCandidate], *, halved: bool, horizon: int | None, nk: int
) -> SignalsSearch:
    usable = sorted((c for c in scored if not c.reason), key=lambda c: _mean(c.error))
    failed = tuple(c for c in scored if c.reason)
    if not usable:
        raise InputError(
            f"none of the models could be estimated; the first, {failed[0].name}: "
            f"{failed[0].reason}"
        )
    difference = np.array([c.error - usable[0].error for c in usable])
    std = standard_error(np.array([batch_means(d) for d in difference]))
    excess = difference.mean(axis=1)
    return SignalsSearch(
        ranked=tuple(usable),
        failed=failed,
        excess=excess,
        excess_std=std,
        chosen_index=simplest_as_good(excess, std, [c.parameters for c in usable]),
        halved=halved,
        horizon=horizon,
        nk=nk,
    )


def _mean(error: Array) -> float:
    return float(np.mean(error))


def _free(fit: MultivariableFit) -> int:
    """Return the number of free parameters; the choice of the state coordinates does not count."""
    if fit.structure not in ("ss", "n4sid"):
        return int(fit.theta.size)
    A, B, C, D, _ = fit.state_space()
    n, nu, ny = A.shape[0], B.shape[1], C.shape[0]
    return int(n * (nu + 2 * ny) + (ny * nu if D.any() else 0))
