"""The dynamics of the arm on its chassis, as matrices with the handout's values.

The model has two inertias, joined by a spring. A motor drives the first inertia, the chassis,
through a gear. The inductance of the motor is neglected::

    J_1 theta_1'' = N K_m (u - N K_m theta_1') / R_m + K_lin alpha - b_1 theta_1'
    J_2 (theta_1'' + alpha'') = -K_lin alpha

theta_1 is the angle of the chassis relative to the base, and alpha the angle of the arm relative to
the chassis.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import isfinite
from numbers import Real

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from armrig_core.errors import InputError, InputTypeError
from armrig_core.process.calls import with_constructor_checks

Matrix = NDArray[np.float64]


@with_constructor_checks
@dataclass(frozen=True, slots=True, kw_only=True)
class ArmParameters:
    """Parameters of the rig; the defaults are the values of the handout (assignment 2.2).

    Examples
    --------
    >>> import armrig
    >>> for J_1 in (0.0017, 0.0020):
    ...     found = armrig.physics.characteristics(armrig.physics.ArmParameters(J_1=J_1))
    ...     print(f"J_1 {J_1}: initial slope {found.initial_slope:.1f} rad/s² per V")
    J_1 0.0017: initial slope 98.4 rad/s² per V
    J_1 0.002: initial slope 83.6 rad/s² per V
    """

    J_1: float = 1.7e-3
    """Inertia of motor, gear and chassis, seen at the chassis, in kg m²."""
    J_2: float = 4.8e-3
    """Inertia of the arm, in kg m²."""
    N: float = 64.0
    """Gear ratio, motor turns for one turn of the chassis."""
    K_lin: float = 1.19
    """Stiffness of the two springs together, in Nm/rad."""
    R_m: float = 3.21
    """Resistance of the armature, in Ω."""
    K_m: float = 8.39e-3
    """Torque constant, in Nm/A, and back-EMF constant, in Vs/rad."""
    b_1: float = 0.0
    """Viscous friction of the chassis, in Nms/rad; the handout neglects it."""

    def __post_init__(self) -> None:
        """Refuse values that no rig can have."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, Real):
                raise InputTypeError(f"{field.name}={value!r} must be a number, in SI units")
            if not isfinite(value) or value < 0 or (value == 0 and field.name != "b_1"):
                bound = ">= 0" if field.name == "b_1" else "> 0"
                raise InputError(f"{field.name}={value!r} must be finite and {bound}")

    @property
    def torque_per_volt(self) -> float:
        """Torque on the chassis per volt at standstill, N K_m / R_m, in Nm/V."""
        return self.N * self.K_m / self.R_m

    @property
    def damping(self) -> float:
        """Damping of the chassis by back-EMF and friction, (N K_m)² / R_m + b_1, in Nms/rad."""
        return (self.N * self.K_m) ** 2 / self.R_m + self.b_1


ARM_UNITS = {
    "J_1": "kg m²",
    "J_2": "kg m²",
    "N": "",
    "K_lin": "Nm/rad",
    "R_m": "Ω",
    "K_m": "Nm/A",
    "b_1": "Nms/rad",
}
"""Unit of each parameter."""


def require_parameters(p: object, name: str = "p") -> None:
    """Raise InputTypeError if `p` is not an `ArmParameters`; `name` is that of the argument."""
    if not isinstance(p, ArmParameters):
        raise InputTypeError(
            f"{name} is a {type(p).__name__}: give the rig's parameters, "
            "armrig.physics.ArmParameters(), or other values in SI units, "
            "armrig.physics.ArmParameters(J_1=0.0017)"
        )


def arm_matrices(p: ArmParameters) -> tuple[Matrix, Matrix, Matrix]:
    """Return A (4, 4), B (4, 1), C (2, 4) of the whole rig.

    States theta_1, alpha in rad and their rates in rad/s; input u in V; outputs theta_1, alpha.
    """
    require_parameters(p)
    A = np.zeros((4, 4))
    A[0, 2] = A[1, 3] = 1.0
    A[2] = [0.0, p.K_lin / p.J_1, -p.damping / p.J_1, 0.0]
    A[3] = -A[2]
    A[3, 1] -= p.K_lin / p.J_2
    B = np.array([[0.0], [0.0], [p.torque_per_volt / p.J_1], [-p.torque_per_volt / p.J_1]])
    C = np.eye(2, 4)
    return A, B, C


def chassis_matrices(p: ArmParameters) -> tuple[Matrix, Matrix, Matrix]:
    """Return A (2, 2), B (2, 1), C (1, 2) with the rotating part removed (handout, figure 6).

    States theta_1 in rad and its rate in rad/s; input u in V; output theta_1.
    """
    require_parameters(p)
    A = np.array([[0.0, 1.0], [0.0, -p.damping / p.J_1]])
    B = np.array([[0.0], [p.torque_per_volt / p.J_1]])
    C = np.array([[1.0, 0.0]])
    return A, B, C


def zero_order_hold(A: Matrix, B: Matrix, h: float) -> tuple[Matrix, Matrix]:
    """Return Phi (n, n) and Gamma (n, m): x(t + h) = Phi x(t) + Gamma u if u is constant for `h` s.

    Phi and Gamma are blocks of the exponential of [A B; 0 0] h. A need not be invertible.

    References
    ----------
    .. [1] C. F. Van Loan, "Computing integrals involving the matrix exponential",
       IEEE Trans. Automatic Control 23 (1978) 395-404.
    """
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n] = A * h
    block[:n, n:] = B * h
    both = expm(block)
    return both[:n, :n], both[:n, n:]
