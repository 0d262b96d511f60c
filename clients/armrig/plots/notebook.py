"""Display of a result in a notebook: the result's text and figure."""

from __future__ import annotations

import sys
from base64 import b64encode
from html import escape
from io import BytesIO
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Plotted(Protocol):
    """A result that has a figure."""

    def plot(self) -> Figure:
        """Return the figure."""


def html(result: Plotted) -> str:
    """Return a result's text and figure as HTML, for a notebook's `_repr_html_`."""
    from matplotlib import pyplot as plt

    figure = result.plot()
    data = b64encode(png(figure)).decode()
    plt.close(figure)
    words = escape(repr(result))
    return f'<pre>{words}</pre><img alt="{words}" src="data:image/png;base64,{data}">'


def png(figure: Figure) -> bytes:
    """Return a figure as PNG with 100 dpi, for a screen."""
    out = BytesIO()
    figure.savefig(out, format="png", dpi=100)
    return out.getvalue()


def show_once(figure: Figure) -> None:
    """Make a notebook show a pyplot figure only once.

    A notebook shows a cell's result and, at the cell's end, all open pyplot figures. IPython calls
    the method `_ipython_display_` of a cell's result. This function gives the figure such a method,
    which shows the figure and then closes the figure in pyplot.
    """
    pyplot = sys.modules.get("matplotlib.pyplot")
    if pyplot is None or "inline" not in pyplot.get_backend():
        return

    def display() -> None:
        from IPython.display import Image  # type: ignore[import-not-found]
        from IPython.display import display as show

        show(Image(png(figure)))
        pyplot.close(figure)

    figure._ipython_display_ = display  # type: ignore[attr-defined]
