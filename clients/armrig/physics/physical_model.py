"""Physical model of the whole arm, from voltage to angle, with given parameters."""

from __future__ import annotations

import numpy as np
from armrig_core.arm import ArmParameters, arm_matrices, zero_order_hold
from armrig_core.calls import checked_call
from armrig_core.telemetry import ALPHA
from numpy.typing import NDArray

from armrig.data.argument import as_dataset
from armrig.data.dataset import Dataset, Vector
from armrig.models.fit import Fit

Matrix = NDArray[np.float64]


@checked_call
def physical_model(p: ArmParameters, data: Dataset) -> Fit:
    """Return the physical model of the whole arm from u to the output of the data.

    If the output of the data is alpha, the model is from u to alpha and has no integrator. For all
    other data the model is from u to theta_1. The model is sampled exactly for an input held over
    Ts, see `transfer`. Its standard deviations are 0, because nothing is estimated.

    Examples
    --------
    >>> import armrig
    >>> data = armrig.example_recording().dataset("theta_1")
    >>> physics = armrig.physical_model(armrig.ArmParameters(), data)
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

    F is the characteristic polynomial of Phi = exp(A Ts). B consists of the first n + 1
    coefficients of the product of F and the pulse response 0, c Gamma, c Phi Gamma, ….

    Parameters
    ----------
    A : ndarray (n, n)
        Matrix of x' = A x + B u.
    B : ndarray (n, 1)
        Input matrix of the same equation.
    c : ndarray (n,)
        Row of the output; there is no direct term.
    Ts : float
        Sampling time in s.

    Returns
    -------
    (ndarray, ndarray)
        Coefficients in q^-1, both (n + 1,): B begins with 0, F with 1.
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
