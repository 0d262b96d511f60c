"""The rig's physics as python-control systems with named signals."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING

from armrig_core.arm import ArmParameters, arm_matrices, chassis_matrices
from armrig_core.calls import checked_call
from armrig_core.rehearsal import rehearse
from armrig_core.telemetry import ALPHA, THETA_1

if TYPE_CHECKING:
    import control

__all__ = ["ArmParameters", "arm", "beside_the_handout", "chassis", "rehearse"]

HANDOUT = "handout"
"""Name of the handout's parameters in tables and figures."""


def beside_the_handout(p: ArmParameters) -> dict[str, ArmParameters]:
    """Return the cases that assignment 2.3 compares, by name.

    The first case contains the handout's parameters. Each further case changes one parameter to its
    value in `p`. If `p` changes several parameters, the last case is `p`.
    """
    own = ArmParameters()
    changed = {f.name: getattr(p, f.name) for f in fields(p)}
    changed = {name: value for name, value in changed.items() if value != getattr(own, name)}
    cases = {HANDOUT: own}
    cases |= {f"{n}={value:g}": replace(own, **{n: value}) for n, value in changed.items()}
    if len(changed) > 1:
        cases["both" if len(changed) == 2 else "all"] = p
    return cases


@checked_call
def arm(p: ArmParameters) -> control.StateSpace:
    """Return the whole rig as a state space, in continuous time.

    Parameters
    ----------
    p : ArmParameters
        Inertias, spring and motor, in SI units; `ArmParameters()` contains the handout's values.

    Returns
    -------
    control.StateSpace
        Input u in V; outputs theta_1 and alpha in rad; states theta_1, alpha and their rates in
        rad/s.

    Examples
    --------
    >>> import armrig
    >>> system = armrig.arm(armrig.ArmParameters())
    >>> system.input_labels, system.output_labels
    (['u'], ['theta_1', 'alpha'])
    >>> sorted(abs(system.poles()).round(1).tolist())
    [0.0, 18.9, 18.9, 36.7]
    """
    import control

    A, B, C = arm_matrices(p)
    states = [THETA_1, ALPHA, f"{THETA_1}_rate", f"{ALPHA}_rate"]
    return control.ss(A, B, C, 0, inputs=["u"], outputs=[THETA_1, ALPHA], states=states, name="arm")


@checked_call
def chassis(p: ArmParameters) -> control.StateSpace:
    """Return the rig without its rotating part (handout, figure 6), in continuous time.

    Parameters
    ----------
    p : ArmParameters
        Inertia of the chassis and motor, in SI units; `ArmParameters()` contains the handout's
        values.

    Returns
    -------
    control.StateSpace
        Input u in V; output theta_1 in rad; states theta_1 and its rate in rad/s.

    Examples
    --------
    >>> import armrig
    >>> system = armrig.chassis(armrig.ArmParameters())
    >>> system.state_labels
    ['theta_1', 'theta_1_rate']
    >>> sorted(abs(system.poles()).round(1).tolist())
    [0.0, 52.8]
    """
    import control

    A, B, C = chassis_matrices(p)
    states = [THETA_1, f"{THETA_1}_rate"]
    return control.ss(A, B, C, 0, inputs=["u"], outputs=[THETA_1], states=states, name="chassis")
