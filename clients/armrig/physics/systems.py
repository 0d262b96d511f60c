"""The rig's physics as python-control systems with named signals."""

from __future__ import annotations

from typing import TYPE_CHECKING

from armrig_core.arm import ArmParameters, arm_matrices, chassis_matrices
from armrig_core.calls import checked_call
from armrig_core.rehearsal import rehearse

if TYPE_CHECKING:
    import control

__all__ = ["ArmParameters", "arm", "chassis", "rehearse"]


@checked_call
def arm(p: ArmParameters) -> control.StateSpace:
    """Return the whole rig as a state space, in continuous time.

    Parameters
    ----------
    p : ArmParameters
        Inertias, spring and motor, in SI units; `ArmParameters()` is the handout's.

    Returns
    -------
    control.StateSpace
        Input u in V; outputs theta_1 and alpha in rad; states these two and their rates in rad/s.
    """
    import control

    A, B, C = arm_matrices(p)
    states = ["theta_1", "alpha", "theta_1_rate", "alpha_rate"]
    return control.ss(
        A, B, C, 0, inputs=["u"], outputs=["theta_1", "alpha"], states=states, name="arm"
    )


@checked_call
def chassis(p: ArmParameters) -> control.StateSpace:
    """Return the rig without its rotating part (handout, figure 6), in continuous time.

    Parameters
    ----------
    p : ArmParameters
        Inertia of the chassis and motor, in SI units; `ArmParameters()` is the handout's.

    Returns
    -------
    control.StateSpace
        Input u in V; output theta_1 in rad; states theta_1 and its rate in rad/s.
    """
    import control

    A, B, C = chassis_matrices(p)
    states = ["theta_1", "theta_1_rate"]
    return control.ss(A, B, C, 0, inputs=["u"], outputs=["theta_1"], states=states, name="chassis")
