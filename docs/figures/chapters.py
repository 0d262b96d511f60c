"""Draws the figures of docs/physics.md and docs/integrators.md beside itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import armrig
import matplotlib as mpl
from armrig.physics.figures import plot_physical_step, plot_rig, plot_sensitivities
from armrig.physics.integrators.figures import (
    plot_convergence,
    plot_solution,
    plot_stability_edge,
    plot_stability_regions,
)
from armrig.physics.integrators.methods import METHODS
from armrig.plots.layout import save
from armrig_core.rig.arm import arm_matrices
from matplotlib.axes import Axes

mpl.use("Agg")
FOLDER = Path(__file__).parent


def draw(name: str, size: tuple[float, float], *plots: Callable[[Axes], Axes]) -> None:
    """Write one figure with a panel for each plot."""
    from matplotlib import pyplot as plt

    with mpl.rc_context({"font.size": 9}):
        figure, every = plt.subplots(
            1, len(plots), figsize=size, squeeze=False, layout="constrained"
        )
        for plot, ax in zip(plots, every[0], strict=True):
            plot(ax)
        save(figure, FOLDER / name)
        plt.close(figure)


def main() -> None:
    """Draw all of them."""
    p = armrig.physics.ArmParameters()
    A, B, _ = arm_matrices(p)
    problem = armrig.physics.sinusoid(A, B, amplitude=2.0, omega=5.0)
    cases = {
        "handout": p,
        "$J_1$ doubled": replace(p, J_1=2 * p.J_1),
        "$K_{lin}$ doubled": replace(p, K_lin=2 * p.K_lin),
    }
    draw("physics-structure.svg", (6.3, 3.0), lambda ax: plot_rig(ax=ax))
    draw(
        "physics-step.svg",
        (11, 3.6),
        lambda ax: plot_physical_step(cases, ax=ax),
        lambda ax: plot_sensitivities(p, ax=ax),
    )
    draw(
        "integrators-stability.svg",
        (11, 4.2),
        lambda ax: plot_stability_regions(A, ax=ax),
        lambda ax: plot_stability_edge(A, "forward_euler", state=2, ax=ax),
    )
    draw(
        "integrators-error.svg",
        (11, 4.2),
        lambda ax: plot_solution(problem, 0.02, state=2, label=r"$\dot\theta_1$ [rad/s]", ax=ax),
        lambda ax: plot_convergence(
            [armrig.physics.convergence(problem, m) for m in METHODS], ax=ax
        ),
    )


if __name__ == "__main__":
    main()
