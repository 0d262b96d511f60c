"""The least-squares problems of the grey box: residuals and derivatives at given parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.numerics.least_squares import orthonormal
from armrig.physics.grey_box.parameters import SIGNED
from armrig.physics.grey_box.response import linear_parts, sensitivity, with_friction
from armrig.physics.grey_box.sampled_model import Physics

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# How the voltage T_c R_m / (N K_m) that stands for the friction goes with the logarithms.
_VOLTAGE_POWERS = {"R_m": 1.0, "N": -1.0, "K_m": -1.0}
_LEAST_START_V = 0.01  # of the search for the friction
_BIPOLAR = 0.05  # share of the samples that are driven the other way round


def bipolar(u: Vector) -> bool:
    """Tell whether an input drives the chassis both ways, so that friction is no offset."""
    return bool(min(np.mean(u > 0), np.mean(u < 0)) >= _BIPOLAR)


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearised:
    """Everything at one point, in the valid rows of all experiments."""

    e: Vector
    """Residuals (M,), the free responses fitted."""
    Psi: Matrix
    """Derivatives of the output by the coordinates less what the free responses explain, (M, d)."""
    size: Vector
    """Norm of each derivative before that, (d,)."""
    spans: tuple[Matrix, ...]
    """Orthonormal basis of each experiment's free response."""
    free: tuple[Vector, ...]
    """Initial state and input offset of each experiment, (n + 1,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GreyBox:
    """min |y - model(parameters) - free responses|; the free responses are projected out."""

    physics: Physics
    names: tuple[str, ...]
    """Free parameters; the coordinates are their logarithms, or they themselves (SIGNED)."""
    experiments: tuple[Dataset, ...]

    def values(self, eta: Vector) -> dict[str, float]:
        """Return parameters at the coordinates."""
        return {
            name: float(x if name in SIGNED else np.exp(x))
            for name, x in zip(self.names, eta, strict=True)
        }

    def coordinates(self, values: dict[str, float]) -> Vector:
        """Return the coordinates of parameters."""
        return np.array([v if k in SIGNED else np.log(v) for k, v in values.items()])

    def linearise(self, eta: Vector) -> tuple[Vector, Matrix]:
        """Return e and J at eta."""
        at = self.at(eta)
        return at.e, at.Psi

    def at(self, eta: Vector, by: Sequence[str] | None = None) -> Linearised:
        """Return residuals and derivatives, by other parameters than the free ones if asked."""
        by = self.names if by is None else by
        Ts = self.experiments[0].Ts
        model = self.physics.sampled(self.values(eta), by, Ts)
        residuals, blocks, spans, free, sizes = [], [], [], [], []
        for data in self.experiments:
            y, columns = linear_parts(model, data.u)
            basis = orthonormal(columns[data.valid])
            rest = (data.y - y)[data.valid]
            x = basis.coefficients(rest)
            residuals.append(basis.without(rest))
            by_eta = sensitivity(model, data.u, x[:-1], float(x[-1]))[data.valid]
            sizes.append(np.sum(by_eta**2, axis=0))
            blocks.append(basis.without(by_eta))
            spans.append(basis.Q)
            free.append(x)
        return Linearised(
            e=np.concatenate(residuals),
            Psi=np.vstack(blocks),
            size=np.sqrt(np.sum(sizes, axis=0)),
            spans=tuple(spans),
            free=tuple(free),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class GreyBoxWithFriction:
    """The same with Coulomb friction, which makes the free responses' part nonlinear.

    The coordinates are those of the parameters, T_c, and then of each experiment x0 and, where its
    input is bipolar, u0. On an input of one sign, the rig's, the chassis hardly ever turns back,
    and a friction that never changes its sign and an offset stand in for each other: u0 is 0.
    """

    plain: GreyBox
    speed: int
    """Which state is the speed of the chassis."""

    def start(self, eta: Vector) -> Vector:
        """Return coordinates from frictionless ones.

        Where u0 is not free it has taken the friction; elsewhere the search begins with little.
        """
        free = self.plain.at(eta).free
        taken = [x[-1] for x, is_free in zip(free, self._offsets(), strict=True) if not is_free]
        volts = max(float(np.mean(taken)) if taken else 0.0, _LEAST_START_V)
        per_volt = self.plain.physics.parameters(self.plain.values(eta)).torque_per_volt
        own = [x if is_free else x[:-1] for x, is_free in zip(free, self._offsets(), strict=True)]
        return np.concatenate([eta, [volts * per_volt], *own])

    def linearise(self, z: Vector) -> tuple[Vector, Matrix]:
        """Return e and J at z."""
        e, J, _ = self._all(z, self.plain.names)
        return e, J

    def at(self, z: Vector, by: Sequence[str] | None = None) -> Linearised:
        """Return residuals and derivatives, the free responses' directions projected out.

        By default by the free parameters and T_c.
        """
        names = self.plain.names if by is None else by
        own, first = len(self.plain.names) + 1, len(names) + 1
        e, J, rows = self._all(z, names)
        d = first - (by is not None)
        blocks, spans, free = [], [], []
        for (a, b), part, is_free in zip(rows, self._parts(z), self._offsets(), strict=True):
            basis = orthonormal(J[a:b, first + part.start : first + part.stop])
            blocks.append(basis.without(J[a:b, :d]))
            spans.append(basis.Q)
            x = z[own:][part]
            free.append(x if is_free else np.append(x, 0.0))
        size = np.linalg.norm(J[:, :d], axis=0)
        return Linearised(
            e=e, Psi=np.vstack(blocks), size=size, spans=tuple(spans), free=tuple(free)
        )

    def _offsets(self) -> list[bool]:
        """Return of which experiments u0 is free."""
        return [bipolar(data.u) for data in self.plain.experiments]

    def _parts(self, z: Vector) -> list[slice]:
        """Return where x0 (and u0) of each experiment stand behind the parameters and T_c."""
        offsets = self._offsets()
        n = (z.size - len(self.plain.names) - 1 - sum(offsets)) // len(offsets)
        edges = np.cumsum([0, *(n + is_free for is_free in offsets)]).tolist()
        return [slice(a, b) for a, b in pairwise(edges)]

    def _all(self, z: Vector, by: Sequence[str]) -> tuple[Vector, Matrix, list[tuple[int, int]]]:
        """Return e (M,), the derivatives by (by, T_c, x0, u0, …), and each experiment's rows."""
        plain = self.plain
        own, first = len(plain.names) + 1, len(by) + 1
        values = plain.values(z[: own - 1])
        model = plain.physics.sampled(values, by, plain.experiments[0].Ts)
        per_volt = plain.physics.parameters(values).torque_per_volt
        V = float(z[own - 1]) / per_volt
        residuals, blocks, rows = [], [], []
        begin, n = 0, model.Phi.shape[0]
        for data, part in zip(plain.experiments, self._parts(z), strict=True):
            x = z[own:][part]
            u = data.u - x[n] if x.size > n else data.u
            answer = with_friction(model, u, x[:n], V, self.speed)
            J = np.zeros((data.N, first + z.size - own))
            J[:, : len(by)] = answer.by_parameters
            for j, name in enumerate(by):
                J[:, j] += answer.by_friction * V * _VOLTAGE_POWERS.get(name, 0.0)
            J[:, len(by)] = answer.by_friction / per_volt
            by_free = np.column_stack([answer.by_initial, answer.by_offset])
            J[:, first + part.start : first + part.stop] = by_free[:, : x.size]
            residuals.append((data.y - answer.y)[data.valid])
            blocks.append(J[data.valid])
            rows.append((begin, begin + residuals[-1].size))
            begin += residuals[-1].size
        return np.concatenate(residuals), np.vstack(blocks), rows
