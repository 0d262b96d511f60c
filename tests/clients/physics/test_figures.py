"""The figures of physics, integration and grey box use the given axes, and label them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.physics.figures import (
    plot_physical_step,
)
from armrig.physics.integrators.accuracy import sinusoid
from armrig.physics.integrators.figures import (
    plot_solution,
    plot_stability_edge,
    plot_stability_regions,
)
from armrig.physics.systems import beside_the_handout
from armrig_core.arm import ArmParameters, arm_matrices
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from tests.clients.chassis_data import Make

A, B, _ = arm_matrices(ArmParameters())
PROBLEM = sinusoid(A, B, omega=5.0, span=1.0)


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """Draw without a screen, and leave no figure open."""
    with mpl.rc_context({"backend": "agg"}):
        yield
        plt.close("all")


@pytest.fixture(scope="module")
def data(make: Make) -> Dataset:
    return make(N=1500)


def test_the_arm_s_points_lie_on_the_edge_at_the_limit() -> None:
    """The oscillation's pair at forward Euler's limit is on its circle around -1."""
    ax = plot_stability_regions(A, ax=Figure().add_subplot())

    [points] = [line for line in ax.lines if line.get_marker() == "x"]
    z = np.asarray(points.get_xdata()) + 1j * np.asarray(points.get_ydata())
    assert sorted(np.abs(z + 1))[-3:] == pytest.approx([1.0, 1.0, 1.0])


def test_an_edge_that_is_not_there_is_refused() -> None:
    with pytest.raises(ValueError, match="no figure is possible"):
        plot_stability_edge(A, "trapezoidal")


@pytest.mark.parametrize(
    ("u", "steady", "slopes"),
    [(1.0, "1.8623", ("98.40", "49.20")), (2.5, "4.6558", ("246.00", "123.00"))],
)
def test_changed_parameters_are_shown_next_to_the_handouts_own(
    u: float, steady: str, slopes: tuple[str, str]
) -> None:
    """Assignment 2.3: each change alone and both together, for the height of the step."""
    p = ArmParameters()
    cases = beside_the_handout(replace(p, J_1=2 * p.J_1, K_lin=2 * p.K_lin))
    ax = plot_physical_step(cases, u=u, ax=Figure().add_subplot())

    legend = ax.get_legend()
    assert legend is not None
    assert [" ".join(t.get_text().split()) for t in legend.get_texts()] == [
        f"handout: steady {steady} rad/s, initial slope {slopes[0]} rad/s²",
        f"$J_1$=0.0034: steady {steady} rad/s, initial slope {slopes[1]} rad/s²",
        f"$K_{{lin}}$=2.38: steady {steady} rad/s, initial slope {slopes[0]} rad/s²",
        f"both: steady {steady} rad/s, initial slope {slopes[1]} rad/s²",
        "steady speed and initial slope, handout",
    ]
    assert legend.get_title().get_text() == f"step of {u:g} V from rest"
    own, changed = (np.asarray(line.get_ydata()) for line in ax.lines[:2])
    assert changed[5] == pytest.approx(own[5] / 2, rel=0.1)


def test_each_method_is_drawn_at_its_own_step() -> None:
    ax = plot_solution(PROBLEM, {"heun": 0.01, "ab2": 0.004}, ax=Figure().add_subplot())

    legend = ax.get_legend()
    assert legend is not None
    assert [t.get_text() for t in legend.get_texts()] == [
        "exact",
        "Heun, RK(2), 10 ms",
        "AB(2), 4 ms",
    ]
    assert [len(np.asarray(line.get_xdata())) for line in ax.lines[1:]] == [101, 251]


@pytest.mark.parametrize("state", [0, 1, 3])
def test_the_errors_of_a_solution_are_those_of_its_state(state: int) -> None:
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
