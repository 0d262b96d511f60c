"""The rig's physics as python-control systems, and as a sampled model from voltage to angle."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.commands.rehearsal import rehearse as rehearse
from armrig_core.process.calls import with_argument_checks
from armrig_core.rig.arm import ArmParameters as ArmParameters
from armrig_core.rig.arm import arm_matrices, chassis_matrices, zero_order_hold
from armrig_core.rig.calibration import ALPHA, THETA_1

from armrig.data.argument import as_dataset
from armrig.data.columns import Matrix
from armrig.data.dataset import Dataset, Vector
from armrig.models.fit import Fit

if TYPE_CHECKING:
    import control


CAUSES = {
    "gain": "on the rig it depends on the motor and its supply: 1/(N K_m) without friction, and "
    "less with friction; inertias and spring have no effect",
    "resonance": "it depends on both inertias, the spring and the motor's damping",
    "antiresonance": "on the rig it is sqrt(K_lin/J_2), the frequency of the arm alone on its "
    "spring; chassis and motor have no effect",
    "bandwidth": "at the anti-resonance |G| is below −3 dB, so K_lin/J_2 affects the bandwidth "
    "most",
    "rise_time": "J_1 R_m / (N K_m)² determines the first rise, before the spring is wound",
    "equivalent_time": "on the rig it is (J_1 + J_2) R_m / (N K_m)²; the spring has no effect",
    "slowest_time": "the motor's damping stops the swing of the arm; with a heavier chassis this "
    "takes longer",
    "overshoot": "the spring returns its energy; J_2/J_1 and the motor's damping set the amount",
}
"""Causes of a characteristic of the arm, by the name of the characteristic."""
SPEED = f"{THETA_1}_rate"
"""State that is the speed of the motor."""
HANDOUT = "handout"
"""Name of the handout's parameters in tables and figures."""


def beside_the_handout(p: ArmParameters) -> dict[str, ArmParameters]:
    """Return the cases that assignment 2.3 compares, by name.

    The first case contains the handout's parameters. Each further case changes one parameter to its
    value in `p`. If `p` changes several parameters, the last case is `p`.
    """
    handout = ArmParameters()
    changed = {f.name: getattr(p, f.name) for f in fields(p)}
    changed = {name: value for name, value in changed.items() if value != getattr(handout, name)}
    cases = {HANDOUT: handout}
    cases |= {f"{n}={value:g}": replace(handout, **{n: value}) for n, value in changed.items()}
    if len(changed) > 1:
        cases["both" if len(changed) == 2 else "all"] = p
    return cases


@with_argument_checks
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
    >>> system = armrig.physics.arm(armrig.physics.ArmParameters())
    >>> system.input_labels, system.output_labels
    (['u'], ['theta_1', 'alpha'])
    >>> sorted(abs(system.poles()).round(1).tolist())
    [0.0, 18.9, 18.9, 36.7]
    """
    import control

    A, B, C = arm_matrices(p)
    states = [THETA_1, ALPHA, f"{THETA_1}_rate", f"{ALPHA}_rate"]
    return control.ss(A, B, C, 0, inputs=["u"], outputs=[THETA_1, ALPHA], states=states, name="arm")


@with_argument_checks
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
    >>> system = armrig.physics.chassis(armrig.physics.ArmParameters())
    >>> system.state_labels
    ['theta_1', 'theta_1_rate']
    >>> sorted(abs(system.poles()).round(1).tolist())
    [0.0, 52.8]
    """
    import control

    A, B, C = chassis_matrices(p)
    states = [THETA_1, f"{THETA_1}_rate"]
    return control.ss(A, B, C, 0, inputs=["u"], outputs=[THETA_1], states=states, name="chassis")


@with_argument_checks
def physical_model(p: ArmParameters, data: Dataset) -> Fit:
    """Return the physical model of the whole arm from u to the output of the data.

    If the output of the data is alpha, the model is from u to alpha and has no integrator. For all
    other data the model is from u to theta_1. The model is sampled exactly for an input held over
    Ts, see `transfer`. Its standard deviations are 0, because nothing is estimated.

    Examples
    --------
    >>> import armrig
    >>> data = armrig.example_recording().dataset("theta_1")
    >>> physics = armrig.physics.physical_model(armrig.physics.ArmParameters(), data)
    >>> print(armrig.compare(data, physics))
    simulation; initial state and input offset estimated from these data by least squares
      physics  fit   99.99 %  rms 0.0035... rad  velocity fit   83.4... %
    """
    A, B, C = arm_matrices(p)
    data = as_dataset(data)
    integrator = data.output != ALPHA
    # theta_1, the first state, acts on no other state: the model of alpha needs only the others.
    first = int(not integrator)
    c = C[0] if integrator else C[1, 1:]
    numerator, denominator = transfer(A[first:, first:], B[first:], c, data.Ts)
    return Fit.of_channel(
        structure="physics",
        B=numerator,
        F=denominator,
        nk=1,
        integrator=integrator,
        Ts=data.Ts,
        output=data.output,
        unit=data.unit,
        input_unit=data.input_unit,
    )


def transfer(A: Matrix, B: Matrix, c: Vector, Ts: float) -> tuple[Vector, Vector]:
    """Return B(q) and F(q) of the exactly sampled model from a held input u to y = c x.

    The system is x' = A x + B u with A (n, n), B (n, 1) and the row c (n,) of the output; Ts is in
    s. F is the characteristic polynomial of Phi = exp(A Ts). B consists of the first n + 1
    coefficients of the product of F and the pulse response 0, c Gamma, c Phi Gamma, …. Both are
    coefficients in q^-1, (n + 1,): B begins with 0, F with 1.
    """
    Phi, Gamma = zero_order_hold(A, B, Ts)
    F = np.real(np.poly(Phi))
    pulse, x = [0.0], Gamma[:, 0]
    for _ in range(Phi.shape[0]):
        pulse.append(float(c @ x))
        x = Phi @ x
    # scipy's ss2tf computes B as a difference of two characteristic polynomials. At 1 kHz B is
    # small compared with F, and the difference loses five digits.
    return np.convolve(pulse, F)[: F.size], F
