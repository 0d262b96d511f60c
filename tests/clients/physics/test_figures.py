"""The figures of physics, integration and grey box use the given axes, and label them."""

from __future__ import annotations

from collections.abc import Iterator

import matplotlib as mpl
import numpy as np
import pytest
from armrig.physics.integrators.accuracy import sinusoid
from armrig.physics.integrators.figures import (
    plot_solution,
    plot_stability_edge,
    plot_stability_regions,
)
from armrig_core.rig.arm import ArmParameters, arm_matrices
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

A, B, _ = arm_matrices(ArmParameters())
PROBLEM = sinusoid(A, B, omega=5.0, span=1.0)


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """Draw without a screen, and leave no figure open."""
    with mpl.rc_context({"backend": "agg"}):
        yield
        plt.close("all")


def test_the_arm_s_points_lie_on_the_edge_at_the_limit() -> None:
    """The oscillation's pair at forward Euler's limit is on its circle around -1."""
    ax = plot_stability_regions(A, ax=Figure().add_subplot())

    [points] = [line for line in ax.lines if line.get_marker() == "x"]
    z = np.asarray(points.get_xdata()) + 1j * np.asarray(points.get_ydata())
    assert sorted(np.abs(z + 1))[-3:] == pytest.approx([1.0, 1.0, 1.0])


def test_a_method_without_a_stability_edge_has_no_figure() -> None:
    with pytest.raises(ValueError, match="no figure is possible"):
        plot_stability_edge(A, "trapezoidal")


@pytest.mark.parametrize("state", [0, 1, 3])
def test_the_error_figure_shows_the_errors_of_the_state(state: int) -> None:
    steps = {"heun": 0.01, "trapezoidal": 0.004}
    ax = plot_solution(PROBLEM, steps, state=state, label="x [m]", ax=Figure().add_subplot())
    below = ax.figure.axes[1]

    largest = []
    for (name, h), drawn, error in zip(steps.items(), ax.lines[1:], below.lines, strict=True):
        t, x = PROBLEM.solve(h, round(1.0 / h), name)
        np.testing.assert_allclose(drawn.get_ydata(), x[:, state])
        expected = x[:, state] - PROBLEM.truth(t)[:, state]
        np.testing.assert_allclose(error.get_ydata(), expected, atol=1e-12)
        largest.append(np.abs(expected).max())
    assert below.get_ylim() == pytest.approx((-1.2 * max(largest), 1.2 * max(largest)))
    assert (ax.get_ylabel(), below.get_ylabel()) == ("x [m]", "error\n[m]")
