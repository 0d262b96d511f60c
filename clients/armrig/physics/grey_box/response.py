"""The answer of a sampled physical model and its derivatives, friction of the chassis included.

Coulomb friction T_c acts on the chassis against its motion, and so does, at the motor's terminals,
the voltage V = T_c R_m / (N K_m). Between a stop and the next reversal the model is linear::

    slip    x(k+1) = Phi x + Gamma (u - s V),    s = sign of the speed
    stick   x(k+1) = P (Phi x + Gamma u),        P = I - Gamma e' / (e' Gamma)

with e the speed's unit vector: the friction is then whatever keeps the speed at 0, up to V.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.recursion import recursion
from armrig.numerics.stretches import constant
from armrig.physics.grey_box.sampled_model import Derivative, Sampled

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """One experiment as a model at given parameters sees it."""

    y: Vector
    """Output (N,)."""
    by_parameters: Matrix
    """Derivatives by the coordinates, (N, d)."""
    by_initial: Matrix
    """Derivatives by the initial state, (N, n)."""
    by_friction: Vector
    """Derivative by the voltage V of the Coulomb friction, (N,)."""


def linear_parts(model: Sampled, u: Vector) -> tuple[Vector, Matrix]:
    """Return the output (N,) from rest, and what it is linear in, (N, n + 1).

    The columns are the answers to each initial state and to an input offset of 1 (u0, subtracted).
    """
    n, N = model.Phi.shape[0], u.size
    w = np.zeros((N - 1, n + 2, n))
    w[:, 0] = u[:-1, None] * model.Gamma
    w[:, -1] = -model.Gamma
    x0 = np.zeros((n + 2, n))
    x0[1 : n + 1] = np.eye(n)
    y = recursion(model.Phi, w, x0) @ model.C
    y[:, 0] += model.D * u
    y[:, -1] -= model.D
    return y[:, 0], y[:, 1:]


def sensitivity(model: Sampled, u: Vector, x0: Vector, u0: float) -> Matrix:
    """Return the derivatives (N, d) of the output by the coordinates, frictionless.

    With v = u - u0 they are outputs of the model itself, driven by dPhi x + dGamma v.
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


def with_friction(model: Sampled, u: Vector, x0: Vector, V: float, speed: int) -> Response:
    """Return the answer with Coulomb friction of V volts, and all its derivatives.

    Stretches of slip and of stick follow each other, each linear, found step by step and then
    differentiated as a whole. That the moments of stopping move with the parameters is of second
    order: the speed is 0 on both sides of them.
    """
    x, stretches = _walk(model, u, x0, V, speed)
    n, d = x0.size, len(model.by)
    m = d + n + 1  # coordinates, initial state, V
    S = np.zeros((u.size, m, n))
    S[0, d : d + n] = np.eye(n)
    P = np.eye(n) - np.outer(model.Gamma, np.eye(n)[speed]) / model.Gamma[speed]
    for a, b, s in stretches:
        w = np.zeros((b - a, m, n))
        drive = u[a:b] - s * V
        for j, by in enumerate(model.by):
            w[:, j] = x[a:b] @ by.Phi.T + drive[:, None] * by.Gamma
            if s == 0:
                w[:, j] = w[:, j] @ P.T - _held(model, by, x[a:b], u[a:b], speed)
        w[:, -1] = -s * model.Gamma
        S[a : b + 1] = recursion(model.Phi if s else P @ model.Phi, w, S[a])
        if s == 0:
            S[a + 1 : b + 1, :, speed] = 0.0  # but for rounding it is
    y = S @ model.C
    for j, by in enumerate(model.by):
        y[:, j] += x @ by.C + by.D * u
    return Response(
        y=x @ model.C + model.D * u,
        by_parameters=y[:, :d],
        by_initial=y[:, d : d + n],
        by_friction=y[:, -1],
    )


def _held(model: Sampled, by: Derivative, x: Matrix, u: Vector, speed: int) -> Matrix:
    """Return what the change of the direction Gamma / (e' Gamma) adds while the chassis sticks."""
    g = model.Gamma[speed]
    change = by.Gamma / g - model.Gamma * by.Gamma[speed] / g**2
    needed = x @ model.Phi[speed] + u * g
    return np.outer(needed, change)


def _walk(
    model: Sampled, u: Vector, x0: Vector, V: float, speed: int
) -> tuple[Matrix, list[tuple[int, int, int]]]:
    """Return x (N, n) and the stretches (first, last + 1, sign), sign 0 where the chassis sticks.

    The friction of a step is what would bring the speed to 0 at its end, at most V either way.
    A V below 0, which a search may try, never sticks.
    """
    alone = not np.delete(model.Phi[speed], speed).any()
    frictions, steps = (_braked_alone if alone else _braked)(model, u, x0, V, speed)
    signs = np.array(steps, dtype=np.int_)
    # With the friction known the model is linear, and all of its states come at once.
    x = recursion(model.Phi, (u[:-1] - frictions)[:, None] * model.Gamma, x0)
    x[1:][signs == 0, speed] = 0.0
    return x, [(s.start, s.stop, int(signs[s.start])) for s in constant(signs)]


def _braked_alone(
    model: Sampled, u: Vector, x0: Vector, V: float, speed: int
) -> tuple[Vector, list[int]]:
    """Return friction and sign of each step where no other state acts on the speed."""
    pole, gain, v = float(model.Phi[speed, speed]), float(model.Gamma[speed]), float(x0[speed])
    frictions, signs = [], []
    for value in u[:-1].tolist():
        needed = pole * v / gain + value
        if abs(needed) <= V:
            v, friction, sign = 0.0, needed, 0
        else:
            sign = 1 if needed > 0 else -1
            friction = sign * V
            v = gain * (needed - friction)
        frictions.append(friction)
        signs.append(sign)
    return np.array(frictions), signs


def _braked(
    model: Sampled, u: Vector, x0: Vector, V: float, speed: int
) -> tuple[Vector, list[int]]:
    """Return friction and sign of each step."""
    rows = [tuple(map(float, row)) for row in model.Phi]
    gamma = [float(g) for g in model.Gamma]
    x = list(map(float, x0))
    frictions, signs = [], []
    n = range(len(x))
    for value in u[:-1].tolist():
        x = [sum(row[j] * x[j] for j in n) + g * value for row, g in zip(rows, gamma, strict=True)]
        needed = x[speed] / gamma[speed]
        sign = 0 if abs(needed) <= V else 1 if needed > 0 else -1
        friction = sign * V if sign else needed
        x = [a - g * friction for a, g in zip(x, gamma, strict=True)]
        if sign == 0:
            x[speed] = 0.0
        frictions.append(friction)
        signs.append(sign)
    return np.array(frictions), signs
