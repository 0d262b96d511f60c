"""Figures: each takes `ax` or makes one, returns it, and names the recording it shows.

A result's `.plot()` draws the same and returns the whole figure, to be saved:
`armrig.delay(data).plot().savefig("delay.svg")`; its panels are `.axes`. For several in one figure
give each its own axes, `.plot(ax=ax)`, and mark all panels in the end, `letter(figure)`.

Colours are Okabe and Ito's, told apart by the colour-blind; line styles tell the same in black and
white. A second panel, where a figure has one, takes its place from the lower part of `ax`.
"""

from armrig.canvas import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    finish,
    letter,
    sign,
)
from armrig.data.figures import plot_data, plot_spectrum, plot_values
from armrig.estimation.figures import plot_orders
from armrig.estimation.nonparametric.figures import (
    plot_correlation,
    plot_impulse,
    plot_sampling_time,
    plot_step_analysis,
    plot_structure,
)
from armrig.excitation.figures import plot_input
from armrig.models.figures import plot_bode, plot_fit, plot_step
from armrig.models.pole_zero_figure import plot_poles_zeros
from armrig.models.spectral_figure import plot_spectral
from armrig.physics.figures import plot_physical_step, plot_rig, plot_sensitivities
from armrig.physics.grey_box.figures import plot_greybox, plot_split
from armrig.physics.integrators.figures import (
    plot_convergence,
    plot_solution,
    plot_stability_edge,
    plot_stability_regions,
)
from armrig.physics.systems import beside_the_handout
from armrig.recordings.calibration.figures import plot_calibration
from armrig.recordings.figures import plot_timing
from armrig.validation.feedback_and_delay.figures import plot_delay, plot_open_loop
from armrig.validation.figures import plot_compare, plot_residuals
from armrig.validation.search_figure import plot_search

__all__ = [
    "BLUE",
    "GREEN",
    "GREY",
    "INK",
    "ORANGE",
    "PURPLE",
    "SKY",
    "VERMILION",
    "beside_the_handout",
    "finish",
    "letter",
    "plot_bode",
    "plot_calibration",
    "plot_compare",
    "plot_convergence",
    "plot_correlation",
    "plot_data",
    "plot_delay",
    "plot_fit",
    "plot_greybox",
    "plot_impulse",
    "plot_input",
    "plot_open_loop",
    "plot_orders",
    "plot_physical_step",
    "plot_poles_zeros",
    "plot_residuals",
    "plot_rig",
    "plot_sampling_time",
    "plot_search",
    "plot_sensitivities",
    "plot_solution",
    "plot_spectral",
    "plot_spectrum",
    "plot_split",
    "plot_stability_edge",
    "plot_stability_regions",
    "plot_step",
    "plot_step_analysis",
    "plot_structure",
    "plot_timing",
    "plot_values",
    "sign",
]
