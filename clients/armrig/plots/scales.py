"""Axes in Hz, in dB, and logarithmic ones with plain numbers."""

from __future__ import annotations

from math import tau
from typing import TYPE_CHECKING, Any

from armrig.plots.layout import GREY

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis, XAxis, YAxis
    from numpy.typing import NDArray


def hertz(ax: Axes) -> float:
    """Write the frequencies of an axis in rad/s in Hz, too, above; return the height in points."""
    import matplotlib as mpl
    from matplotlib.font_manager import FontProperties
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    def to_hertz(omega: Any) -> Any:
        return omega / tau

    def to_radians(f: Any) -> Any:
        return f * tau

    above = ax.secondary_xaxis("top", functions=(to_hertz, to_radians))
    above.set_xscale("log")
    above.xaxis.set_major_locator(LogLocator())
    above.xaxis.set_major_formatter(FuncFormatter(lambda f, _: f"{f:g} Hz"))
    above.xaxis.set_minor_formatter(NullFormatter())
    above.tick_params(axis="x", which="both", labelsize="small", pad=1, colors=GREY)
    above.spines["top"].set_visible(False)
    size = FontProperties(size="small").get_size_in_points()
    return float(1.4 * size + mpl.rcParams["xtick.major.size"])


def decibels(x: NDArray[Any]) -> NDArray[np.float64]:
    """Return 20 log10 |x|; of 0 the lowest that a figure can want."""
    import numpy as np

    return np.asarray(20 * np.log10(np.maximum(np.abs(x), 1e-15)), dtype=np.float64)


def decibel_ticks(ax: Axes) -> None:
    """Put the ticks of an axis in dB at multiples of 20, 40 … dB."""
    from matplotlib.ticker import MaxNLocator

    ax.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 4, 10]))


def logarithmic(axis: XAxis | YAxis, low: float, high: float) -> None:
    """Make an axis logarithmic, with 1, 2, 5, 10 … or the decades for ticks, as plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator

    ax = axis.axes
    if axis.axis_name == "x":
        ax.set_xscale("log")
        ax.set_xlim(low, high)
    else:
        ax.set_yscale("log")
        ax.set_ylim(low, high)
    subs = (1.0, 2.0, 5.0) if high < 200 * low else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs, numticks=20))
    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    bare_minor(axis)


def bare_minor(*shown: Axis) -> None:
    """Write no number between the decades of logarithmic axes."""
    from matplotlib.ticker import NullFormatter

    for axis in shown:
        axis.set_minor_formatter(NullFormatter())
