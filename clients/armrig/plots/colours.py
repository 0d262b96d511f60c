"""What draws curves: colours, dashes and widths, told apart in grey and by the colour-blind."""

from __future__ import annotations

from itertools import cycle
from typing import Any

# M. Okabe, K. Ito, "Color Universal Design", 2008; without the yellow, too pale on paper.
BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009E73"
PURPLE, ORANGE, SKY = "#CC79A7", "#E69F00", "#56B4E9"
INK, GREY = "#222222", "#777777"
COLOURS = (SKY, VERMILION, BLUE, GREEN, PURPLE, INK)
DASHES: tuple[Any, ...] = (
    "-",
    (0, (4, 2)),
    "-",
    (0, (6, 1.5, 1, 1.5)),
    (0, (1, 1)),
    (0, (8, 3)),
)
WIDTHS = (3.6, 2.0, 0.8, 1.2, 1.2, 0.8)


def pens(curves: int) -> list[dict[str, Any]]:
    """Return what draws each of so many curves: colour, dashes and width.

    The first is the widest: where curves agree, each shows beside the next.
    """
    if curves == 1:
        return [{"color": BLUE, "ls": "-", "lw": 1.4}]
    each = cycle(zip(COLOURS, DASHES, WIDTHS, strict=True))
    return [
        {"color": colour, "ls": dash, "lw": width}
        for (colour, dash, width), _ in zip(each, range(curves), strict=False)
    ]
