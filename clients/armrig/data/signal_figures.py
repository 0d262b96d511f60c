"""Figure of several inputs and outputs against time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from armrig.plots.captions import legend, named, sign
from armrig.plots.layout import BLUE, INK, finish, high_axes, rows, shade

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.signals import Signals


def plot_signals(signals: Signals, *, ax: Axes | None = None) -> Axes:
    """Plot all outputs and, below, all inputs against time; missing outputs are shaded.

    A vertical line marks the beginning of each experiment, except the first.
    """
    panels = rows(ax or high_axes(signals.ny + signals.nu), signals.ny + signals.nu)
    t = signals.t
    for i, panel in enumerate(panels[: signals.ny]):
        panel.plot(t, signals.y[:, i], color=BLUE, lw=0.9)
        panel.set_ylabel(named(signals.outputs[i], signals.units[i]))
        if signals.Ts is not None:
            shade(panel, signals.valid[:, i], signals.Ts)
    for j, panel in enumerate(panels[signals.ny :]):
        if signals.intersample[j] == "zoh":
            panel.step(t, signals.u[:, j], where="post", color=INK, lw=0.7)
        else:
            panel.plot(t, signals.u[:, j], color=INK, lw=0.7)
        panel.set_ylabel(named(signals.inputs[j], signals.input_units[j]))
        panel.margins(y=0.15)
    for panel in panels:
        for start in signals.starts[1:]:
            panel.axvline(t[start], color=INK, lw=0.6, ls=(0, (4, 2)))
    panels[-1].set_xlabel("$t$ [s]")
    finish(*panels, xlim=(float(np.min(t)), float(np.max(t)) or 1.0))
    return sign(panels[0], signals.source, above=legend(panels[0]))
