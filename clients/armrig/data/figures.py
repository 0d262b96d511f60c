"""Figures of data: against time, their spectra, and how often each value was taken."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.quantities import NBSP, minus
from armrig.plots.captions import NAMES, legend, named, sign
from armrig.plots.layout import BLUE, INK, finish, panels, shade
from armrig.plots.scales import bare_minor, hertz

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Vector = NDArray[np.float64]

_RAMP = 0.95  # share of the variance that a straight line explains, from which on it hides the rest
_CHANGES = 5  # of the input; one that changes less often is a step


class Signals(Protocol):
    """Input and output at N instants; a `Dataset` is one. Its fields say more."""

    @property
    def u(self) -> Vector:
        """Input (N,)."""

    @property
    def y(self) -> Vector:
        """Output (N,), NaN where it is missing."""

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(N,), False where the output is missing."""

    @property
    def t(self) -> Vector:
        """Time (N,), in s."""

    @property
    def Ts(self) -> float:
        """Sampling time, in s."""

    @property
    def output(self) -> str:
        """Name of y."""

    @property
    def unit(self) -> str:
        """Unit of y."""

    @property
    def input_unit(self) -> str:
        """Unit of u."""

    @property
    def source(self) -> str:
        """Hash of the recording, or ""."""

    def experiments(self) -> Iterable[Signals]:
        """Iterate over the experiments."""


@runtime_checkable
class HasSignals(Protocol):
    """What signals can be taken from; a `Recording` is one."""

    def dataset(self) -> Signals:
        """Return its signals."""


def without_ramp(data: Signals) -> tuple[Vector, str, tuple[str, ...]]:
    """Return the ramp that hides what else an output does, (N,), and the label of what is left.

    Last are the lines for the legend that explain the label: none where nothing is taken off.

    An angle that turns on for 140 rad shows nothing but that it turns. Where a straight line
    explains nearly all of y its slope is taken off, and the label says so; the answer to a step
    keeps it, for there the slope is the answer.
    """
    none = np.zeros(data.t.size), named(data.output, data.unit), ()
    seen = data.valid
    if np.count_nonzero(seen) < 3 or np.count_nonzero(np.diff(data.u)) < _CHANGES:
        return none
    slope, level = np.polyfit(data.t[seen], data.y[seen], 1)
    left = np.var(data.y[seen] - level - slope * data.t[seen])
    if not left < (1 - _RAMP) * np.var(data.y[seen]):
        return none
    name, digits = NAMES.get(data.output, data.output), minus(f"{abs(slope):.3g}")
    label = f"{name} {'−' if slope > 0 else '+'} {digits} $t$\n[{data.unit or '–'}]"
    rate = f"{minus(f'{slope:.3g}')}{NBSP}{f'{data.unit}/s' if data.unit else 'per s'}"
    return slope * data.t, label, (f"{name} less its mean rate, {rate}",)


def plot_data(source: Signals | HasSignals, *, ax: Axes | None = None) -> Axes:
    """Show output and, below it, input against time; where the output is missing is shaded.

    A recording shows theta_1. What is a ramp and little else is shown without it: see
    `without_ramp`.
    """
    data = _signals(source)
    ax, below = panels(ax, 0.28)
    ramp, label, notes = without_ramp(data)
    ax.plot(data.t, data.y - ramp, color=BLUE, lw=0.9)
    ax.set_ylabel(label)
    below.step(data.t, data.u, where="post", color=INK, lw=0.7)
    below.set_ylabel(named("$u$", data.input_unit))
    below.set_xlabel("$t$ [s]")
    below.margins(y=0.15)
    for panel in (ax, below):
        shade(panel, data.valid, data.Ts)
    finish(ax, below, xlim=(0.0, float(data.t[-1]) or 1.0))
    return sign(ax, data.source, above=legend(ax, *notes))


def plot_spectrum(source: Signals | HasSignals, *, ax: Axes | None = None) -> Axes:
    """Show the power density of the output and, below it, of the input, both axes logarithmic.

    Averaged over the stretches without a gap, see `armrig.numerics.power_spectrum`. What
    rises towards the right edge, the Nyquist frequency, was sampled too slowly, or is noise.
    """
    from armrig.numerics.power_spectrum import power_spectrum

    data = _signals(source)
    ax, below = panels(ax, 0.5)
    notes: list[str] = []
    for panel, signals, colour, label, unit in (
        (ax, [d.y for d in data.experiments()], BLUE, data.output, data.unit),
        (below, [d.u for d in data.experiments()], INK, "$u$", data.input_unit),
    ):
        omega, density = power_spectrum(signals, data.Ts)
        # A logarithmic axis has no 0; the density at Nyquist's frequency is not doubled.
        omega, density = omega[1:-1], density[1:-1]
        panel.plot(omega, np.maximum(density, 1e-300), color=colour, lw=0.9)
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_ylabel(f"{NAMES.get(label, label)} [{squared(unit)}s/rad]")
        notes.append(f"power density of {NAMES.get(label, label)}")
        bare_minor(panel.xaxis, panel.yaxis)
        shown = density[density > 0]
        if shown.size:
            # A periodic input has only rounding errors between its lines: show twelve decades.
            panel.set_ylim(max(float(shown.min()), 1e-12 * float(shown.max())) / 2, None)
    below.set_xlabel(r"$\omega$ [rad/s]")
    finish(ax, below, xlim=(float(omega[0]), np.pi / data.Ts))
    legend(below, notes[1])
    return sign(ax, data.source, above=legend(ax, notes[0], lift=hertz(ax)))


def plot_values(source: Signals | HasSignals, *, ax: Axes | None = None) -> Axes:
    """Show how often each value of the output and, below it, of the input was taken.

    The counts are logarithmic: a single sample far from all others, an outlier, shows.
    """
    data = _signals(source)
    ax, below = panels(ax, 0.5, sharex=False)
    ramp, label, notes = without_ramp(data)
    for panel, values, colour, name in (
        (ax, (data.y - ramp)[data.valid], BLUE, label),
        (below, data.u, INK, named("$u$", data.input_unit)),
    ):
        panel.hist(values, bins=60, color=colour, alpha=0.75)
        panel.set_yscale("log")
        panel.set_ylim(bottom=0.6)
        panel.set_xlabel(name)
        panel.set_ylabel("samples")
        finish(panel)
    return sign(ax, data.source, above=legend(ax, *notes))


def squared(unit: str) -> str:
    """Return a unit's square and a space, for an axis; nothing where there is no unit."""
    return f"({unit})² " if "/" in unit else f"{unit}² " if unit else ""


def _signals(source: Signals | HasSignals) -> Signals:
    return source.dataset() if isinstance(source, HasSignals) else source
