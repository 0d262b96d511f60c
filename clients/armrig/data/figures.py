"""Figures of data: against time, spectra, and histograms of the values."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.quantities import NBSP, minus
from armrig.plots.captions import NAMES, legend, named, sign
from armrig.plots.layout import BLUE, INK, bare_minor, finish, hertz, panels, shade

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Vector = NDArray[np.float64]

MIN_RAMP_SHARE = 0.95  # share of the variance above which a straight line hides other motion
_MIN_INPUT_CHANGES = 5  # an input with fewer changes is a step


class InputAndOutput(Protocol):
    """Input and output at N instants; `Dataset` has these fields and documents them."""

    @property
    def u(self) -> Vector:
        """Input (N,)."""

    @property
    def y(self) -> Vector:
        """Output (N,), NaN where it is missing."""

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Mask (N,), False where the output is missing."""

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

    def experiments(self) -> Iterable[InputAndOutput]:
        """Iterate over the experiments."""


@runtime_checkable
class HasInputAndOutput(Protocol):
    """An object with signals, such as a `Recording`."""

    def dataset(self) -> InputAndOutput:
        """Return the signals."""


def without_ramp(data: InputAndOutput) -> tuple[Vector, str, tuple[str, ...]]:
    """Return the ramp (N,) that dominates an output, the label of the axis, and legend lines.

    If a straight line explains nearly all of y, the ramp has the slope of this line. A plot of an
    angle that turns by 140 rad, for example, would show only the mean rotation. The label and the
    legend lines name the slope. Otherwise the ramp is 0, and there are no legend lines. The ramp is
    also 0 if the input is a step, because the slope is part of the step response.
    """
    none = np.zeros(data.t.size), named(data.output, data.unit), ()
    seen = data.valid
    if np.count_nonzero(seen) < 3 or np.count_nonzero(np.diff(data.u)) < _MIN_INPUT_CHANGES:
        return none
    slope, level = np.polyfit(data.t[seen], data.y[seen], 1)
    left = np.var(data.y[seen] - level - slope * data.t[seen])
    if not left < (1 - MIN_RAMP_SHARE) * np.var(data.y[seen]):
        return none
    name, digits = NAMES.get(data.output, data.output), minus(f"{abs(slope):.3g}")
    label = f"{name} {'−' if slope > 0 else '+'} {digits} $t$\n[{data.unit or '–'}]"
    rate = f"{minus(f'{slope:.3g}')}{NBSP}{f'{data.unit}/s' if data.unit else 'per s'}"
    return slope * data.t, label, (f"{name} minus its mean rate, {rate}",)


def plot_data(source: InputAndOutput | HasInputAndOutput, *, ax: Axes | None = None) -> Axes:
    """Plot the output and, below, the input against time; times without an output are shaded.

    For a recording, the output is theta_1. An output that is nearly a ramp is drawn without the
    ramp: see `without_ramp`.
    """
    data = _data_of(source)
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


def plot_spectrum(source: InputAndOutput | HasInputAndOutput, *, ax: Axes | None = None) -> Axes:
    """Plot the power density of the output and, below it, of the input, on logarithmic axes.

    The density is averaged over the parts without a gap: see `armrig.numerics.power_spectrum`.
    A density that rises towards the right edge, the Nyquist frequency, shows noise or a sampling
    rate that is too low.
    """
    from armrig.numerics.power_spectrum import power_spectrum

    data = _data_of(source)
    ax, below = panels(ax, 0.5)
    notes: list[str] = []
    for panel, signals, colour, label, unit in (
        (ax, [d.y for d in data.experiments()], BLUE, data.output, data.unit),
        (below, [d.u for d in data.experiments()], INK, "$u$", data.input_unit),
    ):
        omega, density = power_spectrum(signals, data.Ts)
        # A logarithmic axis cannot show frequency 0. At the Nyquist frequency the density is not
        # doubled. Both are left out.
        omega, density = omega[1:-1], density[1:-1]
        panel.plot(omega, np.maximum(density, 1e-300), color=colour, lw=0.9)
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_ylabel(f"{NAMES.get(label, label)} [{squared(unit)}s/rad]")
        notes.append(f"power density of {NAMES.get(label, label)}")
        bare_minor(panel.xaxis, panel.yaxis)
        shown = density[density > 0]
        if shown.size:
            # Show at most 12 decades: a periodic input has only rounding errors between its peaks.
            panel.set_ylim(max(float(shown.min()), 1e-12 * float(shown.max())) / 2, None)
    below.set_xlabel(r"$\omega$ [rad/s]")
    finish(ax, below, xlim=(float(omega[0]), np.pi / data.Ts))
    legend(below, notes[1])
    return sign(ax, data.source, above=legend(ax, notes[0], lift=hertz(ax)))


def plot_values(source: InputAndOutput | HasInputAndOutput, *, ax: Axes | None = None) -> Axes:
    """Plot histograms of the output and, below it, of the input.

    The counts are logarithmic, so that a single sample far from all others is visible.
    """
    data = _data_of(source)
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
    """Return the squared unit and a space, for the label of an axis; "" without a unit."""
    return f"({unit})² " if "/" in unit else f"{unit}² " if unit else ""


def _data_of(source: InputAndOutput | HasInputAndOutput) -> InputAndOutput:
    return source.dataset() if isinstance(source, HasInputAndOutput) else source
