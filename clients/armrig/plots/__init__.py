"""Figures. A plot function draws into `ax` or into new axes, labels the data, and returns the axes.

The method `.plot()` of a result draws the same panels and returns the figure, which can be saved:
`armrig.delay(data).plot().savefig("delay.svg")`. The attribute `.axes` of the figure contains the
panels. To draw several results in one figure, give each result its own axes, `.plot(ax=ax)`, and
mark all panels with `letter(figure)`.

Colour-blind readers can distinguish the colours, which are a palette by Okabe and Ito. In black and
white, line styles distinguish the curves. A second panel occupies the lower part of `ax`; the first
panel is shortened.
"""

from __future__ import annotations

from typing import Any

from armrig_core.process.imports import homes, public

__all__ = list(homes(__name__))  # in the stub, `__init__.pyi`


def __getattr__(name: str) -> Any:
    """Return a public object; its module is loaded at the first use."""
    return public(__name__, name)


def __dir__() -> list[str]:
    return __all__
