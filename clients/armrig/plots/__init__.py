"""Figures: each takes `ax` or makes one, returns it, and names the recording it shows.

A result's `.plot()` draws the same and returns the whole figure, to be saved:
`armrig.delay(data).plot().savefig("delay.svg")`; its panels are `.axes`. For several in one figure
give each its own axes, `.plot(ax=ax)`, and mark all panels in the end, `letter(figure)`.

Colours are Okabe and Ito's, told apart by the colour-blind; line styles tell the same in black and
white. A second panel, where a figure has one, takes its place from the lower part of `ax`.
"""

from __future__ import annotations

from typing import Any

from armrig_core.public_names import homes, public

__all__ = list(homes(__name__))  # in the stub, `__init__.pyi`


def __getattr__(name: str) -> Any:
    """Return a public name; its module is loaded only now."""
    return public(__name__, name)


def __dir__() -> list[str]:
    return __all__
