"""Response of a sampled physical model with friction of the motor, and its derivatives.

Coulomb friction T_c acts on the motor against its motion. It is equivalent to a voltage V = T_c
R_m / (N K_m) at the motor's terminals. The model is linear during slip and linear during stick::

    slip    x(k+1) = Phi x + Gamma (u - s V),    s = sign of the speed
    stick   x(k+1) = P (Phi x + Gamma u),        P = I - Gamma e' / (e' Gamma)

e is the unit vector of the state that is the speed. During stick a friction of at most V keeps the
speed at 0. If the motor turns back within a step, s is the mean of both signs, weighted by their
durations.
"""

from __future__ import annotations

import numpy as np

from armrig.data.columns import Matrix, Vector
from armrig.numerics.recursion import recursion
from armrig.numerics.stretches import constant
from armrig.physics.grey_box.sampled_model import Sampled


def sensitivity(model: Sampled, u: Vector, x0: Vector, u0: float) -> Matrix:
    """Return the derivatives (N, d) of the output with respect to coordinates, without friction.

    With v = u - u0 the derivatives are outputs of the same model, driven by dPhi x + dGamma v.
    """
    v = u - u0
    x = recursion(model.Phi, v[:-1, None] * model.Gamma, x0)
    d = len(model.by)
    w = np.empty((u.size - 1, d, x0.size))
    for j, by in enumerate(model.by):
        w[:, j] = x[:-1] @ by.Phi.T + v[:-1, None] * by.Gamma
    S = recursion(model.Phi, w, np.zeros((d, x0.size))) @ model.C
    for j, by in enumerate(model.by):
        S[:, j] += x @ by.C + by.D * v
    return np.asarray(S)


def with_friction(
    model: Sampled, u: Vector, x0: Vector, V: float, speed: int
) -> tuple[Vector, Matrix]:
    """Return the output (N,) with Coulomb friction of V volts, and derivatives (N, d + n + 2).

    The derivatives are with respect to the d coordinates, the initial state, V and the input offset
    u0, which is subtracted from u.

    Slip and stick alternate. In an interval of slip or stick, the model is linear. The intervals
    are found step by step, and each interval is then differentiated as a whole. A step with a
    reversal is an interval by itself. During stick P Gamma = 0, so that an input offset has no
    effect.
    """
    x, frictions, intervals = _walk(model, u, x0, V, speed)
    n, d = x0.size, len(model.by)
    m = d + n + 2  # coordinates, initial state, V, u0
    S = np.zeros((u.size, m, n))
    S[0, d : d + n] = np.eye(n)
    P = np.eye(n) - np.outer(model.Gamma, np.eye(n)[speed]) / model.Gamma[speed]
    for a, b, s in intervals:
        w = np.zeros((b - a, m, n))
        drive = u[a:b] - frictions[a:b] if s else u[a:b]
        for j, by in enumerate(model.by):
            w[:, j] = x[a:b] @ by.Phi.T + drive[:, None] * by.Gamma
            if s == 0:
                w[:, j] = w[:, j] @ P.T - _held(model, by, x[a:b], u[a:b], speed)
        if s == REVERSAL:
            for k in range(a, b):
                S[k + 1] = _reversed(model, S[k], w[k - a], x[k], u[k], V, speed)
            continue
        w[:, -2] = -s * model.Gamma
        w[:, -1] = -abs(s) * model.Gamma
        S[a : b + 1] = recursion(model.Phi if s else P @ model.Phi, w, S[a])
        if s == 0:
            S[a + 1 : b + 1, :, speed] = 0.0  # the speed stays 0 during stick
    y = S @ model.C
    for j, by in enumerate(model.by):
        y[:, j] += x @ by.C + by.D * u
    y[:, -1] -= model.D
    return x @ model.C + model.D * u, y


def _held(model: Sampled, by: Sampled, x: Matrix, u: Vector, speed: int) -> Matrix:
    """Return the derivative of Gamma / (e' Gamma) times e' (Phi x + Gamma u), for each step."""
    g = model.Gamma[speed]
    change = by.Gamma / g - model.Gamma * by.Gamma[speed] / g**2
    needed = x @ model.Phi[speed] + u * g
    return np.outer(needed, change)


def _reversed(
    model: Sampled, S: Matrix, w: Matrix, x: Vector, u: float, V: float, speed: int
) -> Matrix:
    """Return the derivatives after a step in which the motor turns back."""
    # With the friction s V in the whole step, the speed v of sign s would become v'. The motor
    # turns back after the share f = v / (v - v'), so that the mean friction is s V (2 f - 1).
    row, gain, v = model.Phi[speed], model.Gamma[speed], x[speed]
    s = np.sign(v)
    ahead = row @ x + gain * (u - s * V)
    by_ahead = S @ row + w[:, speed]
    # w contains the effect of the parameters with the mean friction; for v' the friction is s V.
    share = v / (v - ahead)
    for j, by in enumerate(model.by):
        by_ahead[j] += (2 * share - 2) * s * V * by.Gamma[speed]
    by_ahead[-2] -= s * gain
    by_ahead[-1] -= gain
    by_share = (v * by_ahead - ahead * S[:, speed]) / (v - ahead) ** 2
    by_drive = -2 * s * V * by_share
    by_drive[-2] -= s * (2 * share - 1)
    by_drive[-1] -= 1.0
    return np.asarray(S @ model.Phi.T + w + np.outer(by_drive, model.Gamma))


REVERSAL = 2
"""Value used instead of a sign for a step in which the motor turns back."""


def _walk(
    model: Sampled, u: Vector, x0: Vector, V: float, speed: int
) -> tuple[Matrix, Vector, list[tuple[int, int, int]]]:
    """Return the states (N, n), the friction of each step in volts, and the intervals of motion."""
    # An interval is its first step, its last step + 1, and its motion as returned by `_step`.
    # If a search tries a V below 0, the motor never sticks.
    alone = not np.delete(model.Phi[speed], speed).any()
    frictions, steps = (_braked_alone if alone else _braked)(model, u, x0, V, speed)
    signs = np.array(steps, dtype=np.int_)
    # For known friction the model is linear, and all states are computed at once.
    x = recursion(model.Phi, (u[:-1] - frictions)[:, None] * model.Gamma, x0)
    x[1:][signs == 0, speed] = 0.0
    return x, frictions, [(s.start, s.stop, int(signs[s.start])) for s in constant(signs)]


def _step(v: float, ahead: float, pull: float, V: float, gain: float) -> tuple[float, int]:
    """Return the friction in volts, and the sign of the speed v, 0 during stick, or REVERSAL."""
    # `ahead` is the speed after the step without friction, `pull` the voltage at standstill.
    if v == 0.0:
        if abs(pull) <= V:
            return ahead / gain, 0
        sign = 1 if pull > 0 else -1
        return sign * V, sign
    sign = 1 if v > 0 else -1
    end = ahead - gain * sign * V
    if end * sign > 0:
        return sign * V, sign
    if abs(pull) <= V:
        return ahead / gain, 0
    return sign * V * (2 * v / (v - end) - 1), REVERSAL


def _braked_alone(
    model: Sampled, u: Vector, x0: Vector, V: float, speed: int
) -> tuple[Vector, list[int]]:
    """Return friction and motion of each step if no other state acts on the speed."""
    pole, gain, v = float(model.Phi[speed, speed]), float(model.Gamma[speed]), float(x0[speed])
    frictions, signs = [], []
    for value in u[:-1].tolist():
        friction, sign = _step(v, pole * v + gain * value, value, V, gain)
        v = pole * v + gain * (value - friction) if sign else 0.0
        frictions.append(friction)
        signs.append(sign)
    return np.array(frictions), signs


def _braked(
    model: Sampled, u: Vector, x0: Vector, V: float, speed: int
) -> tuple[Vector, list[int]]:
    """Return friction in volts and motion of each step, computed with `_step`."""
    rows = [tuple(map(float, row)) for row in model.Phi]
    gamma = [float(g) for g in model.Gamma]
    pole, gain = rows[speed][speed], gamma[speed]
    x = list(map(float, x0))
    frictions, signs = [], []
    n = range(len(x))
    for value in u[:-1].tolist():
        v = x[speed]
        x = [sum(row[j] * x[j] for j in n) + g * value for row, g in zip(rows, gamma, strict=True)]
        friction, sign = _step(v, x[speed], (x[speed] - pole * v) / gain, V, gain)
        x = [a - g * friction for a, g in zip(x, gamma, strict=True)]
        if sign == 0:
            x[speed] = 0.0
        frictions.append(friction)
        signs.append(sign)
    return np.array(frictions), signs
