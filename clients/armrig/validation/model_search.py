"""Search over model structures for the simplest model that is as good as the best on other data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from itertools import chain, groupby, product
from typing import Any

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from msgspec import structs
from numpy.typing import NDArray

from armrig.data.argument import as_dataset, takes_data
from armrig.data.dataset import Dataset, Signals, Vector
from armrig.data.finding import Finding, few_samples
from armrig.data.step import laws_of
from armrig.data.treatment import integrates_by_name
from armrig.data.treatment.integrating import integration
from armrig.estimation.data_faults import (
    CONSTANT_INPUT,
    level_without_input,
    require_moving_output,
    require_no_copies,
)
from armrig.estimation.orders import Integrator, integrating_outputs
from armrig.estimation.request import Request
from armrig.models.fit import Fit
from armrig.models.prediction import require_same_signals
from armrig.models.structure_table import OFFERED, OfferedName, row_of
from armrig.numerics.checks import (
    MAX_ORDER,
    require_flags,
    require_integers,
    several,
    several_of,
)
from armrig.numerics.criteria import batch_means, fpe, simplest_as_good, standard_error
from armrig.numerics.rounding import rounding_std
from armrig.validation.advice import doubts_of_channels, examine_experiment, preliminary_tests
from armrig.validation.feedback_and_delay.delay_result import Delay
from armrig.validation.feedback_and_delay.held_input import may_follow_output
from armrig.validation.feedback_and_delay.open_loop import EXACT
from armrig.validation.recommended_structures import MAX_TIME_CONSTANTS, process_forms
from armrig.validation.residuals import residuals
from armrig.validation.search_result import (
    MAX_ERROR_RATIO,
    Candidate,
    Scored,
    SearchResult,
    free_parameters,
)

_MIN_LEVEL_SIGMAS = 2.0  # distance from 0 above which the level is estimated with the model
_SURE_LEVEL_SIGMAS = 4.0  # the same for several signals: models without a level are left out
_MIN_EXCESS_SIGMAS = 2.0  # excess of the models above which a pole at 1 is decided
_SEARCHABLE = [name for name, row in OFFERED.items() if not row.continuous]
_ORDERS = range(1, 9)  # default orders
_ALWAYS_TRIED = 5  # highest default order that does not depend on the models of lower order
_NOISE_ORDERS = (1, 2)  # nc and nd that are tried in Box-Jenkins models
_SAME_LOSS = 1e-6  # share of a loss by which searches that end in the same minimum may differ
_UNBOUNDED = 1e3  # multiple of the largest |y| above which an error counts as unbounded
_MIN_RANGE_SHARE = 0.1  # least range of u in a part, as a share of the range of u in the data
_MIN_BATCHES = 7  # fewest batches for a standard error
_MAX_LOST_FIT = 0.02  # greatest excess of the choice's rms error, as a share of the std of y
_FINALISTS = 3  # candidates that are estimated again with all starts
_MIN_PART_SHARE = 0.2  # least number of samples in a part, as a share of all samples
_NO_DIRECT_TERM = (
    "nk = 0 was not tried, because a controller that computes u(t) from y(t) causes an apparent "
    "direct term; if u was not computed from y, give open_loop=True (--open-loop)"
)
_BOTH_TRIED = "y may integrate, so structures were tried with and without a pole at 1"
_Data = Dataset | Signals
_Fold = tuple[_Data, _Data]
_Ranking = tuple[list[Scored], dict[str, NDArray[Any]], int]
_Stage = tuple[list[Candidate], int, Callable[[_Ranking], list[Candidate]]]
_WORSE = "the model of all the data has larger errors than those of halves"
_OWN_DATA = (
    "u moves in one part of the data only, so Akaike's FPE ranked the models on the data that "
    "estimated them; other data for validation (--validate) decide better"
)


@takes_data
def search(
    data: Dataset | Signals,
    validation: Dataset | Signals | None = None,
    *,
    families: Sequence[OfferedName] | None = None,
    orders: Iterable[int] | None = None,
    nk: int | Iterable[int] | None = None,
    integrator: Integrator | None = None,
    offset: bool | None = None,
    horizon: int | None = None,
    open_loop: bool = False,
    executor: Executor | None = None,
    progress: Callable[[int, int, str], object] | None = None,
) -> SearchResult:
    """Estimate many models, rank them on other data, and choose the simplest of the good models.

    A candidate of order n has n poles and n numerator coefficients; "bj" has nc = nd = 1 or 2, too.
    The best candidate has the least mean squared error on the validation data. Three conditions
    make a candidate as good. Its mean of e² - e²_best is at most the standard error of this mean.
    Its rms error is at most 1.2 times the least. Its rms error is larger by at most 2 % of the
    standard deviation of y. Successive errors are correlated, so the first is the largest standard
    error of 30, 15 and 7 batch means. A simulation
    does not distinguish drift from wrong dynamics, so only candidates that also predict one step
    ahead as well as the best remain. Of these, the one with the fewest parameters is chosen.

    The choice suggests process models with fewer parameters, such as "P2D", which are then
    candidates, too. In closed loop they are not tried, since feedback biases them.

    No candidate has a pole on or outside the unit circle, except a known integrator: the estimators
    are called with `stable=True`. The findings of the chosen model report a pole that was moved.

    For several outputs, the squared error is the sum over the outputs of (y - ŷ)² / var y. An
    output with an integrator then has one pole more than n, and one more numerator coefficient for
    each input. "oe" has a shared denominator. If samples are missing, "ss" has no K.

    Parameters
    ----------
    data : Dataset or Signals
        Data to estimate from.
    validation : Dataset or Signals, optional
        Data to rank the models on; the three best whose few start values led to different minima
        are then estimated again with all. By default each half of `data` estimates models that are
        ranked on the other half, and all `data` then estimate the chosen model, with all start
        values. If its errors are then larger than those of the halves, the next choice replaces it.
        If u rests in a half, the cut is elsewhere. If no cut leaves two parts in which u moves,
        Akaike's FPE ranks the models on the data that estimated them.
    families : sequence of str, optional
        Names of structures in discrete time, such as "oe". The default is all but "ararx" and "ss";
        in closed loop those whose noise model prevents a bias by feedback. "iv4" is left out if
        feedback is found at the level 5 %, unless a direct term explains it. For several signals it
        is "ss", "n4sid" and "oe", or only "oe" with an integrator or a level.
    orders : iterable of int, optional
        Numbers of poles to try, >= 1, including the pole of an integrator, which does not count for
        several signals. The default is 1 to 5, and 6 to 8 as long as the choice is a model of the
        highest order so far.
    nk : int or iterable of int, optional
        Numbers of samples before u affects y; each number is tried. The default is the nk that
        `delay` finds, at least 1; for several signals 1. If a direct term is not ruled out, 0 is
        tried, too, but only for an input that cannot have been computed from y(t): see `open_loop`.
        A controller causes an apparent direct term.
    integrator : bool, str or sequence of str, optional
        If True, structures with this option have a pole at exactly 1. The default is True for
        theta_1; for any other output a test decides. If the test does not decide, "n4sid" is tried
        with and without a pole at 1. If neither kind is better by 2 standard errors, the other
        structures are tried with both kinds, too. For several signals: the outputs with a pole at
        1, by default theta_1 if "oe" is tried.
    offset : bool, optional
        If True, the offset of the input is estimated in structures with this option; of several
        signals only in "oe". The default is True if an output has a constant part, above 2 (of
        several signals 4) standard deviations in one of the two data sets, that u does not explain.
        Otherwise the choice is also tried with the offset. With an integrator, it is False.
    horizon : int, optional
        Samples to predict ahead, >= 1. By default the models are simulated, and "n4sid" is
        estimated with `focus="simulation"`. In closed loop the default for one input and output is
        1, because a model that is biased by feedback would have the best simulation.
    open_loop : bool, default False
        True if u(t) was not computed from y(t); without effect for a run under a control law.
        Otherwise this counts as shown only for a u that is held in two of three samples, and whose
        changes y does not explain.
    executor : concurrent.futures.Executor, optional
        Executor of the estimates, such as ``ProcessPoolExecutor``; by default the caller's thread.
    progress : callable, optional
        Called with the number of finished candidates, the number of all candidates, and the name of
        the next candidate, at the end "". A candidate that is not needed counts as finished.

    Returns
    -------
    SearchResult
        `fit` is the chosen model, and `ranked` contains the usable models. `explain()` returns the
        reasons, and `doubts` contains the findings about problems of the data.

    Raises
    ------
    ValueError
        No model could be estimated, an argument is out of range, u or y is constant, rows are
        copies of others, or u follows from y of the same sample.

    Examples
    --------
    >>> data = armrig.example_recording().dataset("alpha")
    >>> found = armrig.search(data, families=["arx", "oe"], orders=[2, 3])
    >>> found.fit.heading
    'OE(nb=3, nf=3, nk=1)'
    """
    if not (progress is None or callable(progress)):
        raise InputTypeError(f"progress={progress!r} must be a function of (done, total, name)")
    if not (executor is None or isinstance(executor, Executor)):
        raise InputTypeError(f"executor={executor!r} must be a concurrent.futures.Executor")
    if offset is not None:
        require_flags(offset=offset)
    if isinstance(data, Signals) and (data.nu, data.ny) == (1, 1):
        data = data.dataset()
    require_moving_output(data)
    rising = orders is None
    all_data, halved, orders = data, False, several("orders", _ORDERS if orders is None else orders)
    if validation is None:
        data, validation = _estimation_and_validation(data)
        halved = data is not all_data
    on_own_data = validation is all_data
    if isinstance(data, Dataset):
        validation = as_dataset(validation)
    folds = [(data, validation), *([(validation, data)] if halved else [])]
    judged = all_data if halved else validation
    candidates, horizon, against, notes = _plan_search(
        all_data,
        data,
        validation,
        families,
        orders,
        nk,
        integrator,
        offset,
        horizon,
        open_loop=open_loop,
    )
    score = partial(_score, folds=folds, horizon=horizon, on_own_data=on_own_data)
    runner = map if executor is None else executor.map
    tell = progress or (lambda done, total, name: None)
    scored: list[Scored] = []
    ranking: _Ranking | None = None
    failed: dict[Candidate, str] = {}
    stage = partial(_stage, highest=_ALWAYS_TRIED if rising else max(orders))
    groups = [[*members] for _, members in groupby(sorted(candidates, key=stage), stage)]
    open_loop = not all(OFFERED[c.request.structure].closed_loop for c in candidates)
    suggests = families is None and open_loop and isinstance(data, Dataset)
    # Candidates, the largest number of them, and the function that chooses them by the ranking.
    stages: list[_Stage] = [(group, len(group), partial(_keep_needed, group)) for group in groups]
    again = not halved and any(c.request.starts for c in candidates)
    stages += [([], _FINALISTS, _finalists)] if again else []
    stages += [([], 1, _with_level)] if offset is None else []
    stages += [([], MAX_TIME_CONSTANTS, _processes)] if suggests else []
    done, total = 0, sum(most for _, most, _ in stages)
    for group, most, of_ranking in stages:
        needed = group if ranking is None else of_ranking(ranking)
        scored = [trial for trial in scored if trial.candidate.name not in {c.name for c in needed}]
        coming = iter(runner(score, needed))
        for k, candidate in enumerate(needed, start=done):
            tell(k, total, candidate.name)
            if isinstance(trial := next(coming), str):
                failed[candidate] = trial
            else:
                scored.append(trial)
        done += most
        ranking = _rank_candidates(scored, judged) if scored else None
    tell(total, total, "")
    if ranking is None:
        first, reason = next(iter(failed.items()))
        text = f"the first, {first.name}: {reason}"
        raise InputError(f"none of the structures could be estimated; {text}")
    while True:
        ranked, columns, chosen = ranking
        best = ranked[chosen]
        fit, request = best.fit, best.candidate.request
        if halved or request.replicates is not None:
            fit = structs.replace(request, replicates=None, starts=None).estimated(all_data)
        as_good = not halved or _is_as_good(fit, best.error, all_data, horizon)
        if as_good or len(ranked) == 1:
            break
        failed[best.candidate] = _WORSE
        ranking = _rank_candidates([trial for trial in ranked if trial is not best], judged)
    ranked[chosen] = replace(best, fit=fit)
    return SearchResult(
        ranked=tuple(ranked),
        **columns,
        chosen_index=chosen,
        failed=failed,
        doubts=(*few_samples(all_data.N), *against),
        notes=(*([_OWN_DATA] if on_own_data else []), *notes, *([] if as_good else [_WORSE])),
        halved=halved,
        tests=residuals(best.fit, validation),
        horizon=horizon,
        unit="σ" if all_data.signals().ny > 1 else all_data.signals().units[0],
    )


def _plan_search(
    all_data: _Data,
    data: _Data,
    validation: _Data,
    families: Sequence[OfferedName] | None,
    orders: list[int],
    nk: int | Iterable[int] | None,
    integrator: Integrator | None,
    offset: bool | None,
    horizon: int | None,
    *,
    open_loop: bool,
) -> tuple[list[Candidate], int | None, list[Finding], list[str]]:
    """Test the data, and return the candidates, the horizon, the doubts, and the notes."""
    notes: list[str] = []
    laws = laws_of(all_data.history)
    poles: tuple[bool | tuple[str, ...], ...]
    if isinstance(data, Dataset):
        (mark,) = (None,) if integrator is None else integrating_outputs(integrator, data)
        require_no_copies(as_dataset(all_data))
        tests = preliminary_tests(data, mark, None)
        if tests.loop is not None and tests.loop.exact:
            raise InputError(EXACT)
        decided, late = tests.integration, tests.late
        likely = [max(late.nk, 1)] if isinstance(late, Delay) else [1]
        direct = isinstance(late, Delay) and late.interval[0] == 0
        open_loop = open_loop and not laws
        may_be_0 = direct and (open_loop or not (laws or may_follow_output(as_dataset(all_data))))
        likely = [0, *likely] if may_be_0 else likely
        both = integration(as_dataset(all_data), mark).undecided
        poles = (False, True) if both else (decided.integrates,)
        if families is None:
            rows = [(name, row) for name, row in OFFERED.items() if row.searched]
            feedback = tests.loop is not None and tests.loop.feedback
            biased = ["iv4"] if feedback and not (may_be_0 or open_loop) else []
            families = [
                name
                for name, row in rows
                if row.closed_loop or not (tests.closed or name in biased)
            ]
        offered = several_of("families", families, _SEARCHABLE)
        if not decided.integrates:
            offset, notes = _offset(data, validation, offset, offered)
        unbiased = laws and all(OFFERED[name].closed_loop for name in offered)
        left_out = {"level": offset, "feedback": unbiased or not tests.together}
        doubted = (f for f in examine_experiment(data, tests) if f.level != "good")
        against = [f for f in doubted if not left_out.get(f.about)]
        untried = [_NO_DIRECT_TERM] * (direct and not may_be_0 and nk is None)
        notes = [*decided.notes, *notes, *([_BOTH_TRIED] if both else []), *untried]
        horizon = 1 if horizon is None and tests.closed else horizon
    else:
        if integrator is None:
            able = families is None or "oe" in families
            integrator = [name for name in data.outputs if able and integrates_by_name(name)]
        marks = integrating_outputs(integrator, data)
        fixed = tuple(name for name, mark in zip(data.outputs, marks, strict=True) if mark)
        poles = (fixed or False,)
        likely, allowed = [1], [name for name, row in OFFERED.items() if row.searched_of_several]
        default = [name for name in allowed if OFFERED[name].closed_loop or not laws]
        offered = several_of("families", default if families is None else families, allowed)
        offset, notes = (offset, []) if poles[0] else _offset(data, validation, offset, offered)
        offered = ["oe"] if poles[0] or (offset and "oe" in offered) else offered
        unbiased = laws and all(OFFERED[name].closed_loop for name in offered)
        against = [f for f in doubts_of_channels(data) if not (unbiased and f.remedy == "noise")]
    delays = likely if nk is None else several("nk", nk) if isinstance(nk, Iterable) else [nk]
    for n in orders:
        require_integers(MAX_ORDER, orders=(n, 1))
    for k in delays:
        require_integers(nk=(k, 0))
    options = {
        "offset": bool(offset),
        "focus": "simulation" if horizon is None else None,
        "stable": True,  # unstable poles are reflected at |z| = 1
        "starts": "few",  # a model of too high order has many minima, but is not chosen
        "shared": isinstance(data, Signals) or None,
        "noise": False if all_data.missing else None,
        "replicates": 0 if all_data.signals().ny > 1 else None,  # they cost a hundred estimates
    }
    each = (_candidates(name, delays, orders, poles, options) for name in offered)
    return [*chain.from_iterable(each)], horizon, against, notes


def _candidates(
    family: OfferedName,
    delays: Sequence[int],
    orders: Sequence[int],
    poles: Sequence[bool | tuple[str, ...]],
    options: Mapping[str, Any],
) -> Iterator[Candidate]:
    """Yield the candidates of a structure, with the options that its estimator takes."""
    row = OFFERED[family]
    taken = {name: x for name, x in options.items() if name in row.takes}
    kinds = poles if "integrator" in row.takes else [False]
    noise_orders = _NOISE_ORDERS if "nd" in row.orders else [0]
    for k, n, m, pole in product(delays, orders, noise_orders, kinds):
        named = {name: m or n if name in ("nc", "nd") else n for name in row.orders}
        counted: dict[str, int | None] = {
            name: x + isinstance(pole, tuple) for name, x in named.items()
        }
        yield Candidate(
            name=row.short(named | {"nk": k}) + ", pole at 1" * (len(kinds) > 1 and bool(pole)),
            order=n,
            request=Request(structure=family, orders=counted, nk=k, integrator=pole, **taken),
            named_by_pole=len(kinds) > 1,
        )


def _offset(
    data: _Data, validation: _Data, offset: bool | None, families: Sequence[OfferedName]
) -> tuple[bool, list[str]]:
    """Decide whether the input offset is estimated; return the decision and a note."""
    able = ", ".join(name.upper() for name in families if "offset" in OFFERED[name].takes)
    remedy = f"{able} can estimate it (option offset)" if able else "remove the means (detrend)"
    least = _MIN_LEVEL_SIGMAS if isinstance(data, Dataset) else _SURE_LEVEL_SIGMAS
    # A constant level that only the validation data have would distort the ranking.
    for part, where in ((data, ""), (validation, "in the validation data ")):
        for y in part.signals().outputs if offset is not False else ():
            if level := level_without_input(part.signals().channels([y]), least):
                return True, [f"{where}{level.text}: {remedy}"]
    return bool(offset), []


def _stage(candidate: Candidate, highest: int) -> int:
    """Return the stage of a search: 0 decides on a pole at 1, 1 has the usual orders, then one."""
    if candidate.order > highest:
        return candidate.order
    return int(not (candidate.named_by_pole and row_of(candidate.request.structure).projection))


def _keep_needed(candidates: list[Candidate], ranking: _Ranking) -> list[Candidate]:
    """Return the candidates of a stage that the earlier stages do not exclude.

    If each model with a pole at 1 is worse than the best model without by more than
    `_MIN_EXCESS_SIGMAS` standard errors, or the other way round, no such model is needed. A higher
    order is needed if the choice so far has the highest order.
    """
    ranked, columns, chosen = ranking
    highest = max(s.candidate.order for s in ranked)
    if candidates[0].order > highest > ranked[chosen].candidate.order:
        return []
    best = ranked[0].candidate.request.integrator
    worse = np.array([s.candidate.request.integrator != best for s in ranked])
    if (
        worse.any()
        and (columns["excess"] > _MIN_EXCESS_SIGMAS * columns["excess_std"])[worse].all()
    ):
        return [c for c in candidates if c.request.integrator == best or not c.named_by_pole]
    return candidates


def _finalists(ranking: _Ranking) -> list[Candidate]:
    """Return the best candidates again, with all starts, if their few starts disagreed."""
    few = [
        s.candidate for s in ranking[0] if not s.fit.search.agreed and s.candidate.request.starts
    ]
    return [replace(c, request=structs.replace(c.request, starts=None)) for c in few[:_FINALISTS]]


def _with_level(ranking: _Ranking) -> list[Candidate]:
    """Return the choice so far with an offset, if it has none and its estimator takes one."""
    chosen = ranking[0][ranking[-1]].candidate
    has = chosen.request.offset or chosen.request.integrator
    if has or "offset" not in OFFERED[chosen.request.structure].takes:
        return []
    request = structs.replace(chosen.request, offset=True)
    return [replace(chosen, name=f"{chosen.name}, level", request=request, named_by_level=True)]


def _processes(ranking: _Ranking) -> list[Candidate]:
    """Return the process models that the poles and the delay of the choice so far suggest."""
    chosen = ranking[0][ranking[-1]]
    request, z = chosen.candidate.request, chosen.fit.poles().values
    integrator = bool(request.integrator)
    if integrator:
        z = np.delete(z, np.argmin(np.abs(z - 1)))
    process = Request(structure="process", orders={}, offset=request.offset and not integrator)
    return [
        Candidate(
            name=f"PROCESS({form})",
            order=n + integrator,
            request=structs.replace(process, form=form),
        )
        for n, form in process_forms(z, nk=request.nk, integrator=integrator).items()
        if 1 + n + ("D" in form) < chosen.parameters
    ]


def _score(
    candidate: Candidate, folds: list[_Fold], horizon: int | None, *, on_own_data: bool = False
) -> Scored | str:
    """Return the candidate's first model and the errors of each model, or why none is usable.

    The errors are in the order of time: those of the second model precede. The FPE scales errors on
    the model's `on_own_data` data.
    """
    fits, errors, ahead = list[Fit](), list[Vector](), list[Vector]()
    try:
        with np.errstate(all="ignore"):
            for data, other in folds:
                fit = candidate.request.estimated(data)
                require_same_signals(fit, other)
                fits.append(fit)
                errors.insert(0, other.y - fit.predict(other, horizon=horizon))
                ahead.insert(0, other.y - fit.predict(other, horizon=1))
                if reason := _fault(fit, errors[0], other):
                    return reason
    except (ValueError, np.linalg.LinAlgError) as err:
        return str(err)
    error, d = np.concatenate(errors), free_parameters(fits[0]) + candidate.named_by_level
    scale = np.sqrt(fpe(1.0, d, int(np.isfinite(error).sum()))) if on_own_data else 1.0
    return Scored(
        candidate=candidate, fit=fits[0], error=scale * error, ahead=scale * np.concatenate(ahead)
    )


def cross_validation_errors(data: Dataset, requests: Sequence[Request]) -> Vector:
    """Return the rms errors of simulations of each half by the model of the other half.

    The error is NaN for a request without a usable model, or if u rests in a half.
    """
    first, second = _estimation_and_validation(data)
    rms = np.full(len(requests), np.nan)
    if first is not data:
        folds = [(first, second), (second, first)]
        each = (Candidate(name="", order=0, request=request) for request in requests)
        scored = {
            k: s for k, c in enumerate(each) if isinstance(s := _score(c, folds, None), Scored)
        }
        if scored:
            loss, *_ = _compare_errors([s.error for s in scored.values()], data)
            rms[list(scored)] = np.sqrt(loss)
    return rms


def _fault(fit: Fit, error: Vector, data: _Data) -> str:
    """Return the reason why the model is not usable, or ""."""
    # If the error grows to the end of the data, the standard error of its mean square is as large
    # as the mean square. The ranking alone would not reject such a candidate.
    largest = np.max(np.abs(np.where(data.valid, data.y, 0.0)), axis=0)
    bound = np.where(largest > 0, _UNBOUNDED * largest, np.inf)
    if not np.isfinite(fit.theta).all() or (np.abs(error) > bound).any():
        return "its output is unbounded"
    return next((f.text for f in fit.findings if "modulus" in f.numbers), "")


def _rank_candidates(scored: list[Scored], judged: _Data) -> _Ranking:
    """Return the candidates, best first; their rms, excess and its standard error; the choice."""
    loss, excess, excess_std = _compare_errors([j.error for j in scored], judged)
    order = np.argsort(excess, kind="stable")
    ranked, rms = [scored[i] for i in order], np.sqrt(loss)
    as_good = (excess <= excess_std) & (rms - rms.min() <= _error_allowance(judged))
    # Below a ratio, since batches that differ much have a large standard error.
    as_good &= (rms <= MAX_ERROR_RATIO * rms.min()) | (excess == 0)
    columns = {"rms": rms, "excess": excess, "excess_std": excess_std, "as_good": as_good}
    within = np.flatnonzero(as_good[order])
    _, ahead, ahead_std = _compare_errors([ranked[i].ahead for i in within], judged)
    # An unproven direct term counts as half a parameter, so that nk=1 is preferred to nk=0.
    complexity = [
        ranked[i].parameters + 0.5 * (ranked[i].candidate.request.nk == 0) for i in within
    ]
    chosen = int(within[simplest_as_good(ahead, ahead_std, complexity)])
    return ranked, {name: x[order] for name, x in columns.items()}, chosen


def _error_allowance(data: _Data) -> float:
    """Return the rms error that lowers a fit by `_MAX_LOST_FIT`."""
    y = np.where(data.valid, data.y, np.nan)
    return _MAX_LOST_FIT * (float(np.nanstd(y)) if y.ndim == 1 else y.shape[1] ** 0.5)


def _is_as_good(fit: Fit, error: Vector, data: _Data, horizon: int | None) -> bool:
    """Return whether a model's errors on its own data are no larger than those of the halves."""
    own_error = data.y - fit.predict(data, horizon=horizon)
    if _fault(fit, own_error, data):
        return False
    rms = np.sqrt(_compare_errors([own_error, error], data)[0])
    return bool(rms[0] - rms[1] <= _error_allowance(data))


def _compare_errors(errors: list[Vector], judged: _Data) -> tuple[Vector, Vector, Vector]:
    """Return each model's mean squared error, its excess over the least, and the standard error."""
    y = np.where(judged.valid, judged.y, np.nan).reshape(judged.N, -1)
    std = np.nanstd(y, axis=0) if y.shape[1] > 1 else np.ones(1)
    scaled = np.array([e.reshape(y.shape) / std for e in errors])
    # All models are compared at the same samples, since their initial transients differ.
    both = np.isfinite(scaled).all(axis=0)
    if not both.any():
        raise InputError("no validation sample is predicted by all models; validate on longer data")
    squared = np.sum(np.where(both, scaled, 0.0) ** 2, axis=2)[:, both.any(axis=1)]
    difference = squared - squared[np.argmin(squared.mean(axis=1))]
    means = np.array([batch_means(d) for d in difference])
    std_of_mean = standard_error(means)
    # The batches must be longer than the correlation time of the errors, which is not known.
    while (K := means.shape[1]) >= _MIN_BATCHES * 2:
        means = means[:, : K // 2 * 2].reshape(len(means), -1, 2).mean(axis=2)
        std_of_mean = np.maximum(std_of_mean, standard_error(means))
    loss, rounding = squared.mean(axis=1), rounding_std(y / std) ** 2
    least_std = max(rounding, _SAME_LOSS * float(loss.min()))
    excess = difference.mean(axis=1)
    excess[excess <= rounding] = 0.0
    return loss, excess, np.maximum(std_of_mean, least_std)


def _estimation_and_validation(data: _Data) -> _Fold:
    """Return two parts in which each input moves, cut near the middle; if impossible, all twice."""
    u = data.u.reshape(data.N, -1)
    if not np.ptp(u):
        raise InputError(CONSTANT_INPUT)
    least = _MIN_RANGE_SHARE * np.ptp(u, axis=0)
    before, after = (
        np.maximum.accumulate(x) - np.minimum.accumulate(x) >= least for x in (u, u[::-1])
    )
    cuts = 1 + np.flatnonzero(np.all(before[:-1] & after[::-1][1:], axis=1))
    middle = round(data.N / 2)
    cut = int(cuts[np.argmin(np.abs(cuts - middle))]) if cuts.size else 0
    if not _MIN_PART_SHARE <= cut / data.N <= 1 - _MIN_PART_SHARE:
        return data, data
    return data[:cut], data[cut:]
