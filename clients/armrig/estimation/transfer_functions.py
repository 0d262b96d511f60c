"""Estimates of transfer functions in s by prediction errors, through exact sampling."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_data
from armrig.data.dataset import Dataset, Signals
from armrig.data.finding import Finding, warning
from armrig.estimation.continuous_problem import MAX_RATE, ContinuousProblem
from armrig.estimation.continuous_starts import continuous_starts, starts_with_moved_pole
from armrig.estimation.data_faults import CONSTANT_INPUT, constant_input, require_moving_output
from armrig.estimation.orders import require_samples
from armrig.estimation.prediction_error import GroupEstimate, fit_of_one, nuisance, outputs_of
from armrig.estimation.problem import PolynomialProblem, Solution
from armrig.estimation.search import (
    Ends,
    cheapest,
    from_each,
    lowest_beside,
    rounding_floor,
    same_minimum,
)
from armrig.models.fit import Fit
from armrig.models.innovations import prepare
from armrig.models.structure import Structure
from armrig.models.transfer_function import TransferFunction
from armrig.numerics.checks import require_integers
from armrig.numerics.polynomial import Array, monic, roots
from armrig.numerics.quantities import digits

Delay = float | str | None  # seconds, or "estimate"

_MAX_POLES = 20  # the coefficients of more poles have too few digits
_LONGEST_SHARE = 0.25  # share of the record that an estimated delay may have
_MAX_LONGEST = 400  # samples
_LIMIT_SHARE = 0.9  # share of the largest rate above which a pole is at the limit
_MAX_ROUNDS = 4
_MOVED_STARTS = 8  # start values with a moved mode
_STAGES = ((10, 2), (40, 1))  # (steps of each search, number of searches that continue)
_NO_DELAY = 1e-3  # samples; a delay so near to a whole number of samples is that number
_NO_DELAY_TEXT = (
    "the best delay is 0, the end of its range, so it is fixed at 0 and has no standard deviation; "
    "leave delay out, or lower the number of poles"
)


@takes_data
def tf(
    data: Dataset | Signals,
    *,
    poles: int,
    zeros: int | None = None,
    delay: Delay = None,
    noise: tuple[int, int] = (0, 0),
    integrator: bool = False,
    offset: bool = False,
) -> Fit:
    """Estimate B and F in y(t) = B(s)/F(s) u(t - delay) + C(q)/D(q) e(t).

    The method minimises the prediction errors of the exactly sampled model. The numerator, the
    initial state and the offset are projected out. The search starts from a sampled model of the
    same order and from refined instrumental variables.

    Parameters
    ----------
    data : Dataset or Signals
        N samples of one input and one output. The input is held between samples, or a straight
        line if `Signals.intersample` is "foh". A missing y removes its own equation.
    poles : int
        Degree n of F, at least 1, including the integrator.
    zeros : int, optional
        Degree m of B, 0 to n - 1. The default is n - 1, the number of an exactly sampled model.
    delay : float or "estimate", optional
        Time from u to y in s, 0 by default. The delay may be any part of Ts. With "estimate" it is
        a parameter with a standard deviation.
    noise : (int, int), default (0, 0)
        Numbers of coefficients of C and D. (0, 0) is white noise on the output.
    integrator : bool, default False
        If True, F has the factor s. The level and the input offset of each experiment are then
        estimated.
    offset : bool, default False
        If True, the input offset of each experiment is estimated, as in `oe`.

    Returns
    -------
    Fit
        A model with Ts = 0. Its parameters are b0 …, c1 …, d1 …, f1 … and delay, each with a
        standard deviation. `quantities()` returns gain, time constants, natural frequencies,
        damping ratios and delay. `to_discrete(Ts)` samples the model.

    Raises
    ------
    ValueError
        An order is out of range, or the delay is longer than the record. There are too few samples,
        or u is constant.

    References
    ----------
    .. [1] G. P. Rao, H. Garnier, *Continuous-time system identification of a benchmark*, in
       Identification of Continuous-time Models from Sampled Data, 2008, chapter 9.
    .. [2] L. Ljung, *Experiments with identification of continuous time models*, Proc. 15th IFAC
       Symposium on System Identification, 2009.
    .. [3] G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432.

    Examples
    --------
    >>> data = armrig.example_recording().dataset("alpha")
    >>> fit = armrig.tf(data, poles=3, zeros=2)
    >>> fit.poles().values.round(1)
    array([-37.  +0.j ,  -8.1+17.1j,  -8.1-17.1j])
    """
    require_integers(poles=(poles, 1))
    zeros = poles - 1 if zeros is None else zeros
    if not isinstance(noise, Sequence) or len(noise) != 2:
        raise InputError(f"noise={noise!r} must be the numbers (nc, nd), such as (1, 1)")
    nc, nd = noise
    require_integers(zeros=(zeros, 0), nc=(nc, 0), nd=(nd, 0))
    if poles > _MAX_POLES:
        raise InputError(f"poles={poles} must be at most {_MAX_POLES}; lower poles")
    if zeros >= poles:
        raise InputError(
            f"zeros={zeros} must be less than poles={poles}: a sampled record does not show a "
            "direct path in continuous time; lower zeros or raise poles"
        )
    signals = data.signals()
    if (signals.nu, signals.ny) != (1, 1):
        raise InputError(
            f"a transfer function in s needs one input and one output, got {signals.nu} and "
            f"{signals.ny}: choose them with signals.dataset(output, input). Or estimate all by "
            "armrig.oe, and convert each channel: fit[output, input].to_continuous()"
        )
    data = signals.dataset()
    require_moving_output(data)
    if constant_input(data) and (integrator or offset or not data.u.any()):
        raise InputError(CONSTANT_INPUT)
    row = Structure(
        nb=(poles + 1,),
        nk=(1,),
        nf=(poles - integrator,),
        nc=nc,
        nd=nd,
        integrator="f" if integrator else "",
        offset=offset and not integrator,
    )
    experiments = tuple((prepare(part.u, part.y, row),) for part in data.experiments())
    delay_samples, longest = _delay(delay, data)
    problem = ContinuousProblem(
        sampled_problem=PolynomialProblem(rows=(row,), experiments=experiments),
        poles=poles,
        zeros=zeros,
        hold=signals.intersample[0],
        delay=delay_samples,
        longest=longest,
    )
    text, measured = f"poles={poles}, zeros={zeros}", int(np.isfinite(data.y).sum())
    needed = problem.size + zeros + 2 + nuisance(problem.sampled_problem)
    require_samples(text, needed=needed, got=measured)
    problem, ends = search_continuous(problem)
    theta = ends[0][1].theta
    point = problem.at(theta)
    solution = point.problem.solve(point.theta)
    if solution.rank < zeros + 1:
        raise InputError(
            f"{text}: u determines only {solution.rank} of {zeros + 1} numerator coefficients; "
            "lower zeros or excite with a richer input"
        )
    notes = _fast_poles(problem, theta, data.Ts)
    if delay_samples is None and problem.delay is not None:
        notes = (*notes, warning("no_delay", _NO_DELAY_TEXT))
    fit = _fit(data, problem, ends, solution)
    return replace(fit, findings=(*fit.findings, *notes))


_PROCESS = re.compile(r"P(?P<poles>[0-3])(?P<marks>[DZIU]*)")


@takes_data
def process(
    data: Dataset | Signals,
    form: str,
    *,
    delay: Delay = None,
    noise: tuple[int, int] = (0, 0),
    offset: bool = False,
) -> Fit:
    """Estimate a process model: gain, time constants or resonance, dead time, integrator.

    The model is a transfer function of `tf` in the terms of a plant ::

        K (1 + T_z s) / ((1 + T_1 s) (1 + T_2 s) …) exp(-delay s)

    Parameters
    ----------
    data : Dataset or Signals
        N samples of one input and one output.
    form : str
        P and the number of time constants, then letters: D a dead time, Z a zero, I an integrator,
        U a resonance with natural frequency and damping. "P1D" is one time constant with dead time.
    delay : float or "estimate", optional
        Dead time in s. By default it is estimated if the form has a D, and 0 otherwise.
    noise, offset
        As in `tf`.

    Returns
    -------
    Fit
        A model with Ts = 0; `quantities()` returns the gain, the times and the damping.

    Raises
    ------
    ValueError
        The form is unknown, or as for `tf`.

    References
    ----------
    .. [1] K. J. Åström, T. Hägglund, *Advanced PID Control*, 2006, chapter 2.

    Examples
    --------
    >>> data = armrig.example_recording().dataset("theta_1")
    >>> fit = armrig.process(data, "P1I")
    >>> print(fit.quantities())
    gain (rate)    1.86... ± 0.0014 rad/s/V
    time constant  0.083... ± 0.0011 s
    """
    match = _PROCESS.fullmatch(str(form))
    marks = match["marks"] if match else ""
    if not match or len(set(marks)) < len(marks) or ("U" in marks and match["poles"] in "01"):
        raise InputError(
            f"{form!r} is no process model: give P, the number of time constants 0 to 3, and D, Z, "
            'I or U (U needs two), such as "P1D" or "P2DU"'
        )
    integrator = "I" in marks
    poles, zeros = int(match["poles"]) + integrator, int("Z" in marks)
    if zeros >= poles:
        raise InputError(f"{form!r} needs more poles than zeros: add a time constant or an I")
    if delay is None and "D" in marks:
        delay = "estimate"
    fit = tf(
        data,
        poles=poles,
        zeros=zeros,
        delay=delay,
        noise=noise,
        integrator=integrator,
        offset=offset,
    )
    fit = replace(fit, structure="process", specification=form)
    paired = bool(np.any(np.abs(fit.poles().values.imag) > 0))
    if paired == ("U" in marks):
        return fit
    pair = "the poles are a resonant pair; name it by the letter U"
    text = pair if paired else "the poles are real: there is no resonance, so leave U out"
    return replace(fit, findings=(*fit.findings, warning("process_kind", text)))


def _delay(delay: Delay, data: Dataset) -> tuple[float | None, float]:
    """Return the delay in samples, None if it is searched, and the longest delay of a search."""
    longest = max(part.N for part in data.experiments())
    if delay == "estimate":
        return None, min(_LONGEST_SHARE * longest, _MAX_LONGEST)
    try:
        samples = np.nan if isinstance(delay, bool) else float(delay or 0.0) / data.Ts
    except (TypeError, ValueError):
        raise InputError(f'delay={delay!r} must be a number of seconds or "estimate"') from None
    if not 0 <= samples < longest:
        raise InputError(
            f"delay={delay} s must be 0 or more and shorter than the longest "
            f"experiment, {longest * data.Ts:g} s"
        )
    return samples, samples


def search_continuous(problem: ContinuousProblem) -> tuple[ContinuousProblem, Ends]:
    """Return the problem, and the minimum reached from each start value, best first.

    In a search over the delay, all delays have the pulses of the longest start delay, so that their
    costs are comparable. The last search then has the pulses of the best delay.
    """
    starts = list(continuous_starts(problem))
    if problem.delay is None:
        problem = problem.reaching(max((float(theta[-1]) for _, theta in starts), default=0.0))
        each = groupby(starts, key=lambda start: start[1][-1])
        starts = [min(group, key=lambda start: problem.cost(start[1])) for _, group in each]
    ends = from_each(problem, starts)
    for _ in range(_MAX_ROUNDS if _doubtful(problem, ends) else 0):
        best = ends[0][1]
        moved = cheapest(problem, starts_with_moved_pole(problem, best.theta), _MOVED_STARTS)
        lower = lowest_beside(problem, best, moved, _STAGES)
        if same_minimum(problem.sampled_problem, lower.cost, best.cost):
            break
        ends.insert(0, ("mode at another rate", lower))
    # A pole at the limit is a direct path. A higher minimum comes first.
    ends.sort(key=lambda end: _at_limit(problem, end[1].theta))
    if problem.delay is not None:
        return problem, ends
    name, best = ends[0]
    delay = float(best.theta[-1])
    problem, theta = problem.reaching(delay), best.theta
    if delay < _NO_DELAY:  # a parameter at its bound has no deviation
        problem, theta = replace(problem, delay=0.0), theta[:-1]
    end = problem.minimise(theta)
    # The derivative by the delay has a step at a whole number of samples, if zeros is poles - 1. A
    # minimum at such a step has no vanishing gradient.
    at_step = problem.delay is None and abs(end.theta[-1] - round(end.theta[-1])) < _NO_DELAY
    return problem, [(name, replace(end, converged=end.converged or at_step))]


def _doubtful(problem: ContinuousProblem, ends: Ends) -> bool:
    """Return whether the searches ended in different minima, or with a pole at the limit."""
    agreed = same_minimum(problem.sampled_problem, ends[0][1].cost, ends[-1][1].cost)
    return not agreed or _at_limit(problem, ends[0][1].theta)


def _fastest(problem: ContinuousProblem, theta: Array) -> float:
    """Return the largest modulus of a pole, in 1/sample."""
    return float(np.max(np.abs(roots(monic(problem.parts_of(theta)[1]))), initial=0.0))


def _at_limit(problem: ContinuousProblem, theta: Array) -> bool:
    return _fastest(problem, theta) > _LIMIT_SHARE * MAX_RATE


def _fast_poles(problem: ContinuousProblem, theta: Array, Ts: float) -> tuple[Finding, ...]:
    """Return a warning about poles that are too fast for Ts."""
    fast, nyquist = _fastest(problem, theta) / Ts, np.pi / Ts
    if fast <= nyquist:
        return ()
    is_limit = _at_limit(problem, theta)
    text = (
        f"a pole at {digits(fast, 3)} rad/s is above the Nyquist frequency, {digits(nyquist, 3)} "
        f"rad/s: the data {'do not' if is_limit else 'hardly'} determine it; sample faster or "
        "lower poles"
    )
    return (warning("fast_pole", text, "order", rate=fast),)


def _fit(data: Dataset, problem: ContinuousProblem, ends: Ends, solution: Solution) -> Fit:
    """Return the model with its covariance, tests and findings."""
    point = problem.at(ends[0][1].theta)
    floor = rounding_floor(point.problem)
    ends = [(name, replace(o, converged=o.converged or o.cost <= floor)) for name, o in ends]
    solution = replace(solution, by_theta=point.derivatives(solution))
    group = GroupEstimate(
        outputs=(0,), problem=point.problem, solution=solution, theta=point.theta, ends=ends
    )
    form, J = _form(problem, ends[0][1].theta, solution.linear, data.Ts)
    [estimate], W = outputs_of(data, [group], J)
    fit = fit_of_one(
        data,
        group,
        estimate,
        W,
        problem,
        structure="tf",
        score="exogenous" if point.problem.rows[0].white else "correlated",
        converged=ends[0][1].converged,
    )
    return replace(fit, form=form, Ts=0.0)


def _form(
    problem: ContinuousProblem, theta: Array, linear: Array, Ts: float
) -> tuple[TransferFunction, Array]:
    """Return the transfer function, and its derivatives by `linear` and theta in 1/sample."""
    noise, free_f, delay = problem.parts_of(theta)
    f = problem.with_root(free_f)
    n, m, k, nc = problem.poles, problem.zeros, problem.noise_size, problem.row.nc
    of_b, of_f = Ts ** (np.arange(m + 1.0) - n), Ts ** -np.arange(1.0, n + 1)
    form = TransferFunction(
        B=(((linear * of_b)[::-1],),),
        F=((monic(f * of_f),),),
        C=(monic(noise[:nc]),),
        D=(monic(noise[nc:]),),
        delay=delay * Ts,
        delay_estimated=problem.delay is None,
        integrators=(problem.integrates,),
        Ts=Ts,
        hold=problem.hold,
    )
    J = np.diag(
        np.concatenate([of_b, np.ones(k), of_f[: free_f.size], [Ts] * form.delay_estimated])
    )
    J[: m + 1] = J[m::-1]  # the highest power comes first
    return form, np.insert(J, m + 1 + k + n - 1, 0.0, axis=0) if problem.integrates else J
