"""Figures of data: against time, spectra, and histograms of the values."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.telemetry.channels import ARM_OUTPUTS

from armrig.numerics.quantities import NBSP, digits, minus
from armrig.plots.captions import axis_label, legend, sign, symbol_of
from armrig.plots.layout import (
    BLUE,
    INK,
    axes,
    bare_minor,
    finish,
    hertz,
    high_axes,
    panels,
    rows,
    shade,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.argument import HasDataset
    from armrig.data.columns import Vector
    from armrig.data.dataset import Dataset, Signals
    from armrig.data.files.imported_file import ImportedData

MOST_COLUMNS = 8
"""Largest number of imported columns in a figure."""
MIN_RAMP_SHARE = 0.95  # share of the variance above which a straight line hides other motion
_MIN_INPUT_CHANGES = 5  # an input with fewer changes is a step


def without_ramp(
    data: Dataset | Signals, output: str | None = None
) -> tuple[Vector, str, tuple[str, ...]]:
    """Return the ramp (N,) that dominates an output, the label of the axis, and legend lines.

    If a straight line explains nearly all of y, the ramp has the slope of this line. A plot of an
    angle that turns by 140 rad, for example, would show only the mean rotation. The label and the
    legend lines name the slope. Otherwise the ramp is 0, and there are no legend lines. The ramp is
    also 0 if the inputs are steps, because the slope is part of the step response.
    """
    signals = data.signals()
    i = signals.output(output)
    name, unit, t = signals.outputs[i], signals.units[i], signals.t
    none = np.zeros(t.size), axis_label(name, unit), ()
    seen = signals.valid[:, i]
    changes = np.count_nonzero(np.any(np.diff(signals.u, axis=0), axis=1))
    if np.count_nonzero(seen) < 3 or changes < _MIN_INPUT_CHANGES:
        return none
    y = signals.y[seen, i]
    slope, level = np.polyfit(t[seen], y, 1)
    left = np.var(y - level - slope * t[seen])
    if not left < (1 - MIN_RAMP_SHARE) * np.var(y):
        return none
    symbol, rise = symbol_of(name), minus(digits(abs(slope), 3))
    label = f"{symbol} {'−' if slope > 0 else '+'} {rise} $t$\n[{unit or '–'}]"
    rate = f"{minus(digits(slope, 3))}{NBSP}{f'{unit}/s' if unit else 'per s'}"
    return slope * t, label, (f"{symbol} minus its mean rate, {rate}",)


def plot_data(source: Dataset | Signals | HasDataset, *, ax: Axes | None = None) -> Axes:
    """Plot the outputs and, below, the inputs against time; times without an output are shaded.

    For a recording, the output is the first. An output that is nearly a ramp is drawn without the
    ramp: see `without_ramp`. A vertical line marks the beginning of each experiment, except the
    first.
    """
    data = _signals_of(source)
    n = data.ny + data.nu
    every = [*panels(ax, 0.28)] if n == 2 else rows(ax or high_axes(n), n)
    t, notes = data.t, list[str]()
    for i, panel in enumerate(every[: data.ny]):
        ramp, label, note = without_ramp(data, data.outputs[i])
        notes += note
        panel.plot(t, data.y[:, i] - ramp, color=BLUE, lw=0.9)
        panel.set_ylabel(label)
    for j, panel in enumerate(every[data.ny :]):
        if data.intersample[j] == "zoh":
            panel.step(t, data.u[:, j], where="post", color=INK, lw=0.7)
        else:
            panel.plot(t, data.u[:, j], color=INK, lw=0.7)
        panel.set_ylabel(axis_label(_input(data, j), data.input_units[j]))
        panel.margins(y=0.15)
    for k, panel in enumerate(every):
        columns = slice(k, k + 1) if k < data.ny else slice(None)
        valid = np.logical_or.reduce(data.valid[:, columns], axis=1)
        shade(panel, valid, data.Ts, dead_band=not ARM_OUTPUTS.isdisjoint(data.outputs))
        for start in data.starts[1:]:
            panel.axvline(t[start], color=INK, lw=0.6, ls=(0, (4, 2)))
    every[-1].set_xlabel("$t$ [s]")
    finish(*every, xlim=(float(t.min()), float(t.max()) or 1.0))
    return sign(every[0], data.source, above=legend(every[0], *notes))


def plot_columns(data: ImportedData, *, ax: Axes | None = None) -> Axes:
    """Plot the first imported columns against time, one panel for each column."""
    columns = list(data.facts.columns)[:MOST_COLUMNS]
    time, *values = [*data.on_grid().values()][: 1 + len(columns)]
    every = rows(ax or high_axes(len(columns)), len(columns))
    for panel, column, x in zip(every, columns, values, strict=True):
        panel.plot(time, x, color=BLUE, lw=0.9)
        panel.set_ylabel(axis_label(column.name, column.unit))
        for start in data.facts.breaks:
            panel.axvline(time[start], color=INK, lw=0.6, ls=(0, (4, 2)))
    every[-1].set_xlabel("$t$ [s]")
    finish(*every, xlim=(0.0, float(time[-1]) or 1.0))
    return every[0]


plot_signals = plot_data
"""Former name of `plot_data` for Signals."""


def plot_spectrum(source: Dataset | Signals | HasDataset, *, ax: Axes | None = None) -> Axes:
    """Plot the power density of the outputs and, below, of the inputs, on logarithmic axes.

    The density is averaged over the parts without a gap: see `armrig.numerics.power_spectrum`.
    A density that rises towards the right edge, the Nyquist frequency, shows noise or a sampling
    rate that is too low.
    """
    from armrig.numerics.power_spectrum import power_spectrum

    data = _signals_of(source)
    Ts, edges, n = data.Ts, [*pairwise((*data.starts, data.N))], data.ny + data.nu
    every = rows(ax or (high_axes(n + 2) if n > 2 else axes(None)), n)
    names = [*map(symbol_of, data.outputs), *(_input(data, j) for j in range(data.nu))]
    units = (*data.units, *data.input_units)
    columns, colours = np.hstack([data.y, data.u]).T, [BLUE] * data.ny + [INK] * data.nu
    for panel, colour, name, unit, x in zip(every, colours, names, units, columns, strict=True):
        omega, density = power_spectrum([x[a:b] for a, b in edges], Ts)
        # A logarithmic axis cannot show frequency 0. At the Nyquist frequency the density is not
        # doubled. Both are left out.
        omega, density = omega[1:-1], density[1:-1]
        panel.plot(omega, np.maximum(density, 1e-300), color=colour, lw=0.9)
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_ylabel(f"{name} [{_square_unit(unit)}s/rad]")
        bare_minor(panel.xaxis, panel.yaxis)
        seen = density[density > 0]
        if seen.size:
            # Show at most 12 decades: a periodic input has only rounding errors between its peaks.
            panel.set_ylim(max(float(seen.min()), 1e-12 * float(seen.max())) / 2, None)
    every[-1].set_xlabel(r"$\omega$ [rad/s]")
    finish(*every, xlim=(float(omega[0]), np.pi / Ts))
    first, *others = (f"power density of {name}" for name in names)
    for panel, note in zip(every[1:], others, strict=True):
        legend(panel, note)
    return sign(every[0], data.source, above=legend(every[0], first, lift=hertz(every[0])))


def plot_values(source: Dataset | Signals | HasDataset, *, ax: Axes | None = None) -> Axes:
    """Plot histograms of the outputs and, below, of the inputs.

    The counts are logarithmic, so that a single sample far from all others is visible.
    """
    data = _signals_of(source)
    n, notes = data.ny + data.nu, list[str]()
    every = [ax or (high_axes(n + 2) if n > 2 else axes(None))]
    for k in range(n - 1, 0, -1):
        every[-1:] = panels(every[-1], k / (k + 1), sharex=False)
    for k, panel in enumerate(every):
        if k < data.ny:
            ramp, label, note = without_ramp(data, data.outputs[k])
            notes += note
            values, colour = (data.y[:, k] - ramp)[data.valid[:, k]], BLUE
        else:
            j = k - data.ny
            label = axis_label(_input(data, j), data.input_units[j])
            values, colour = data.u[:, j], INK
        panel.hist(values, bins=60, color=colour, alpha=0.75)
        panel.set_yscale("log")
        panel.set_ylim(bottom=0.6)
        panel.set_xlabel(label)
        panel.set_ylabel("samples")
        finish(panel)
    return sign(every[0], data.source, above=legend(every[0], *notes))


def _signals_of(source: Dataset | Signals | HasDataset) -> Signals:
    data: Any = source
    signals: Signals = (data if hasattr(data, "digest") else data.dataset()).signals()
    return signals


def _input(data: Signals, j: int) -> str:
    return "$u$" if data.inputs[j] == "u" else data.inputs[j]


def _square_unit(unit: str) -> str:
    """Return the squared unit and a space, for the label of an axis; "" without a unit."""
    return f"({unit})² " if "/" in unit else f"{unit}² " if unit else ""
