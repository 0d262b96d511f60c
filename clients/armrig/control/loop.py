"""The loop of a law and a plant: its matrices, its response at the plant's input, and its margins.

The loop is opened at the plant's input. L(z) is minus the response from this input, through the
plant and the law, to the law's voltage: the loop is closed by 1 + L = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, pi, tau
from typing import Any

import numpy as np
from armrig_core.control.control_law import ControlLaw
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eig
from scipy.optimize import brentq, minimize_scalar

from armrig.control.plant import DesignModel, Plant
from armrig.models.state_space import Complex, Matrix, Vector

_PER_DECADE = 150
"""Frequencies of the grid in each decade."""
_LINEAR = 500
"""Frequencies of the grid that are equally spaced up to the Nyquist frequency."""
_ON_CIRCLE = 1e-7
"""Distance from 1 of a pole that counts as a mode on the unit circle."""
_HIDDEN = 1e-6
"""Share of a mode in the loop below which the mode is not fed back."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Margins:
    """Stability margins of a loop."""

    stable: bool
    """False if the closed loop is unstable; Ms is then infinite, and the margins are 0."""
    Ms: float
    """Largest sensitivity |1/(1 + L)|; 1/Ms is the distance of L from -1."""
    Ms_at: float
    """Frequency of Ms, in rad/s."""
    gain: float
    """Factor of the gain that makes the loop unstable, above 1; infinite if there is none."""
    gain_at: float
    """Frequency of the gain margin, in rad/s."""
    least_gain: float
    """Factor of the gain, below 1, that makes the loop unstable; 0 if there is none."""
    phase_deg: float
    """Phase margin, in degrees."""
    phase_at: float
    """Frequency of the phase margin, in rad/s."""
    delay_s: float
    """Additional dead time that makes the loop unstable, in s."""


UNSTABLE = Margins(
    stable=False,
    Ms=inf,
    Ms_at=0.0,
    gain=1.0,
    gain_at=0.0,
    least_gain=1.0,
    phase_deg=0.0,
    phase_at=0.0,
    delay_s=0.0,
)


@dataclass(frozen=True, slots=True, eq=False)
class LawMatrices:
    """A law with the outputs that it uses, as arrays."""

    A: Matrix
    B_r: Vector
    B_u: Vector
    B_y: Matrix
    C: Vector
    D: float
    delay: int
    outputs: tuple[int, ...]
    """Index of each output of the law among the outputs of the model."""

    @classmethod
    def of(cls, law: ControlLaw, outputs: Sequence[str]) -> LawMatrices:
        """Return the matrices of a law for a plant with these outputs."""
        missing = [o.name for o in law.outputs if o.name not in outputs]
        if missing:
            raise InputError(
                f"the law uses {', '.join(missing)}, and the model has {', '.join(outputs)}: give "
                "the model that the law was designed on"
            )
        used = [outputs.index(o.name) for o in law.outputs]
        return cls.of_arrays(law.A, law.B, law.C, law.D, law.input_delay, used)

    @classmethod
    def of_arrays(
        cls,
        A: ArrayLike,
        B: ArrayLike,
        C: ArrayLike,
        D: float,
        delay: int,
        outputs: Sequence[int],
    ) -> LawMatrices:
        """Return the matrices of a law from the fields of its file."""
        row = np.asarray(C, dtype=np.float64)
        columns = np.asarray(B, dtype=np.float64).reshape(row.size, 2 + len(outputs))
        return cls(
            np.asarray(A, dtype=np.float64).reshape(row.size, row.size),
            columns[:, 0],
            columns[:, 1],
            columns[:, 2:],
            row,
            D,
            delay,
            tuple(outputs),
        )

    def response(self, z: Complex) -> Complex:
        """Return the response (nf, ny) from y to v, with the law's own voltage as its input u."""
        n = self.C.size
        BC = self.B_u[:, None] * self.C
        pencil = z[:, None, None] * np.eye(n) - self.A - BC * z[:, None, None] ** -self.delay
        return np.asarray(
            self.C @ np.linalg.solve(pencil, np.broadcast_to(self.B_y, (z.size, *self.B_y.shape)))
        )


def plant_response(plant: Plant, z: Complex) -> Complex:
    """Return the response (nf, ny) of the plant."""
    n = plant.order
    x = np.linalg.solve(
        z[:, None, None] * np.eye(n) - plant.A, np.broadcast_to(plant.B[:, None], (z.size, n, 1))
    )
    return np.asarray((plant.C @ x)[..., 0] * z[:, None] ** -plant.delay)


def loop_response(law: LawMatrices, plants: Sequence[Plant], z: Complex) -> Complex:
    """Return L (m, nf) of each plant at points z."""
    K = law.response(z)
    return np.array(
        [-(K * plant_response(plant, z)[:, law.outputs]).sum(axis=1) for plant in plants]
    )


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoop:
    """Matrices of the closed loops of one law with m plants.

    The states are those of the plant, the last commands u[k-1], u[k-2] …, and those of the law::

        s[k+1] = M s[k] + N r[k],    v[k] = row s[k] + D r[k],    y[k] = C s[k]
    """

    M: NDArray[np.float64]
    """(m, S, S)."""
    N: NDArray[np.float64]
    """(m, S): column of r."""
    drive: NDArray[np.float64]
    """(m, S): column of a disturbance at the plant's input that the law does not see."""
    row: Vector
    """(S,): the law's voltage."""
    D: float
    C: NDArray[np.float64]
    """(m, ny, S): all outputs of the plant."""

    @property
    def poles(self) -> Complex:
        """Poles (m, S) of the closed loops."""
        return np.asarray(np.linalg.eigvals(self.M))


def close_loop(law: LawMatrices, plants: Sequence[Plant]) -> ClosedLoop:
    """Return the closed loops of a law with plants."""
    n, c = max(p.order for p in plants), law.C.size
    longest = max(law.delay, *(p.delay for p in plants))
    S = n + longest + c
    M, C = np.zeros((len(plants), S, S)), np.zeros((len(plants), plants[0].C.shape[0], S))
    N, drive = np.zeros((2, len(plants), S))
    row = np.zeros(S)
    row[n + longest :] = law.C
    chain = slice(n, n + longest)
    for i, plant in enumerate(plants):
        span = slice(0, plant.order)  # a dead time across a whole sample has one state less or more
        M[i, span, span] = plant.A
        if plant.delay:
            M[i, span, n + plant.delay - 1] = plant.B
        else:
            M[i, span] += plant.B[:, None] * row
            N[i, span] = plant.B * law.D
        drive[i, span] = plant.B
        C[i, :, span] = plant.C
    if longest:
        M[:, chain, chain] = np.eye(longest, k=-1)
        M[:, n] = row
        N[:, n] = law.D
    at = slice(n + longest, S)
    M[:, at, at] = law.A
    M[:, at] += law.B_y @ C[:, list(law.outputs)]
    N[:, at] = law.B_r
    if law.delay:
        M[:, at, n + law.delay - 1] += law.B_u
    else:
        M[:, at] += law.B_u[:, None] * row
        N[:, at] += law.B_u * law.D
    return ClosedLoop(M, N, drive, row, law.D, C)


def count_hidden_modes(loop: ClosedLoop) -> int:
    """Return the number of modes at 1 of the first loop that are not fed back.

    Control of a rate leaves the angle at exactly 1. Neither the law's voltage shows such a mode,
    nor does an unstable loop follow from it.
    """
    values, right = np.linalg.eig(loop.M[0])
    near = np.abs(values - 1) < _ON_CIRCLE
    seen = np.abs(loop.row @ right[:, near])
    return int(np.count_nonzero(seen < _HIDDEN * np.linalg.norm(loop.row)))


def are_stable(loop: ClosedLoop, hidden: int) -> NDArray[np.bool_]:
    """Return for each loop whether all modes that are fed back decay."""
    poles = loop.poles
    at_one = np.abs(poles - 1) < _ON_CIRCLE
    outside = (np.abs(poles) >= 1 - _ON_CIRCLE * 1e-3) & ~at_one
    return np.asarray(~outside.any(axis=1) & (at_one.sum(axis=1) <= hidden))


def frequency_grid(law: LawMatrices, plant: Plant, Ts: float) -> Vector:
    """Return frequencies in rad/s whose ends come from the poles and zeros of L.

    The lowest is a hundredth of the slowest pole or zero, or lower if |L| has not passed 1 there.
    The highest is the Nyquist frequency. Each lightly damped pole or zero has points of its own.
    """
    opened = close_loop(law, [plant])
    M = opened.M[0].copy()
    n = plant.order
    if plant.delay:  # without the path from the law to the plant
        M[:n, n + plant.delay - 1] = 0.0
    else:
        M[:n] -= plant.B[:, None] * opened.row
    pencil = np.block([[M, opened.drive[0][:, None]], [opened.row[None, :], np.zeros((1, 1))]])
    zeros = eig(pencil, np.diag(np.append(np.ones(M.shape[0]), 0.0)), right=False)
    with np.errstate(all="ignore"):
        features = np.concatenate([np.linalg.eigvals(M), zeros])
        features = features[np.isfinite(features) & (np.abs(features) > 1e-3)]
        s = np.log(features.astype(np.complex128)) / Ts
    s = s[(np.abs(s) > 1e-7 / Ts) & (np.abs(s) < pi / Ts)]
    highest = pi / Ts
    lowest = min(0.01 * float(np.abs(s).min(initial=highest)), 0.001 * highest)
    for _ in range(12):  # |L| has one slope below all poles and zeros
        L = np.abs(_L(law, plant, np.array([lowest, lowest / 2]), Ts))
        if not (L[0] < 1 < L[1] or 1.05 * L[0] < L[1] < 1):
            break
        lowest /= 10
    decades = np.log10(highest / lowest)
    w = [np.geomspace(lowest, highest, round(_PER_DECADE * decades))]
    linear = _LINEAR + 40 * max(plant.delay, law.delay)
    w.append(np.linspace(highest / linear, highest, linear))
    for root in s[(s.imag > 0) & (np.abs(s.real) < 0.3 * np.abs(s))]:
        w.append(abs(root.imag) + max(abs(root.real), 1e-6 * abs(root)) * np.linspace(-8, 8, 81))
    merged = np.unique(np.concatenate(w))
    return np.asarray(merged[(merged >= lowest) & (merged <= highest)])


def _L(law: LawMatrices, plant: Plant, omega: Vector, Ts: float) -> Complex:
    return np.asarray(loop_response(law, [plant], np.exp(1j * omega * Ts))[0])


def margins(law: LawMatrices, plant: Plant, Ts: float) -> Margins:
    """Return the margins of a loop, refined between the points of the grid to rounding."""
    loop = close_loop(law, [plant])
    if not are_stable(loop, count_hidden_modes(loop))[0]:
        return UNSTABLE
    w = frequency_grid(law, plant, Ts)
    L = _L(law, plant, w, Ts)

    def at(omega: float) -> complex:
        return complex(_L(law, plant, np.array([omega]), Ts)[0])

    distance = np.abs(1 + L)
    inner = (distance[1:-1] <= distance[:-2]) & (distance[1:-1] <= distance[2:])
    lows = [0, *(np.flatnonzero(inner) + 1), w.size - 1]
    candidates = [(float(distance[i]), float(w[i])) for i in lows]
    for i in sorted(lows, key=lambda i: distance[i])[:4]:
        a, b = w[max(i - 1, 0)], w[min(i + 1, w.size - 1)]
        best = minimize_scalar(
            lambda x: abs(1 + at(x)), bounds=(a, b), method="bounded", options={"xatol": 1e-10 * b}
        )
        candidates.append((float(best.fun), float(best.x)))
    nearest, Ms_at = min(candidates)
    gains = [(float(-1 / L[i].real), float(w[i])) for i in _real_ends(L)]
    for i in np.flatnonzero(np.diff(np.sign(L.imag)) != 0):
        if not (L[i].real < 0 or L[i + 1].real < 0) or L[i].imag == 0 or L[i + 1].imag == 0:
            continue
        x = float(brentq(lambda x: at(x).imag, w[i], w[i + 1], xtol=1e-14 * w[i], rtol=1e-14))
        if at(x).real < 0:
            gains.append((-1 / at(x).real, x))
    phases = []
    size = np.log(np.abs(L))
    for i in np.flatnonzero(np.diff(np.sign(size)) != 0):
        x = float(
            brentq(lambda x: np.log(abs(at(x))), w[i], w[i + 1], xtol=1e-14 * w[i], rtol=1e-14)
        )
        phases.append((float(np.angle(-at(x))), x))
    gain, gain_at = min((g for g in gains if g[0] > 1), default=(inf, 0.0))
    phase, phase_at = min(((abs(p), x) for p, x in phases), default=(inf, 0.0))
    return Margins(
        stable=True,
        Ms=1 / nearest,
        Ms_at=Ms_at,
        gain=float(gain),
        gain_at=gain_at,
        least_gain=float(max((g for g, _ in gains if g < 1), default=0.0)),
        phase_deg=float(np.degrees(phase)),
        phase_at=phase_at,
        delay_s=float(min(((p % tau) / x for p, x in phases), default=inf)),
    )


def _real_ends(L: Complex) -> list[int]:
    """Return the index of the Nyquist frequency if L is negative there: L is real at z = -1."""
    return [L.size - 1] if L[-1].real < 0 and abs(L[-1].imag) < 1e-6 * abs(L[-1]) else []


def margins_of_draws(L: Complex, stable: NDArray[np.bool_], w: Vector) -> dict[str, NDArray[Any]]:
    """Return Ms, gain, phase_deg, delay_s and stable of loops L (m, nf), interpolated on the grid.

    The errors of the interpolation are below 1e-3 of the values.
    """
    values = {"Ms": _largest(1 / np.abs(1 + L), np.log(w))}
    values |= {name: np.full(len(L), inf) for name in ("gain", "phase_deg", "delay_s")}
    for k, row in enumerate(L):
        at = np.flatnonzero((np.diff(np.sign(row.imag)) != 0) & (row.real[1:] < 0))
        t = row.imag[at] / (row.imag[at] - row.imag[at + 1])
        gains = [*(-1 / (row.real[at] + t * (row.real[at + 1] - row.real[at])))]
        gains += [-1 / row[i].real for i in _real_ends(row)]
        values["gain"][k] = min((g for g in gains if g > 1), default=inf)
        size = np.log(np.abs(row))
        at = np.flatnonzero(np.diff(np.sign(size)) != 0)
        t = size[at] / (size[at] - size[at + 1])
        phase = np.angle(-row[at]) + t * np.angle(row[at + 1] / row[at])
        omega = np.exp(np.log(w[at]) + t * np.log(w[at + 1] / w[at]))
        phase = (phase + pi) % tau - pi
        values["phase_deg"][k] = float(np.degrees(np.abs(phase).min(initial=inf)))
        values["delay_s"][k] = float((phase % tau / omega).min(initial=inf))
    for name, value in (("Ms", inf), ("gain", 1.0), ("phase_deg", 0.0), ("delay_s", 0.0)):
        values[name] = np.where(stable, values[name], value)
    return values | {"stable": stable}


def _largest(values: Matrix, x: Vector) -> Vector:
    """Return the largest value of each row, by a parabola through three points."""
    at = np.clip(values.argmax(axis=1), 1, x.size - 2)
    rows = np.arange(len(values))
    (x0, x1, x2), (y0, y1, y2) = (
        (x[at - 1], x[at], x[at + 1]),
        (values[rows, at - 1], values[rows, at], values[rows, at + 1]),
    )
    d1, d2 = (y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1)
    c = (d2 - d1) / (x2 - x0)
    with np.errstate(all="ignore"):
        top = y1 - (d1 + c * (x1 - x0)) ** 2 / (4 * c)
    largest = values.max(axis=1)
    return np.asarray(np.where((c < 0) & (top > largest) & (top < 1.2 * largest), top, largest))


def simulate(loop: ClosedLoop, r: Vector, d: Vector | None = None) -> tuple[Any, Any]:
    """Return y (m, N, ny) and u (m, N) of closed loops from rest, for a reference r (N,).

    d (N,) is a disturbance of the plant's input, in V.
    """
    m, S = loop.N.shape
    s = np.zeros((m, S))
    y, u = np.zeros((m, r.size, loop.C.shape[1])), np.zeros((m, r.size))
    M = np.swapaxes(loop.M, 1, 2)
    for k, value in enumerate(r):
        y[:, k] = (loop.C @ s[..., None])[..., 0]
        u[:, k] = s @ loop.row + loop.D * value
        s = (s[:, None, :] @ M)[:, 0] + loop.N * value
        if d is not None:
            s += loop.drive * d[k]
    return y, u


def find_tracked_output(law: ControlLaw, model: DesignModel) -> tuple[int, bool]:
    """Return the index of the output that follows r, and True if its rate does."""
    names = [o.name for o in model.outputs]
    if law.reference.name in names:
        return names.index(law.reference.name), False
    if law.reference.name in model.rates:
        return model.rates.index(law.reference.name), True
    return names.index(law.outputs[0].name), False
