"""Recommended structures, with reasons from description lengths and spectra (handout, 3.2)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset, Signals, Vector
from armrig.data.finding import Finding, good, warning
from armrig.estimation.data_faults import require_moving_output, require_no_copies
from armrig.estimation.nonparametric.impulse import ImpulseResponse, long_enough
from armrig.estimation.nonparametric.spectra import coherent_range
from armrig.estimation.nonparametric.spectral import spa
from armrig.estimation.request import Request
from armrig.excitation.input_description import excitation_order
from armrig.models.spectral_estimate import (
    SpectralEstimate,
    high_band,
    high_slope,
    log_slope,
    low_slope,
)
from armrig.numerics.quantities import digits, join_names, minus, plural
from armrig.plots.layout import plot_method
from armrig.validation.advice import about_feedback, poor_input, preliminary_tests, without_others
from armrig.validation.feedback_and_delay.by_channel import Name, each_channel
from armrig.validation.feedback_and_delay.delay import is_narrow
from armrig.validation.feedback_and_delay.delay_result import Delay, first_lag
from armrig.validation.feedback_and_delay.open_loop import EXACT
from armrig.validation.model_search import cross_validation_errors
from armrig.validation.recommended_structures import (
    BARE,
    RECOMMENDED,
    OutputErrorFit,
    Recommended,
    busiest,
    process_forms,
    recommend,
)

MAX_RATIO = 1.05  # of the rms error of the first structure on data held out to the least
PROMINENT_DB = 2.0  # least height of a resonance over its surroundings
LAGS = (100, 200, 400)  # numbers of lags of the impulse response, tried until one is large enough
AGREED_SLOPE = 3.0  # largest difference from the slope of the first structure, in dB a decade
_ROUNDING = 1e-9  # 1/sample; a slower pole counts as a pole at 1
_NARROW = "u determines few lags, so that orders and delay may be poorly determined"
_LEAST_DECAYS = 5  # time constants of a record in which the slowest pole is none at 1
_ZERO_DB = 3.0  # least change of |G| by a zero, up to the fastest pole
FLAT_SLOPE = 5.0  # largest slope of a gain that counts as constant, in dB a decade


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class StructureHints:
    """Recommended structures, and the nonparametric estimates that are the reasons for them."""

    doubts: tuple[Finding, ...]
    """Feedback with p < 0.1 %."""
    narrow: bool
    """True if the band of u is too narrow to determine the orders and the delay."""
    structures: tuple[Recommended, ...]
    """At most three structures, best first."""
    integrator: bool
    """True if y integrates: the first structure has a pole at 1."""
    integrator_shown: bool
    """True if the data decide whether y integrates. Otherwise `structures` has both kinds."""
    low_slope: float | None
    """Slope of |G| at low frequency, in dB a decade: 0 for a gain, -20 for an integrator. None if
    the slope of the first structure differs by more than 3 dB a decade."""
    process: str
    """Form of `process` with the poles of the first structure, or "" if a zero is needed."""
    high_slope: float | None
    """Slope of |G| in dB a decade over `high_band`; None as for `low_slope`."""
    high_band: Vector
    """Highest frequencies at which u explains y (coherence above one half), in rad/s. They span a
    third of a decade. Near the Nyquist frequency, sampling hides the slope."""
    relative_degree: int
    """Number of poles minus number of zeros: each such pole changes `high_slope` by -20 dB a
    decade. 0 if ``|G|`` does not fall, or if no slope can be estimated."""
    resonances: tuple[float, ...]
    """Frequencies in rad/s of the peaks of |G| of the first structure, at least 2 dB high, where u
    explains y. If y integrates, |G| is the response of the rate of y."""
    antiresonances: tuple[float, ...]
    """Frequencies in rad/s of the dips of this |G|."""
    nk_interval: tuple[int, int] | None
    """Least and greatest nk that `armrig.delay` allows; None if it failed, or excludes `nk`."""
    excess: Mapping[int, float]
    """Description length above the shortest, by the number of poles; a difference of less than 2
    hardly counts."""
    excitation: int
    """Order of persistence of excitation of u; at least nb + nf if u determines the parameters."""
    trusted: float
    """Highest frequency at which u explains y, in rad/s; 0 if there are fewer than three."""
    spectrum: SpectralEstimate
    """Estimated frequency response from u to y."""
    response: ImpulseResponse
    """Regularised impulse response."""
    unstable: bool = False
    """True if y grows without u: a pole is outside the unit circle."""
    others: tuple[str, ...] = ()
    """Other inputs, without which an output that settles would seem to integrate."""

    @property
    def family(self) -> str:
        """Name of the first structure.

        It is "bj" with feedback, which biases "oe", and "armax" for a pole outside the unit circle,
        which neither of them has.
        """
        if self.unstable:
            return "armax"
        return "bj" if self.doubts else "oe"

    @property
    def nb(self) -> int:
        """Number of b's of the first structure."""
        return self.structures[0].nb

    @property
    def nf(self) -> int:
        """Number of poles of the first structure, including the pole of an integrator."""
        return self.structures[0].nf

    @property
    def nk(self) -> int:
        """Number of samples before u affects y in the first structure."""
        return self.structures[0].nk

    plot = plot_method("plot_structure", "|G| with slopes and extremes")

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about feedback, excitation, integrator, shape, order, roll-off and delay."""
        return tuple(_findings(self))

    @property
    def reasons(self) -> tuple[str, ...]:
        """Texts of the findings, and the further structures."""
        others = ", ".join(_call_text(self.family, s) for s in self.structures[1:])
        more = [f"try also: {others}"] if others else []
        if self.process:
            more.append(f"in s: {_process_told(self.process)}")
        return (*(f"{f.about}: {f.text}" for f in self.findings), *more)

    def explain(self) -> str:
        """Return the reasons as text, one line for each reason."""
        return "\n".join(f"- {line}" for line in self.reasons)

    def __repr__(self) -> str:
        """Return the first structure and the reasons."""
        lines = [
            f"structure hints: begin with {_call_text(self.family, self.structures[0])}",
            *self.reasons,
        ]
        return "\n  ".join(lines)


@each_channel(
    lambda data, y, u: (data.dataset(y, u), {"whole": data.channels([y])}),
    lambda found: f"all channels: {call_of_all(found)}",
)
@takes_recordings
def structure_hints(
    data: Dataset, *, integrator: bool | None = None, whole: Signals | None = None
) -> StructureHints:
    """Recommend at most three structures, with the reasons for them.

    The structures are the output-error structures with the shortest description lengths, after a
    filter has whitened the noise (`recommend`). The first has the fewest poles with which the
    error of a simulation of data held out is at most 1.05 times the least of those tried. With
    feedback, Box-Jenkins structures with the same orders take their place. If the data show whether
    y integrates, one of the structures has nb = nf, like a plant under a zero-order hold. The
    fields of `StructureHints` are the reasons; slopes of nonparametric estimates are reported if
    the first structure agrees.

    The output theta_1 is taken as integrating. For any other output the test of `delay` and
    `search` decides (`armrig.data.treatment.integrating`). If the test does not distinguish an
    integrator from a slow pole, the description lengths decide. If these hardly differ, structures
    with and without an integrator are recommended.

    Parameters
    ----------
    data : Dataset or Signals
        Data with an exciting input; missing samples and several experiments are allowed. For
        Signals with several channels, each pair of an output and an input is examined separately;
        the other inputs are part of the noise.
    integrator : bool, optional
        True if y integrates; by default the data decide.
    whole : Signals, optional
        The output with all inputs that move it, for the test for an integrator; by default `data`.

    Returns
    -------
    StructureHints
        Orders and estimates; its repr and explain() give the reasons. For Signals with several
        channels, the result is `ByChannel`: `found["y", "u"]` are the hints of one channel. The
        last line of its repr is one call of `oe` for all channels.

    Raises
    ------
    ValueError
        There are too few samples, y is constant, rows are copies of others, or u follows from y of
        the same sample. The error is also raised if `delay` raises one and u explains y at few
        frequencies.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 16.2 and 16.3.

    Examples
    --------
    >>> hints = armrig.structure_hints(armrig.example_recording().dataset("theta_1")[:400])
    >>> hints.structures[0]
    Recommended(nb=4, nf=4, nk=1, integrator=True)
    >>> hints.relative_degree, hints.nk_interval
    (2, (1, 1))
    """
    require_moving_output(data)
    require_no_copies(data)
    tests = preliminary_tests(data, integrator, whole)
    if tests.loop is not None and tests.loop.exact:
        raise InputError(EXACT)
    decided, late = tests.integration, tests.late if isinstance(tests.late, Delay) else None
    integrates = decided.integrates and not decided.rejected
    rate = spa(data, "log", integrator=True).rate()
    slope, low = low_slope(rate, _usable_frequencies(rate, needed=late is None))
    lags = [1] if late is None else [late.nk, late.interval[1], 1]
    models, is_clear, tried = recommend(data, lags, integrates=integrates, decide=decided.undecided)
    if not tests.together:  # feedback biases a simulation
        models = _smallest_first(data, models, tried)
    best, first = models[0], models[0].structure
    integrates, nk = first.integrator, first.nk
    spectrum = spa(data, "log", delay=max(nk - 1, 0), integrator=integrates)
    believed = _usable_frequencies(spectrum, needed=late is None)
    response = long_enough(data, LAGS, integrator=integrates)
    peaks, dips = _extremes(best, spectrum.omega[believed], data.Ts)
    high = spectrum.omega[high_band(spectrum, believed)]
    fall = high_slope(spectrum, believed)
    seen = late is not None and late.interval[0] <= nk <= late.interval[1]
    narrow = is_narrow(data)
    return StructureHints(
        doubts=tuple(about_feedback(tests)) if tests.together else (),
        narrow=narrow,
        structures=tuple(model.structure for model in models),
        integrator=integrates,
        integrator_shown=is_clear
        and (integrates or (_slowest(best) < data.N / _LEAST_DECAYS and not narrow)),
        low_slope=_confirm_slope(slope - 20, best, low, data.Ts),
        process="" if dips or narrow else _process(best, data.Ts),
        high_slope=_confirm_slope(fall, best, high, data.Ts),
        high_band=high,
        relative_degree=max(0, round(-fall / 20)) if high.size else 0,
        resonances=peaks,
        antiresonances=dips,
        nk_interval=late.interval if late is not None and seen else None,
        excess=_excess(tried),
        excitation=excitation_order(data),
        trusted=float(np.max(spectrum.omega[believed], initial=0.0)),
        spectrum=spectrum,
        response=response,
        unstable=decided.unstable,
        others=decided.others,
    )


def _smallest_first(
    data: Dataset, models: Sequence[OutputErrorFit], tried: Sequence[OutputErrorFit]
) -> list[OutputErrorFit]:
    """Return the models, with the smallest first that is nearly the best on data held out."""
    first = models[0].structure
    models_by_structure = {
        m.structure: m for m in (*tried, *models) if m.structure.integrator == first.integrator
    }
    requests = [
        Request(
            structure="oe",
            orders={"nb": s.nb, "nf": s.nf},
            nk=s.nk,
            integrator=s.integrator,
            offset=not s.integrator,
            stable=True,
            starts="few",
        )
        for s in models_by_structure
    ]
    rms = cross_validation_errors(busiest(data), requests)
    if np.isnan(rms).all():
        return [*models]
    most, parameters = MAX_RATIO * np.nanmin(rms), first.nb + first.nf
    near = [
        m
        for (s, m), e in zip(models_by_structure.items(), rms, strict=True)
        if e <= most and s.nf < first.nf and s.nb + s.nf <= parameters
    ]
    if not near:  # the description length decides on structures with as many poles
        return [*models]
    smallest = min(near, key=lambda m: (m.structure.nf, m.bits))
    return [*dict.fromkeys([smallest, *models])][:RECOMMENDED]


def _excess(tried: Sequence[OutputErrorFit]) -> dict[int, float]:
    """Return the description length of each number of poles above the shortest."""
    least = min(m.bits for m in tried)
    return {m.structure.nf: m.bits - least for m in tried}


def _usable_frequencies(estimate: SpectralEstimate, *, needed: bool) -> NDArray[np.int_]:
    """Return the indices of the frequencies at which u explains y; if too few, none or an error."""
    errors = () if needed else (ValueError,)
    with suppress(*errors):
        return coherent_range(estimate)
    return np.zeros(0, dtype=np.int_)


def _confirm_slope(slope: float, best: OutputErrorFit, omega: Vector, Ts: float) -> float | None:
    """Return `slope` if the slope of the first structure at `omega` is nearly equal, else None."""
    other = log_slope(omega, np.abs(best.G(omega, Ts)))
    return slope if abs(slope - other) <= AGREED_SLOPE else None


def _process(best: OutputErrorFit, Ts: float) -> str:
    """Return the form of `process` with the poles of a model; "" if no form has its response."""
    s, poles = best.structure, np.roots(np.append(1.0, best.f)).astype(np.complex128)
    with np.errstate(divide="ignore"):
        slowest = float(np.min(np.abs(np.log(poles)), initial=np.inf))
    if not _ROUNDING <= slowest < np.inf:  # a pole at 1 may be a slow one; 0 is none of a process
        return ""
    omega = slowest / Ts * np.geomspace(0.03, 0.1, 5)  # the gain is constant a decade below
    if abs(log_slope(omega, np.abs(best.G(omega, Ts))) + 20 * s.integrator) >= FLAT_SLOPE:
        return ""
    form = process_forms(poles, nk=s.nk, integrator=s.integrator).get(poles.size, "")
    needs_zero = bool(form) and _zero_db(best, poles, omega[0], Ts) > _ZERO_DB
    if needs_zero and poles.size + s.integrator < 2:
        return ""
    return f"{form[:2]}{'Z' * needs_zero}{form[2:]}"


def _zero_db(best: OutputErrorFit, poles: NDArray[np.complex128], low: float, Ts: float) -> float:
    """Return how far |G|, up to its fastest pole, is from that of the poles alone, in dB."""
    s = np.log(poles[poles != 0]) / Ts
    omega = np.geomspace(low, max(min(np.abs(s).max(), 0.5 * np.pi / Ts), 2 * low), 60)
    shape = np.abs(best.G(omega, Ts)) * omega**best.structure.integrator
    shape *= np.prod(np.abs(1j * omega[:, None] - s), axis=1)
    return float(np.ptp(20 * np.log10(shape)))


def _slowest(best: OutputErrorFit) -> float:
    """Return the longest time constant of a model in samples; inf with a pole at 1 or beyond."""
    sizes = np.abs(np.roots(np.append(1.0, best.f)))
    with np.errstate(divide="ignore"):
        return float(np.max(-1 / np.log(sizes), initial=0.0)) if np.all(sizes < 1) else np.inf


def _extremes(best: OutputErrorFit, omega: Vector, Ts: float) -> list[tuple[float, ...]]:
    """Return the frequencies of peaks and of dips of |G|, of the rate if y integrates."""
    from scipy.signal import find_peaks

    if not omega.size:
        return [(), ()]
    w = np.geomspace(omega[0], omega[-1], 300)
    G = best.G(w, Ts) * (1 - np.exp(-1j * w * Ts)) ** best.structure.integrator
    level = 20 * np.log10(np.abs(G))
    indices = (find_peaks(x, prominence=PROMINENT_DB)[0] for x in (level, -level))
    return [tuple(map(float, w[at])) for at in indices]


def _extremes_told(omega: tuple[float, ...], name: str, wants: str) -> str:
    """Return the resonances or antiresonances, with the poles or zeros that they need."""
    several, each = ("s", " each") if len(omega) > 1 else ("", "")
    at = f"{several} at {', '.join(digits(w, 3) for w in omega)} rad/s (two {wants}{each})"
    return f"{name}{at}" if omega else f"no {name}"


def _process_told(form: str) -> str:
    """Return the name of a process model and the call that estimates it."""
    parts = {"Z": "a zero", "D": "dead time", "I": "an integrator", "U": "a resonance"}
    has = [name for letter, name in parts.items() if letter in form]
    more = f" with {join_names(has)}" if has else ""
    ordinal = ("first", "second", "third")[int(form[1]) - 1]
    return f'a {ordinal}-order process{more}: process(data, "{form}")'


def _call_text(family: str, s: Recommended) -> str:
    if family == "armax":
        return f"armax(data, na={s.nf}, nb={s.nb}, nc={s.nf}, nk={s.nk})"
    noise = "nc=1, nd=1, " * (family == "bj")
    return f"{family}(data, nb={s.nb}, {noise}nf={s.nf}, nk={s.nk}, integrator={s.integrator})"


def call_of_all(hints: Mapping[Name, StructureHints]) -> str:
    """Return one call of `oe` for all channels, with the orders of each output and input.

    An output integrates if one of its channels integrates. The other channels of this output then
    have a root at 1 in B, too.
    """
    integrating = tuple(dict.fromkeys(output for (output, _), h in hints.items() if h.integrator))
    nu = len({input for _, input in hints})
    more = [name[0] in integrating and not h.integrator for name, h in hints.items()]
    arguments = ""
    for order, root in (("nb", more), ("nf", more), ("nk", [False] * len(more))):
        n = [getattr(h, order) + extra for h, extra in zip(hints.values(), root, strict=True)]
        rows = [n[i : i + nu] for i in range(0, len(n), nu)]
        arguments += f"{order}={n[0] if len(set(n)) == 1 else rows}, "
    return f"oe(data, {arguments}integrator={integrating or False})"


def _findings(h: StructureHints) -> Iterator[Finding]:
    yield from h.doubts
    if h.narrow:
        yield warning("excitation", _NARROW)
    if h.excitation < (needed := h.nb + h.nf):
        many = f"this structure has {plural(needed, 'parameter')}"
        yield warning("excitation", poor_input(h.excitation, many))
    yield _about_integrator(h)
    if h.resonances or h.antiresonances:
        peaks = _extremes_told(h.resonances, "resonance", "poles")
        dips = _extremes_told(h.antiresonances, "antiresonance", "zeros")
        yield good(f"shape of {'the rate' if h.integrator else 'y'}", f"{peaks}, {dips}")
    least = min(h.excess, key=h.excess.__getitem__)
    near = [f"nf = {n} by {d:.1f}" for n, d in h.excess.items() if abs(n - least) == 1]
    more = f"; it is longer with {join_names(near)} (below {BARE:g} hardly counts)" if near else ""
    text = f"nf = {least} has the shortest description (MDL){more}"
    if h.nf != least:
        text += f"; nf = {h.nf} is the smallest whose error on data held out is within "
        text += f"{MAX_RATIO:g} of the least"
    yield good("order", f"perhaps {text}" if h.narrow else text)
    if h.high_slope is not None and not h.narrow:
        excess = plural(h.relative_degree, "more pole") if h.relative_degree else "no more poles"
        text = f"{minus(f'{h.high_slope:.0f}')} dB a decade from {digits(h.high_band[0], 3)} to "
        text += f"{digits(h.high_band[-1], 3)} rad/s: {excess} than zeros up to these frequencies"
        yield good("roll-off", text)
    why_not = "not shown (armrig.delay, `armrig check` say why)"
    yield good("delay", first_lag(h.nk_interval, h.spectrum.Ts) if h.nk_interval else why_not)


def _about_integrator(h: StructureHints) -> Finding:
    verdict = "y integrates: fix a pole at 1" if h.integrator else "none is seen"
    if not h.integrator_shown:
        verdict = "not shown, because a slow pole looks the same: try both"
    others = without_others(h.others)
    if h.low_slope is None:
        return good("integrator", f"{verdict}{others}")
    if h.integrator_shown and not h.integrator and h.low_slope < -10:
        verdict = "a slow pole, since a pole at 1 fits worse"
    text = f"|G| has a slope of {minus(digits(h.low_slope, 3))} dB a decade at low frequency "
    return good("integrator", f"{text}(0 without one, −20 with one): {verdict}{others}")
