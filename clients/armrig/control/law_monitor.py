"""Monitor of a law: a Kalman predictor of the plant and of a disturbance of its input in V.

With the disturbance d as the last state, the predictor is ::

    x[k+1] = A x[k] + B Δu[k-d] + L e[k],    e[k] = y[k] - C x[k],    S = C P C' + R

P is the stationary covariance of x, and R that of the readings. The deviations of a monitor are
the roots of the diagonal of S.

References
----------
.. [1] K. J. Åström, B. Wittenmark, *Computer-Controlled Systems*, 3rd ed., 1997, section 11.3.
"""

from __future__ import annotations

from math import ceil

import numpy as np
from armrig_core.control.control_law import MAX_DELAY, Monitor
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from armrig.control.loop import LawMatrices, close_loop, plant_response
from armrig.control.plant import DesignModel, Plant
from armrig.models.state_space import Matrix, StateSpace, Vector
from armrig.numerics.quantities import plural

INPUT_NOISE = 0.02
"""Deviation of the input's noise, as a share of the range of the input."""
DRIFT = 0.002
"""Deviation of the drift of the disturbance in a sample, as a share of the range of the input."""
_MONITOR_NOISE = 0.1
"""The same of a monitor: it is the error of a model whose parameters are known to 5 %.

With 2 %, steps of the speed stopped 3 of 100 arms without a fault, and with 10 % 1 of 500. A stuck
angle was seen as early. With 15 %, it was seen later at 1 rad/s.
"""
_MOST_RESONANCE = 2.0
"""Largest response of an output, in steady gains, whose simulation is compared.

The simulation of an oscillation is soon out of phase, by small errors of its frequency.
"""
_OSCILLATION = 1.5
"""Factor of the deviation of an oscillating output, for such errors."""
_LEAST_NOISE = 1e-6
"""Least deviation of a measurement, as a share of the change of y by the range of the input."""
_PRELUDE_S, _PRELUDE_SAMPLES = 0.5, 50
"""Shortest prelude, in s and in samples."""
_BLIND_S, _BLIND_SAMPLES, _MORE_S = 0.2, 10, 0.1
"""Time in which a run without valid outputs ends: the first, or the second and third."""
_NEAR_ONE = 1 + 1e-6j
"""Point z of a steady gain, near 1: a loop may have a mode at 1 that is not fed back."""
_UNSEEN = 1e-9
"""Smallest singular value, as a share of the largest, of a disturbance that the outputs show."""
_FREQUENCIES = 4096


def monitor_of(design: DesignModel, law: LawMatrices) -> Monitor:
    """Return the monitor of the outputs of a law; the law's own observer does not change it."""
    rows = [*law.outputs]
    plant = _observable_part(design.plant, rows)
    if plant.delay > MAX_DELAY:
        raise InputError(
            f"the model has {plural(plant.delay, 'sample')} of dead time; a law allows "
            f"{MAX_DELAY}: design it with a longer Ts"
        )
    A, C = with_disturbance(plant)
    span = design.hi - design.lo
    noise = design.reading_noise[np.ix_(rows, rows)]
    L, S = kalman_predictor(plant, noise, span, input_noise=_MONITOR_NOISE * span)
    variances = S.diagonal()
    if design.noise_model is not None and design.noise_model.K.any():
        N = _covariance_of_noise(A - L @ C, L, C, design.noise_model, design.noise, rows)
        variances = np.maximum(variances, N.diagonal())
    integrates = plant.C[:, : int(plant.integrator)].any(axis=1)
    settles = ~integrates & ~_oscillates(plant) & design.is_stable
    wide = np.where(integrates | settles, 1.0, _OSCILLATION)
    return Monitor(
        A=rows_of(A),
        B=(*plant.B.tolist(), 0.0),
        C=rows_of(C),
        L=rows_of(L),
        x0=(*rest_state(design, plant).tolist(), 0.0),
        u0=design.u0,
        deviations=tuple((wide * np.sqrt(variances)).tolist()),
        settling=tuple(settles.tolist()),
        input_delay=plant.delay,
        prelude=max(ceil(_PRELUDE_S / design.Ts), _PRELUDE_SAMPLES),
        forward=(_steady_gain(law, design.plant), design.u0),
    )


def most_blind(Ts: float) -> int:
    """Return the number of samples without a valid output after which a run ends.

    One more sample passes until the device latches the rest.
    """
    return int(max(_BLIND_S / Ts, _BLIND_SAMPLES + _MORE_S / Ts) + 1e-9) - 1


def kalman_predictor(
    plant: Plant,
    noise: Matrix,
    span: float,
    *,
    input_noise: float | None = None,
    drift: float | None = None,
) -> tuple[Matrix, Matrix]:
    """Return the gain L (n + 1, ny) and the covariance S (ny, ny) of the innovations.

    `noise` is the covariance of the readings, and `span` the range of the input in V. The default
    deviations of the input's noise and of the drift are shares of `span`.
    """
    import control

    n, (A, C) = plant.order, with_disturbance(plant)
    G = np.zeros((n + 1, 2))
    G[:n, 0], G[n, 1] = plant.B, 1.0
    deviations = (
        INPUT_NOISE * span if input_noise is None else input_noise,
        DRIFT * span if drift is None else drift,
    )
    least = np.diag((_LEAST_NOISE * span * np.abs(plant.C @ np.abs(plant.B))) ** 2)
    # In deviations of the noise: the units of the outputs do not matter.
    by = np.sqrt((noise + least).diagonal())
    by = np.where(by > 0, by, 1.0)
    R, Q, C = (noise + least) / np.outer(by, by), np.diag(np.square(deviations)), C / by[:, None]
    sizes = np.linalg.svd(np.block([[A - np.eye(n + 1)], [C]]), compute_uv=False)
    if sizes[-1] > _UNSEEN * sizes[0]:
        L, P, _ = control.dlqe(A, G, C, Q, R)
    else:  # a constant input does not change these outputs, so that they do not show d
        L, P, _ = control.dlqe(A[:n, :n], G[:n, :1], C[:, :n], Q[:1, :1], R)
        L, P = np.vstack([L, np.zeros((1, len(R)))]), block_diag(P, 0.0)
    return np.asarray(L / by), np.asarray(np.outer(by, by) * (C @ P @ C.T + R))


def with_disturbance(plant: Plant) -> tuple[Matrix, Matrix]:
    """Return A and C of the plant with a constant disturbance of its input as last state."""
    n = plant.order
    A = np.block([[plant.A, plant.B[:, None]], [np.zeros((1, n)), np.ones((1, 1))]])
    return A, np.hstack([plant.C, np.zeros((len(plant.C), 1))])


def rest_state(design: DesignModel, plant: Plant) -> Vector:
    """Return the state of a plant at rest, (n,)."""
    if plant.integrator:
        return np.zeros(plant.order)
    change = plant.B * (design.rest - design.u0)
    return np.asarray(np.linalg.solve(np.eye(plant.order) - plant.A, change), np.float64)


def rows_of(M: ArrayLike) -> tuple[tuple[float, ...], ...]:
    """Return the rows of a matrix as numbers of Python."""
    return tuple(map(tuple, np.asarray(M, np.float64).tolist()))


def _observable_part(plant: Plant, rows: list[int]) -> Plant:
    """Return the plant with some outputs, without an integrator that none of them shows."""
    C = plant.C[rows]
    first = int(plant.integrator and not C[:, 0].any())
    return Plant(
        A=plant.A[first:, first:],
        B=plant.B[first:],
        C=C[:, first:],
        delay=plant.delay,
        integrator=plant.integrator and not first,
    )


def _oscillates(plant: Plant) -> NDArray[np.bool_]:
    """Return whether each output, without an integrator, has a resonance or no steady gain."""
    first = int(plant.integrator)
    A, B, C = plant.A[first:, first:], plant.B[first:], plant.C[:, first:]
    poles = np.linalg.eigvals(A)
    angles = np.angle(poles[(poles.imag > 0) & (np.abs(poles) < 1)])
    omega = np.append(np.geomspace(1e-4, np.pi, _FREQUENCIES // 8), angles)
    response = np.abs(plant_response(Plant(A=A, B=B, C=C), np.exp(1j * omega)))
    return np.asarray(response.max(axis=0) > _MOST_RESONANCE * response[0])


def _steady_gain(law: LawMatrices, plant: Plant) -> float:
    """Return the voltage that the closed loop holds at r = 1, in V."""
    loop = close_loop(law, [plant])
    M, N = loop.M[0], loop.N[0]
    x = np.linalg.solve(_NEAR_ONE * np.eye(len(M)) - M, N)
    return float(loop.row @ x.real) + loop.D


def _covariance_of_noise(
    M: Matrix, L: Matrix, C: Matrix, model: StateSpace, covariance: Matrix, rows: list[int]
) -> Matrix:
    """Return the covariance of the innovations by noise of the model's own spectrum."""
    z = np.exp(1j * np.pi * (np.arange(_FREQUENCIES) + 0.5) / _FREQUENCIES)[:, None, None]
    H = np.eye(len(covariance)) + model.C @ np.linalg.solve(
        z * np.eye(model.order) - model.A, np.broadcast_to(model.K, (z.size, *model.K.shape))
    )
    F = np.eye(len(rows)) - C @ np.linalg.solve(
        z * np.eye(len(M)) - M, np.broadcast_to(L, (z.size, *L.shape))
    )
    N = F @ H[:, rows]
    return np.asarray((N @ covariance @ N.conj().swapaxes(1, 2)).real.mean(axis=0))
