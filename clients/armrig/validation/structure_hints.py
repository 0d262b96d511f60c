"""Recommended structures, with reasons from spectrum, singular values and delay (handout, 3.2)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset, Vector
from armrig.data.finding import Finding, good, warning
from armrig.data.treatment.integrating import integration
from armrig.estimation.nonparametric.impulse import ImpulseResponse, long_enough, with_covariance
from armrig.estimation.nonparametric.spectra import explained
from armrig.estimation.nonparametric.spectral import spa
from armrig.excitation.input_description import excitation_order
from armrig.models.spectral_estimate import (
    SpectralEstimate,
    high_band,
    high_slope,
    log_slope,
    low_slope,
)
from armrig.numerics.quantities import listed, minus, plural
from armrig.plots.layout import drawn_by
from armrig.validation.data_advice import poor_input
from armrig.validation.feedback_and_delay.by_channel import Name, each_channel
from armrig.validation.feedback_and_delay.delay import delay
from armrig.validation.feedback_and_delay.delay_result import Delay, first_lag
from armrig.validation.recommended_structures import Fitted, Recommended, recommended

PROMINENT_DB = 2.0  # least height of a resonance over its surroundings
SURE = 3.0  # standard deviations by which |G| at an extreme must differ from |G| at its bases
DRAWS = 200  # random draws of the error of the impulse response
LAGS = (100, 200, 400)  # numbers of lags of the impulse response, tried until one is large enough
AGREED_SLOPE = 3.0  # largest difference from the slope of the first structure, in dB a decade
_ROUNDING = 1e-9  # 1/sample; a slower pole counts as a pole at 1
FLAT_SLOPE = 5.0  # largest slope of a gain that counts as constant, in dB a decade
_ORDINALS = {1: "first", 2: "second", 3: "third"}
AGREED_PEAK = 0.12  # largest relative difference from an extreme of the first structure


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class StructureHints:
    """Recommended structures, and the nonparametric estimates that are the reasons for them."""

    structures: tuple[Recommended, ...]
    """At most three structures, best first."""
    integrator: bool
    """True if y integrates: the first structure has a pole at 1."""
    integrator_shown: bool
    """True if the data decide whether y integrates. Otherwise `structures` includes a structure
    with and a structure without an integrator."""
    low_slope: float | None
    """Slope of |G| at low frequency, in dB a decade: 0 for a gain, -20 for an integrator. None if
    the slope of the first structure differs by more than 3 dB a decade."""
    flat: bool
    """True if the gain of the first structure is constant below its slowest pole. If y integrates,
    the gain is that of the rate of y."""
    high_slope: float | None
    """Slope of |G| in dB a decade at the highest frequencies at which u explains y; they span a
    third of a decade. None if the slope of the first structure differs by more than 3 dB a
    decade."""
    high_band: Vector
    """Frequencies at which `high_slope` was estimated, in rad/s."""
    relative_degree: int
    """Number of poles minus number of zeros, from the slope at high frequency; 0 if ``|G|`` does
    not fall, or if no slope can be estimated."""
    resonances: tuple[float, ...]
    """Frequencies in rad/s of the peaks of |G| that the first structure also has. If y integrates,
    |G| is the response of the rate of y."""
    antiresonances: tuple[float, ...]
    """Frequencies in rad/s of the dips of |G| that the first structure also has."""
    nk_interval: tuple[int, int] | None
    """Least and greatest nk that the test `armrig.delay` does not rule out. None if this test
    raised an error, or if this range does not contain `nk`."""
    singular_values: Vector
    """Singular values of the Hankel matrix of the impulse response (of the rate of y if y
    integrates), divided by the largest singular value."""
    threshold: float
    """95 % quantile of the largest singular value that the error of the impulse response alone
    causes. The quantile is divided by the largest singular value of the response."""
    order: int
    """Number of `singular_values` above `threshold`, plus 1 if the data show an integrator; at most
    nf."""
    excitation: int
    """Order of persistence of excitation of u; at least nb + nf if u determines the parameters."""
    trusted: float
    """Highest frequency at which u explains y, in rad/s; 0 if u explains y at fewer than three
    frequencies."""
    spectrum: SpectralEstimate
    """Estimated frequency response from u to y."""
    response: ImpulseResponse
    """Regularised impulse response."""

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

    @property
    def process(self) -> str:
        """Form of `process` with the poles of the first structure, or "" if a zero is needed."""
        n, needs_zero = self.nf - self.integrator, self.antiresonances or not self.flat
        if n not in _ORDINALS or needs_zero or (n == 1 and self.resonances):
            return ""
        letters = {"D": self.nk > 1, "I": self.integrator, "U": bool(self.resonances)}
        return f"P{n}{''.join(letter for letter, has in letters.items() if has)}"

    plot = drawn_by("plot_structure", "|G| with slopes and extremes")

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about excitation, integrator, shape, order, roll-off and delay."""
        return tuple(_findings(self))

    @property
    def reasons(self) -> tuple[str, ...]:
        """Texts of the findings, and the further structures."""
        others = ", ".join(_named(s) for s in self.structures[1:])
        more = [f"try also: {others}"] if others else []
        if self.process:
            more.append(f"in s: {_process_told(self.process)}")
        return (*(f"{f.about}: {f.text}" for f in self.findings), *more)

    def explain(self) -> str:
        """Return the reasons as text, one line for each reason."""
        return "\n".join(f"- {line}" for line in self.reasons)

    def __repr__(self) -> str:
        """Return the first structure and the reasons."""
        lines = [f"structure hints: begin with {_named(self.structures[0])}", *self.reasons]
        return "\n  ".join(lines)


@each_channel(together=lambda found: f"all channels: {call_of_all(found)}")
@takes_recordings
def structure_hints(
    data: Dataset,
    *,
    integrator: bool | None = None,
) -> StructureHints:
    """Recommend at most three structures, with the reasons for them.

    The structures are the output-error structures with the shortest description lengths, after a
    filter has whitened the noise (`recommended`). If the data show whether y integrates, one of the
    structures has nb = nf, like a plant under a zero-order hold. Nonparametric estimates give the
    following reasons, which are reported if the first structure agrees:

    - Integrator: the test of `delay` and `search` (`armrig.data.treatment.integrating`). If the
      data do not distinguish an integrator from a slow pole, the description lengths decide; if
      these hardly differ, structures with and without an integrator are recommended. The output
      theta_1 is taken as integrating. With an integrator the slope of the gain at low frequency is
      -20 dB a decade.
    - Order: the number of singular values of the impulse response's Hankel matrix that exceed
      `threshold`, which follows from the uncertainty of this response.
    - Number of poles minus number of zeros: the slope at the highest frequencies at which u
      explains y (coherence above one half). Each pole in excess of the zeros changes the slope by
      -20 dB a decade. Sampling hides the slope near the Nyquist frequency.
    - Delay: the result of `delay`.

    Parameters
    ----------
    data : Dataset or Signals
        Data with an exciting input; missing samples and several experiments are allowed. For
        Signals with several channels, each pair of an output and an input is examined separately;
        the other inputs are part of the noise.
    integrator : bool, optional
        True if y integrates; by default the data decide.

    Returns
    -------
    StructureHints
        Orders and estimates; its repr and explain() give the reasons. For Signals with several
        channels, the result is `ByChannel`: `found["y", "u"]` are the hints of one channel. The
        last line of its repr is one call of `oe` for all channels.

    Raises
    ------
    ValueError
        There are too few samples, or both of two conditions hold: u explains y at too few
        frequencies, and `delay` raises an error.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 16.2 and 16.3.
    .. [2] S. Y. Kung, Proc. 12th Asilomar Conf., 1978, 705-714 (Hankel singular values).

    Examples
    --------
    >>> import armrig
    >>> hints = armrig.structure_hints(armrig.example_recording().dataset("theta_1")[:400])
    >>> hints.structures[0]
    Recommended(nb=4, nf=4, nk=1, integrator=True)
    >>> hints.relative_degree, hints.nk_interval
    (2, (1, 1))
    """
    decided = integration(data, integrator)
    integrates = decided.integrates and not decided.rejected
    late: Delay | None = None
    with suppress(ValueError):
        late = delay(data, integrator=integrates)
    rate = spa(data, "log", integrator=True).rate()
    slope, low = low_slope(rate, _believed(rate, needed=late is None))
    lags = [1] if late is None else [late.nk, late.interval[1], 1]
    models, shown = recommended(data, lags, integrates=integrates, decide=decided.undecided)
    best, first = models[0], models[0].structure
    integrates, nk = first.integrator, first.nk
    spectrum = spa(data, "log", delay=max(nk - 1, 0), integrator=integrates)
    believed = _believed(spectrum, needed=late is None)
    response = long_enough(data, LAGS, integrator=integrates)
    peaks, dips = _extremes(response, spectrum.omega[believed])
    values, threshold = _hankel(response, max(nk, 1))
    order = int(np.count_nonzero(values > threshold)) + (integrates and shown)
    high = spectrum.omega[high_band(spectrum, believed)]
    fall = high_slope(spectrum, believed)
    seen = late is not None and late.interval[0] <= nk <= late.interval[1]
    return StructureHints(
        structures=tuple(model.structure for model in models),
        integrator=integrates,
        integrator_shown=shown,
        low_slope=_agreed(slope - 20, best, low, data.Ts),
        flat=_is_flat(best, data.Ts),
        high_slope=_agreed(fall, best, high, data.Ts),
        high_band=high,
        relative_degree=max(0, round(-fall / 20)) if high.size else 0,
        resonances=_confirmed(peaks, best, data.Ts, dips=False),
        antiresonances=_confirmed(dips, best, data.Ts, dips=True),
        nk_interval=late.interval if late is not None and seen else None,
        singular_values=values,
        threshold=threshold,
        order=min(order, first.nf),
        excitation=excitation_order(data),
        trusted=float(np.max(spectrum.omega[believed], initial=0.0)),
        spectrum=spectrum,
        response=response,
    )


def _believed(estimate: SpectralEstimate, *, needed: bool) -> NDArray[np.int_]:
    """Return the indices of the frequencies at which u explains y; if too few, none or an error."""
    try:
        return explained(estimate)
    except ValueError:
        if needed:
            raise
        return np.zeros(0, dtype=np.int_)


def _agreed(slope: float, best: Fitted, omega: Vector, Ts: float) -> float | None:
    """Return `slope` if the slope of the first structure at `omega` is nearly equal, else None."""
    other = log_slope(omega, np.abs(best.G(omega, Ts)))
    return slope if abs(slope - other) <= AGREED_SLOPE else None


def _is_flat(best: Fitted, Ts: float) -> bool:
    """Return whether the gain of the first structure is constant a decade below its poles."""
    integrator = best.structure.integrator
    with np.errstate(divide="ignore"):
        rates = np.sort(np.abs(np.log(np.roots(best.F).astype(np.complex128))))[int(integrator) :]
    if not rates.size or rates[0] < _ROUNDING:  # a pole at 1 that may be a slow one
        return not rates.size
    omega = rates[0] / Ts * np.geomspace(0.03, 0.1, 5)
    return abs(log_slope(omega, np.abs(best.G(omega, Ts))) + 20 * integrator) < FLAT_SLOPE


def _confirmed(
    found: tuple[float, ...], best: Fitted, Ts: float, *, dips: bool
) -> tuple[float, ...]:
    """Return the extremes near which the first structure has complex roots or an extreme."""
    roots = np.roots(np.trim_zeros(best.B, "f")) if dips else np.roots(best.F)
    at = np.abs(np.log(roots[np.imag(roots) > 0])) / Ts

    def extreme(w: float) -> bool:
        near = w * np.linspace(1 - AGREED_PEAK, 1 + AGREED_PEAK, 50)
        G = np.abs(best.G(near, Ts))
        if best.structure.integrator:
            G *= np.abs(1 - np.exp(-1j * near * Ts))
        return 0 < int(np.argmin(G) if dips else np.argmax(G)) < near.size - 1

    return tuple(w for w in found if np.any(np.abs(at / w - 1) <= AGREED_PEAK) or extreme(w))


def _extremes(
    response: ImpulseResponse, believed: Vector
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the frequencies of significant peaks and dips of the response's transform."""
    from scipy.signal import find_peaks

    if not believed.size:
        return (), ()
    omega = np.geomspace(believed[0], believed[-1], 300)
    g, covariance = with_covariance(response)
    turn = np.exp(-1j * np.outer(omega, response.lags) * response.Ts)
    G = turn @ g
    # d|G| = along @ dg
    along = np.real(turn * np.exp(-1j * np.angle(G))[:, None])
    magnitude = np.abs(G)
    resolved = 2 * np.pi / (g.size * response.Ts)

    def sure(at: int, foot: int) -> bool:
        d = along[at] - along[foot]
        std = np.sqrt(max(float(d @ covariance @ d), 0.0))
        return bool(abs(magnitude[at] - magnitude[foot]) > SURE * std)

    found = []
    for x in (magnitude, 1 / magnitude):
        at, of = find_peaks(20 * np.log10(x), prominence=PROMINENT_DB)
        feet = zip(at, of["left_bases"], of["right_bases"], strict=True)
        found.append(
            tuple(
                float(omega[i])
                for i, left, right in feet
                if omega[right] - omega[left] > resolved and sure(i, left) and sure(i, right)
            )
        )
    return found[0], found[1]


def _hankel(response: ImpulseResponse, nk: int) -> tuple[Vector, float]:
    """Return the Hankel singular values from lag nk on, and their threshold, over the largest."""
    g, covariance = with_covariance(response)
    # The backward difference that yields the rate adds a pole at 0, which affects g(nk) alone.
    h = g[nk + 1 :] if response.integrator else g[nk:]
    m = (h.size + 1) // 2
    index = np.add.outer(np.arange(m), np.arange(h.size - m + 1))
    values = np.linalg.svd(h[index], compute_uv=False)
    draw = np.random.default_rng(0).multivariate_normal
    errors = draw(np.zeros(g.size), covariance, size=DRAWS, method="eigh")
    norms = np.linalg.norm(errors[:, g.size - h.size :][:, index], ord=2, axis=(1, 2))
    return values / values[0], float(np.quantile(norms, 0.95)) / float(values[0])


def _extremes_told(h: StructureHints) -> str:
    """Return the resonances and antiresonances, with the poles and zeros that they need."""
    told = []
    for x, name, wants in (
        (h.resonances, "resonance", "poles"),
        (h.antiresonances, "antiresonance", "zeros"),
    ):
        at = ", ".join(f"{w:.3g}" for w in x)
        several, each = ("s", " each") if len(x) > 1 else ("", "")
        told.append(f"{name}{several} at {at} rad/s (two {wants}{each})" if x else f"no {name}")
    return ", ".join(told)


def _process_told(form: str) -> str:
    """Return the name of a process model and the call that estimates it."""
    parts = {"D": "dead time", "I": "an integrator", "U": "a resonance"}
    has = [name for letter, name in parts.items() if letter in form]
    more = f" with {listed(has)}" if has else ""
    return f'a {_ORDINALS[int(form[1])]}-order process{more}: process(data, "{form}")'


def _named(s: Recommended) -> str:
    return f"oe(data, nb={s.nb}, nf={s.nf}, nk={s.nk}, integrator={s.integrator})"


def call_of_all(found: Mapping[Name, StructureHints]) -> str:
    """Return one call of `oe` for all channels, with the orders of each output and input.

    An output integrates if one of its channels integrates. The other channels of this output then
    have a root at 1 in B, too.
    """
    integrating = tuple(dict.fromkeys(output for (output, _), h in found.items() if h.integrator))
    inputs = list(dict.fromkeys(input for _, input in found))
    more = {name: name[0] in integrating and not h.integrator for name, h in found.items()}

    def orders(order: str) -> Any:
        n = [getattr(h, order) + (order != "nk" and more[name]) for name, h in found.items()]
        rows = [n[i : i + len(inputs)] for i in range(0, len(n), len(inputs))]
        return n[0] if len(set(n)) == 1 else rows

    given = ", ".join(f"{order}={orders(order)}" for order in ("nb", "nf", "nk"))
    return f"oe(data, {given}, integrator={integrating or False})"


def _findings(h: StructureHints) -> Iterator[Finding]:
    if h.excitation < (needed := h.nb + h.nf):
        many = f"this structure has {needed} parameters"
        yield warning("excitation", poor_input(h.excitation, many))
    yield _about_integrator(h)
    if h.resonances or h.antiresonances:
        what = "the rate" if h.integrator else "y"
        yield good(f"shape of {what}", _extremes_told(h))
    shown = ", ".join(f"{v:.2g}" for v in h.singular_values[:6])
    with_integrator = h.integrator and h.integrator_shown
    n = h.order - with_integrator
    more = ""
    if h.order < h.nf and h.integrator_shown:
        more = f"; nf = {h.nf} has the shortest description, which noise alone may cause: keep it "
        more += f"only if a model with nf = {h.order} has coloured residuals, or if physics has "
        more += "more poles"
    text = f"Hankel singular values {shown} …, uncertainty alone causes up to {h.threshold:.2g}: "
    text += f"{n or 'none'} {'stands' if n <= 1 else 'stand'} out"
    yield good("order", f"{text}{', and the integrator' if with_integrator else ''}{more}")
    if h.high_slope is not None:
        excess = plural(h.relative_degree, "more pole") if h.relative_degree else "no more poles"
        text = f"{minus(f'{h.high_slope:.0f}')} dB a decade from {h.high_band[0]:.3g} to "
        text += f"{h.high_band[-1]:.3g} rad/s: {excess} than zeros up to these frequencies"
        yield good("roll-off", text)
    why_not = "not shown (armrig.delay, `armrig check` say why)"
    yield good("delay", first_lag(h.nk_interval, h.spectrum.Ts) if h.nk_interval else why_not)


def _about_integrator(h: StructureHints) -> Finding:
    verdict = "y integrates: fix a pole at 1" if h.integrator else "no integrator"
    if not h.integrator_shown:
        verdict = "not shown, because a slow pole looks the same: try both"
    if h.low_slope is None:
        return good("integrator", verdict)
    if h.integrator_shown and not h.integrator and h.low_slope < -10:
        verdict = f"a slow pole, and {verdict}, since a pole at 1 fits worse"
    text = f"|G| has a slope of {minus(f'{h.low_slope:.3g}')} dB a decade at low frequency "
    return good("integrator", f"{text}(0 without one, −20 with one): {verdict}")
