"""Figures: each takes `ax` or makes one, returns it, and names the recording it shows.

Colours are Okabe and Ito's, told apart by the colour-blind; line styles tell the same in black and
white. A second panel, where a figure has one, takes its place from the lower part of `ax`.
"""

from armrig.plots.canvas import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    finish,
    sign,
)
from armrig.plots.data import plot_data, plot_timing
from armrig.plots.models import (
    plot_bode,
    plot_compare,
    plot_fit,
    plot_poles_zeros,
    plot_residuals,
    plot_step,
)

__all__ = [
    "BLUE",
    "GREEN",
    "GREY",
    "INK",
    "ORANGE",
    "PURPLE",
    "SKY",
    "VERMILION",
    "finish",
    "plot_bode",
    "plot_compare",
    "plot_data",
    "plot_fit",
    "plot_poles_zeros",
    "plot_residuals",
    "plot_step",
    "plot_timing",
    "sign",
]
