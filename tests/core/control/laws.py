"""Control laws for tests."""

from __future__ import annotations

import numpy as np
from armrig_core.control.control_law import ControlLaw, LawOutput, Monitor, Reference
from armrig_core.rig.arm import ArmParameters, arm_matrices, zero_order_hold
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

RAD_S_PER_V = 1.8623  # speed of the arm with the parameters of the handout


def arm_law(gain: float = 1.0, Ts: float = 0.01, **changes: object) -> ControlLaw:
    """Return a law of the arm's speed: an observer in predictor form, with a disturbance in V.

    Its poles are -18 ± 18i and -42 rad/s; `gain` multiplies the gains of the state.
    """
    plant, output, Gamma, L = _observer(Ts)
    K = gain * np.array([-10.43, 0.450, 0.230])
    fields = {
        "Ts_us": round(Ts * 1e6),
        "outputs": (
            LawOutput(name="theta_1", unit="rad", turning=True),
            LawOutput(name="alpha", unit="rad"),
        ),
        "reference": Reference(name="velocity", unit="rad/s", low=0.0, high=8.0),
        "A": rows(plant - L @ output),
        "B": rows(np.column_stack([np.zeros(5), Gamma, L])),
        "C": (0.0, *(-K).tolist(), -1.0),
        "D": 1 / RAD_S_PER_V + float(K[1]),
        "F": rows(output),
        "x0": (0.0,) * 5,
        **changes,
    }
    return ControlLaw(**fields)


def arm_monitor(Ts: float = 0.01, **changes: object) -> Monitor:
    """Return a monitor of the arm, with the observer of `arm_law`."""
    plant, output, Gamma, L = _observer(Ts)
    fields = {
        "A": rows(plant),
        "B": tuple(Gamma.tolist()),
        "C": rows(output),
        "L": rows(L),
        "x0": (0.0,) * 5,
        "deviations": (7e-3, 7e-3),
        "settling": (False, True),
        "prelude": 0,
        "forward": (1 / RAD_S_PER_V, 0.0),
        **changes,
    }
    return Monitor(**fields)


def _observer(Ts: float) -> tuple[NDArray[np.float64], ...]:
    """Return A, C, B and the predictor's gain L of the arm with a disturbance in V."""
    A, B, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, Ts)
    plant, output = np.eye(5), np.hstack([C, np.zeros((2, 1))])
    plant[:4, :4], plant[:4, 4:] = Phi, Gamma
    Q = np.diag([0.0, 0.0, 0.0, 0.0, 0.01**2])
    Q[:4, :4] += 0.1**2 * Gamma @ Gamma.T
    R = 3.5e-3**2 * np.eye(2)
    P = solve_discrete_are(plant.T, output.T, Q, R)
    L = plant @ P @ output.T @ np.linalg.inv(output @ P @ output.T + R)
    return plant, output, np.array([*Gamma[:, 0], 0.0]), L


def rows(matrix: NDArray[np.float64]) -> tuple[tuple[float, ...], ...]:
    """Return a matrix as a law has it."""
    return tuple(map(tuple, matrix.tolist()))
