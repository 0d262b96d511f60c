"""Search over model structures: what predicts other data best, and what is as good and simpler."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.estimation.data_faults import level_without_input
from armrig.estimation.stability import largest_unstable
from armrig.models.fit import Fit
from armrig.models.prediction import require_same_signals
from armrig.models.structure_table import FAMILIES, OFFERED, Family
from armrig.numerics.checks import require_integers, require_several
from armrig.numerics.criteria import batch_means, simplest_as_good, standard_error
from armrig.validation.advice.data_advice import Tested, doubts, tested
from armrig.validation.feedback_and_delay.delay_result import Delay
from armrig.validation.residuals import residuals
from armrig.validation.search_result import Candidate, Scored, SearchResult

Vector = NDArray[np.float64]

_LIKELY = 2.0  # deviations of a level from 0, from which it is better estimated along
_NOISE_ORDERS = (1, 2)  # of C and of D in a Box-Jenkins model
_ROUNDING = 1e-9  # share of y below which errors are all the same
_UNBOUNDED = 1e3  # times the largest output, beyond which an error is that of no model


@takes_recordings
def search(
    data: Dataset,
    validation: Dataset | None = None,
    *,
    families: Sequence[Family] | None = None,
    orders: Iterable[int] = range(1, 6),
    nk: int | Iterable[int] | None = None,
    integrator: bool | None = None,
    offset: bool | None = None,
    horizon: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int, str], object] | None = None,
) -> SearchResult:
    """Estimate many structures, rank them on other data, choose the simplest as good as the best.

    A candidate of order n has n poles and n numerator coefficients; a Box-Jenkins one also nc =
    nd = 1 and 2. The best has the least mean squared error on the validation data. As good is
    whose mean of e² - e²_best is at most its standard error, from the means of 30 batches, since
    the errors of a simulation are correlated; the simplest has the fewest parameters. In 200 runs
    of an output-error system of order 3 (N = 1000 to estimate, as many to validate) that was the
    true order in 82 %, the best in 48 %, with orders 1 to 5; the rest was larger.

    No pole of a candidate is on the unit circle or outside it, but an integrator that is known:
    the estimators are called with `stable=True`, and the chosen model says where that moved one.

    Parameters
    ----------
    data : Dataset
        To estimate from.
    validation : Dataset, optional
        Other data; by default the second half of `data`, of which then the first half estimates.
    families : sequence of str, optional
        Names of structures, such as "oe"; by default all but "ararx" and "pem", and in closed loop
        those of them whose noise model keeps feedback from a bias.
    orders : iterable of int
        Numbers of poles to try, >= 1, an integrator's included.
    nk : int or iterable of int, optional
        Samples before u reaches y, all of them tried; by default what `delay` finds, at least 1,
        and 0 beside it where a direct term is not ruled out. In closed loop a direct term is not
        tried, for it would be the controller's; where feedback and a direct term look the same it
        is, and `doubts` say so.
    integrator : bool, optional
        Whether structures that can have one get a pole at 1 exactly; by default where the output
        is an angle, or is found to integrate.
    offset : bool, optional
        Whether structures that can estimate the input's offset along; by default
        where y has a level that u does not make (2 deviations), in either data.
    horizon : int, optional
        Samples ahead, >= 1; by default the models are simulated, and "n4sid" is estimated with
        `focus="simulation"`. In closed loop it is 1 by default: the best simulation would be
        that of a biased model.
    executor : concurrent.futures.Executor, optional
        Where the candidates are estimated, such as a ``ProcessPoolExecutor``; here by default.
    progress : callable, optional
        Called with the number of candidates done, of all, and the name of the next one, "" after
        the last.

    Returns
    -------
    SearchResult
        `fit` is the chosen model, `ranked` all of them, `explain()` the reasons, `doubts` what
        speaks against the data.

    Raises
    ------
    ValueError
        Nothing could be estimated, or an argument is out of range.

    References
    ----------
    .. [1] T. Hastie, R. Tibshirani, J. Friedman, *The Elements of Statistical Learning*, 2nd ed.,
       2009, section 7.10 (one standard error).
    """
    require_several(orders=orders)
    halved = validation is None
    if validation is None:
        data, validation = data.split(2)
    known = tested(data, integrator)
    if nk is None:
        nk = _likely_delays(known)
    delays = [nk] if isinstance(nk, int) else [*nk]
    if families is None:
        families = [
            name
            for name, kind in OFFERED.items()
            if kind.searched and (kind.closed_loop or not known.closed)
        ]
    if horizon is None and known.closed:
        horizon = 1
    against = doubts(data, known)
    notes = [*known.integration.notes]
    level = [f for f in against if f.about == "level"]
    of_validation = None
    if offset is None and not known.integration.integrates:
        # A level of the validation data alone would rank models by how they happen to meet it.
        of_validation = level_without_input(validation, _LIKELY)
        offset = bool(of_validation or level_without_input(data, _LIKELY))
    said = level_without_input(data) if level else of_validation
    if offset and said:
        against = [f for f in against if f not in level]
        where = "" if level else "in the validation data "
        able = ", ".join(name.upper() for name in families if "offset" in OFFERED[name].takes)
        notes.append(f"{where}{said.text}: {able} estimate it along, offset=True")
    candidates = list(
        _candidates(
            [*families],
            [*orders],
            delays,
            integrator=known.integration.integrates,
            offset=bool(offset),
            simulated=horizon is None,
        )
    )
    score = partial(_score, data=data, validation=validation, horizon=horizon)
    coming = (map if executor is None else executor.map)(score, candidates)
    scored = _counted(coming, [c.name for c in candidates], progress)
    ranking = _ranked(scored, validation)
    return SearchResult(
        ranked=tuple(ranking.usable),
        rms=ranking.rms,
        excess=ranking.excess,
        excess_std=ranking.excess_std,
        chosen_index=ranking.chosen,
        failed=tuple(j for j in scored if j.reason),
        doubts=tuple(against),
        notes=tuple(notes),
        halved=halved,
        tests=residuals(ranking.fit, validation),
        horizon=horizon,
        unit=validation.unit,
    )


def _counted(
    coming: Iterable[Scored],
    names: list[str],
    progress: Callable[[int, int, str], object] | None,
) -> list[Scored]:
    """Return all that come, each told before it is waited for."""
    tell = progress or (lambda done, total, name: None)
    scored, following = [], iter(coming)
    for k, name in enumerate(names):
        tell(k, len(names), name)
        scored.append(next(following))
    tell(len(names), len(names), "")
    return scored


def _candidates(
    families: list[Family],
    orders: list[int],
    delays: list[int],
    *,
    integrator: bool,
    offset: bool,
    simulated: bool,
) -> Iterator[Candidate]:
    for family in families:
        if family not in FAMILIES:
            raise InputError(f"families has {family!r}; each must be one of {', '.join(FAMILIES)}")
    for n in orders:
        require_integers(orders=(n, 1))
    for nk in delays:
        require_integers(nk=(nk, 0))
    for family in families:
        kind = OFFERED[family]
        for nk in delays:
            for n in orders:
                for named in _orders(family, n):
                    yield Candidate(
                        family=family,
                        orders=(*named.items(), ("nk", nk)),
                        integrator=integrator and "integrator" in kind.takes,
                        offset=offset and "offset" in kind.takes,
                        simulates=simulated and "focus" in kind.takes,
                    )


def _likely_delays(known: Tested) -> list[int]:
    """Return the least nk that is not ruled out, 1 where it cannot be told or is 0, too."""
    if not isinstance(known.late, Delay):
        return [1]
    nk = max(known.late.nk, 1)
    return [0, nk] if known.late.interval[0] == 0 else [nk]


def _orders(family: Family, n: int) -> list[dict[str, int]]:
    """Return the orders to try with n poles; a noise model of its own is tried small."""
    names = OFFERED[family].orders
    noise = _NOISE_ORDERS if "nd" in names else (n,)
    return [{name: m if name in ("nc", "nd") else n for name in names} for m in noise]


def _score(candidate: Candidate, data: Dataset, validation: Dataset, horizon: int | None) -> Scored:
    none = np.zeros(0)
    try:
        with np.errstate(all="ignore"):
            fit = candidate.estimated(data)
            require_same_signals(fit, validation)
            error = validation.y - fit.predict(validation, horizon=horizon)
    except (ValueError, np.linalg.LinAlgError) as err:
        return Scored(candidate=candidate, fit=None, reason=str(err), error=none)
    reason = ""
    # Of errors that grow to the end the mean is as large as its standard error, however large.
    bound = _UNBOUNDED * np.max(np.abs(validation.y[validation.valid]), initial=0.0) or np.inf
    if not np.isfinite(fit.theta).all() or (np.abs(error) > bound).any():
        reason = "its output has no bound"
    elif farthest := largest_unstable(fit):
        reason = f"a pole at |z| = {farthest:.4f} is not inside the unit circle"
    return Scored(candidate=candidate, fit=fit, reason=reason, error=error)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ranking:
    """The usable candidates, best first."""

    usable: list[Scored]
    rms: Vector
    excess: Vector
    excess_std: Vector
    chosen: int
    fit: Fit
    """The chosen model."""


def _ranked(scored: list[Scored], validation: Dataset) -> _Ranking:
    usable = [j for j in scored if not j.reason]
    if not usable:
        msg = "none of the structures could be estimated"
        msg += f"; the first, {scored[0].candidate.name}: {scored[0].reason}" if scored else ""
        raise InputError(msg)
    # The same samples for all: one model's transient is not another's.
    both = np.all([np.isfinite(j.error) for j in usable], axis=0)
    if not both.any():
        raise InputError("no validation sample is predicted by all models; validate on longer data")
    squared = np.array([j.error[both] ** 2 for j in usable])
    order = np.argsort(squared.mean(axis=1), kind="stable")
    squared, usable = squared[order], [usable[i] for i in order]
    difference = squared - squared[0]
    excess_std = standard_error(np.array([batch_means(d) for d in difference]))
    rounding = _ROUNDING**2 * float(np.mean(validation.y[validation.valid] ** 2))
    excess_std = np.maximum(excess_std, rounding)
    excess = difference.mean(axis=1)
    chosen = simplest_as_good(excess, excess_std, [s.parameters for s in usable])
    return _Ranking(
        usable=[replace(j, error=_frozen(j.error)) for j in usable],
        rms=np.sqrt(squared.mean(axis=1)),
        excess=excess,
        excess_std=excess_std,
        chosen=chosen,
        fit=usable[chosen].model,
    )


def _frozen(x: Vector) -> Vector:
    x.flags.writeable = False
    return x
