"""The recommended step: stable, accurate enough, and not smaller than it must be."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.physics.integrators.accuracy import recommend_step, sinusoid
from armrig.physics.integrators.methods import METHODS
from armrig_core.rig.arm import ArmParameters, arm_matrices

A, B, _ = arm_matrices(ArmParameters())


def test_every_step_keeps_to_the_tolerance_and_to_the_limit() -> None:
    told = recommend_step(A, B, omega=5.0, tolerance=5e-3)

    problem = sinusoid(A, B, omega=5.0)
    assert {r.method for r in told.rows} == set(METHODS)
    for row in told.rows:
        assert problem.error(row.h, row.method) == row.error <= 5e-3
        assert row.h < row.limit
        assert problem.error(1.33 * row.h, row.method) > 5e-3


def test_the_methods_are_sorted_by_their_work() -> None:
    """Work is products with A: two in a step of RK(2), one in one of AB(2)."""
    rows = recommend_step(A, B, omega=5.0, tolerance=2e-3).rows

    works = [r.work for r in rows]
    assert works == sorted(works)
    assert rows[-1].method == "forward_euler"
    assert {r.method: r.work // r.steps for r in rows}["heun"] == 2


def test_stability_limits_the_step_of_a_stiff_system() -> None:
    """A decay of 1000 1/s limits the step although it is hardly excited."""
    stiff = np.diag([-1.0, -1000.0])

    told = recommend_step(stiff, [1.0, 0.0], omega=1.0, tolerance=0.1, methods=["forward_euler"])

    [row] = told.rows
    assert row.h == pytest.approx(0.002, rel=1e-6)
    assert "Stability decides" in told.explain()


def test_a_step_too_small_to_be_run_is_reported_as_unverified() -> None:
    """Forward Euler at 1e-7 would take two thousand million steps."""
    [row] = recommend_step(A, B, omega=5.0, tolerance=1e-7, methods=["forward_euler"]).rows

    assert not row.verified
    assert row.steps > 2_000_000
    assert "was not verified" in row.reason


def test_a_system_without_a_stable_step_is_refused() -> None:
    with pytest.raises(ValueError, match="not stable on this system at any step"):
        recommend_step([[0.0, 1.0], [-1.0, 0.0]], [0.0, 1.0], omega=2.0, methods=["heun"])
