"""The least-squares problems of the grey box: residuals and derivatives at given parameters.

The free responses of an experiment are the responses to its initial state and its input offset.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from armrig.data.columns import Matrix, Vector
from armrig.data.dataset import Signals
from armrig.numerics.least_squares import orthonormal
from armrig.physics.grey_box.response import sensitivity, with_friction
from armrig.physics.grey_box.sampled_model import COULOMB, SIGNED, Physics, linear_parts

# Exponents of the parameters in the voltage T_c R_m / (N K_m) of the friction.
_VOLTAGE_POWERS = {"R_m": 1.0, "N": -1.0, "K_m": -1.0}
_MIN_START_V = 0.01  # least start value of the friction in a search
_MIN_REVERSED_SHARE = 0.05  # least share of samples of either sign in a bipolar input


def bipolar(u: Vector) -> bool:
    """Return whether an input has both signs, so that friction can be distinguished from u0."""
    return bool(min(np.mean(u > 0), np.mean(u < 0)) >= _MIN_REVERSED_SHARE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearised:
    """Residuals and derivatives at given coordinates, for the M measured values.

    In each experiment the values of the first output precede those of the next. The rows of an
    output are divided by the standard deviation of its noise.
    """

    e: Vector
    """Residuals (M,) after the fit of the free responses."""
    Psi: Matrix
    """Derivatives of the outputs with respect to the coordinates, (M, d). Their projection on the
    free responses is subtracted."""
    size: Vector
    """Norm of each derivative before the projection, (d,)."""
    spans: tuple[Matrix, ...]
    """Orthonormal basis of each experiment's free response."""
    free: tuple[Vector, ...]
    """Initial state and input offset of each experiment, (n + 1,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GreyBox:
    """Problem min sum of |y_i - model_i(parameters) - free responses|²/std_i² over the outputs i.

    The free responses are projected out. The outputs of an experiment have the same initial state
    and the same input offset.
    """

    physics: tuple[Physics, ...]
    """Model of each output, with its fixed parameters."""
    names: tuple[str, ...]
    """Free parameters; the coordinates are logarithms, except for `SIGNED` parameters."""
    experiments: tuple[Signals, ...]
    """Data of each experiment."""
    std: Vector = field(default_factory=lambda: np.ones(1))
    """Standard deviation of the noise of each output, (ny,); 1 for a single output."""

    def values(self, eta: Vector) -> dict[str, float]:
        """Return the parameters that have the given coordinates."""
        return {
            name: float(x if name in SIGNED else np.exp(x))
            for name, x in zip(self.names, eta, strict=True)
        }

    def coordinates(self, values: dict[str, float]) -> Vector:
        """Return the coordinates of the given parameters."""
        return np.array([v if k in SIGNED else np.log(v) for k, v in values.items()])

    def linearise(self, eta: Vector) -> tuple[Vector, Matrix]:
        """Return the residuals, and the derivatives of the output, at the coordinates eta."""
        at = self.at(eta)
        return at.e, at.Psi

    def at(self, eta: Vector, by: Sequence[str] | None = None) -> Linearised:
        """Return residuals and the derivatives with respect to the free parameters, or to `by`."""
        by = self.names if by is None else by
        values, Ts = self.values(eta), self.experiments[0].equidistant()
        models = [physics.sampled(values, by, Ts) for physics in self.physics]
        residuals, blocks, spans, free, sizes = [], [], [], [], []
        for data in self.experiments:
            u = data.u[:, 0]
            outputs, responses = zip(*(linear_parts(model, u) for model in models), strict=True)
            basis = orthonormal(self._stacked(responses, data))
            rest = self._stacked(data.y.T - np.array(outputs), data)
            x = basis.coefficients(rest)
            slopes = [sensitivity(model, u, x[:-1], float(x[-1])) for model in models]
            by_eta = self._stacked(slopes, data)
            residuals.append(basis.without(rest))
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

    def _stacked(self, of_outputs: Iterable[Matrix], data: Signals) -> Matrix:
        """Return the weighted rows of the measured values, first those of the first output."""
        rows = zip(of_outputs, data.valid.T, self.std, strict=True)
        return np.concatenate([x[known] / std for x, known, std in rows])


def by_experiment(e: Vector, experiments: Sequence[Signals], std: Vector) -> list[Matrix]:
    """Return weighted residuals, as in `Linearised`, as a matrix (N, ny) for each experiment.

    The unit is that of y; a missing y has the residual NaN.
    """
    found = []
    for data, rows in zip(experiments, _rows(experiments), strict=True):
        whole = np.full(data.y.shape, np.nan)
        whole.T[data.valid.T] = e[rows] * np.repeat(std, data.valid.sum(axis=0))
        found.append(whole)
    return found


def _rows(experiments: Sequence[Signals]) -> list[slice]:
    """Return for each experiment the slice of the residuals."""
    edges = np.cumsum([0, *(np.count_nonzero(data.valid) for data in experiments)]).tolist()
    return [slice(a, b) for a, b in pairwise(edges)]


def without_free_responses(
    e: Vector,
    J: Matrix,
    d: int,
    experiments: Sequence[Signals],
    columns: Sequence[slice],
    free: Sequence[Vector],
) -> Linearised:
    """Return residuals, and the first d derivatives without the parts that free responses explain.

    An experiment has the columns of J with its free responses, and their values.
    """
    rows = _rows(experiments)
    bases = [orthonormal(J[own, part]) for own, part in zip(rows, columns, strict=True)]
    return Linearised(
        e=e,
        Psi=np.vstack([basis.without(J[own, :d]) for basis, own in zip(bases, rows, strict=True)]),
        size=np.linalg.norm(J[:, :d], axis=0),
        spans=tuple(basis.Q for basis in bases),
        free=tuple(free),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class GreyBoxWithFriction:
    """The least-squares problem with Coulomb friction, which is nonlinear in the free responses.

    The vector of coordinates contains the coordinates of the parameters, then T_c, then x0 of each
    experiment. If the input is bipolar, u0 follows x0. With an input of one sign, as on the rig,
    the motor hardly ever turns back, and the friction keeps its sign. Friction of constant sign
    cannot be distinguished from an offset, so the offset u0 is held at 0.
    """

    plain: GreyBox
    """Problem without Coulomb friction."""
    speed: int
    """Index of the state that is the speed of the motor."""

    def start(self, eta: Vector) -> Vector:
        """Return start coordinates, computed from the coordinates of the problem without friction.

        If u0 is not free in the problem with friction, T_c is computed from the u0 of the problem
        without friction. Otherwise the search begins with a small T_c.
        """
        free = self.plain.at(eta).free
        taken = [x[-1] for x, is_free in zip(free, self._offsets(), strict=True) if not is_free]
        volts = max(float(np.mean(taken)) if taken else 0.0, _MIN_START_V)
        per_volt = self.plain.physics[0].parameters(self.plain.values(eta)).torque_per_volt
        own = [x if is_free else x[:-1] for x, is_free in zip(free, self._offsets(), strict=True)]
        return np.concatenate([eta, [volts * per_volt], *own])

    def linearise(self, z: Vector) -> tuple[Vector, Matrix]:
        """Return the residuals, and the derivatives of the output, at the coordinates z."""
        return self._all(z, self.plain.names)

    def at(self, z: Vector, by: Sequence[str] | None = None) -> Linearised:
        """Return residuals and derivatives, with the free responses projected out.

        By default the derivatives are with respect to the free parameters and T_c.
        """
        names = self.plain.names if by is None else by
        own, first = len(self.plain.names) + 1, len(names) + 1
        e, J = self._all(z, names)
        parts, offsets = self._parts(z), self._offsets()
        free = [
            z[own:][part] if is_free else np.append(z[own:][part], 0.0)
            for part, is_free in zip(parts, offsets, strict=True)
        ]
        columns = [slice(first + part.start, first + part.stop) for part in parts]
        return without_free_responses(
            e, J, first - (by is not None), self.plain.experiments, columns, free
        )

    def _offsets(self) -> list[bool]:
        """Return a list with True for each experiment in which u0 is free."""
        return [bipolar(data.u[:, 0]) for data in self.plain.experiments]

    def _parts(self, z: Vector) -> list[slice]:
        """Return for each experiment the slice of z that contains its x0 and u0."""
        offsets = self._offsets()
        n = (z.size - len(self.plain.names) - 1 - sum(offsets)) // len(offsets)
        edges = np.cumsum([0, *(n + is_free for is_free in offsets)]).tolist()
        return [slice(a, b) for a, b in pairwise(edges)]

    def _all(self, z: Vector, by: Sequence[str]) -> tuple[Vector, Matrix]:
        """Return e (M,), and derivatives with respect to (`by`, T_c, x0, u0, …)."""
        plain = self.plain
        own, first = len(plain.names) + 1, len(by) + 1
        values = plain.values(z[: own - 1])
        (physics,) = plain.physics
        model = physics.sampled(values, by, plain.experiments[0].equidistant())
        per_volt = physics.parameters(values).torque_per_volt
        V = float(z[own - 1]) / per_volt
        residuals, blocks, n = [], [], model.Phi.shape[0]
        for data, part in zip(plain.experiments, self._parts(z), strict=True):
            x = z[own:][part]
            known = data.valid[:, 0]
            u = data.u[:, 0] - x[n] if x.size > n else data.u[:, 0]
            y, slopes = with_friction(model, u, x[:n], V, self.speed)
            by_friction = slopes[:, -2]
            J = np.zeros((data.N, first + z.size - own))
            for j, name in enumerate(by):
                J[:, j] = slopes[:, j] + by_friction * V * _VOLTAGE_POWERS.get(name, 0.0)
            J[:, len(by)] = by_friction / per_volt
            by_free = np.delete(slopes[:, len(by) :], n, axis=1)
            J[:, first + part.start : first + part.stop] = by_free[:, : x.size]
            residuals.append((data.y[:, 0] - y)[known])
            blocks.append(J[known])
        return np.concatenate(residuals), np.vstack(blocks)


def simulation_errors(physics: Any, values: Mapping[str, float], data: Signals) -> Matrix:
    """Return measured minus simulated outputs (N, ny), NaN where an output is missing.

    The initial state of each experiment is estimated from `data`, and the offset of the input of a
    linear model. A linear model is simulated without Coulomb friction.
    """
    experiments = tuple(data.experiments())
    if not isinstance(physics, Physics):
        return np.asarray(physics.errors(values, experiments))
    own = {name: value for name, value in values.items() if name != COULOMB}
    problem = GreyBox(physics=(physics,), names=tuple(own), experiments=experiments)
    return np.vstack(
        by_experiment(problem.at(problem.coordinates(own), ()).e, experiments, problem.std)
    )
