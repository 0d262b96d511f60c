"""Physical parameters, and the exactly sampled model with its derivatives by the parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from armrig_core.rig.arm import ARM_UNITS, ArmParameters
from armrig_core.telemetry.channels import ARM_OUTPUTS
from numpy.typing import ArrayLike
from scipy.linalg import expm, expm_frechet

from armrig.data.columns import Matrix, Vector
from armrig.numerics.checks import column
from armrig.numerics.recursion import recursion

if TYPE_CHECKING:
    import control


NAMES = tuple(f.name for f in fields(ArmParameters))
SIGNED = frozenset({"b_1"})
"""Parameters that may be 0, and are therefore not estimated as logarithms."""
COULOMB = "T_c"
"""Name of the parameter for the Coulomb friction; its unit is Nm."""
UNITS = ARM_UNITS | {COULOMB: "Nm"}
Friction = Literal["viscous", "coulomb", "both"]
Model = Callable[[ArmParameters], "control.StateSpace"]

_LOG_STEP = 1e-3  # step of a numerical derivative; the fourth-order error is about 1e-12


def free_names(free: Sequence[str], friction: Friction | None) -> tuple[str, ...]:
    """Return the names of the free parameters; the parameters of the friction are last."""
    if isinstance(free, str):
        free = (free,)
    if friction not in (None, "viscous", "coulomb", "both"):
        raise InputError(f'friction={friction!r} must be None, "viscous", "coulomb" or "both"')
    for name in free:
        if name not in NAMES:
            msg = f"free={name!r} is none of {', '.join(NAMES)}"
            msg += "; give several names as a sequence" if "," in name else ""
            raise InputError(msg)
    names = list(free)
    if friction in ("viscous", "both") and "b_1" not in names:
        names.append("b_1")
    if friction in ("coulomb", "both"):
        names.append(COULOMB)
    if not free or len(set(names)) < len(names):
        raise InputError(f"free={tuple(free)} must name at least one parameter, and none twice")
    return tuple(names)


def require_output(measured: str, output: str) -> None:
    """Refuse another measured output than the model's, if it is an output of a recording."""
    if measured in ARM_OUTPUTS and measured != output:
        raise InputError(
            f"the data contain {measured}, the model's output is {output}; use "
            f"recording.dataset(output={output!r})"
        )


def checked_fixed_std(fixed_std: Mapping[str, float], names: tuple[str, ...]) -> dict[str, float]:
    """Return the standard deviations of fixed parameters; refuse a wrong name or number."""
    for name, std in fixed_std.items():
        if name not in NAMES or name in names:
            msg = f"fixed_std={name!r} is not a fixed parameter; the fixed parameters are "
            msg += ", ".join(x for x in NAMES if x not in names)
            raise InputError(msg)
        if not (np.isfinite(std) and std >= 0):
            raise InputError(f"fixed_std[{name!r}]={std!r} must be finite and >= 0")
    return dict(fixed_std)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampled:
    """Matrices of x(k+1) = Phi x(k) + Gamma u(k), y(k) = C x(k) + D u(k), or their derivatives."""

    Phi: Matrix
    """Transition matrix (n, n)."""
    Gamma: Matrix
    """Input vector (n,)."""
    C: Matrix
    """Output vector (n,)."""
    D: float
    """Direct term."""
    by: tuple[Sampled, ...] = ()
    """Derivatives of the matrices with respect to each of the d coordinates, see `Physics.sampled`.
    """


def linear_parts(model: Sampled, u: Vector) -> tuple[Vector, Matrix]:
    """Return the output (N,) from rest, and the responses to initial states and offset, (N, n + 1).

    Column i is the response to an initial value of 1 of state i. The last column is the response to
    an offset u0 = 1, which is subtracted from u.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Physics:
    """Model with fixed and free parameters; `sampled` takes values of the free parameters."""

    model: Model
    """Function: parameters -> control.StateSpace, in continuous time."""
    fixed: ArmParameters
    """Values of all parameters that are not free."""
    output: str
    """Label of the measured output."""

    @property
    def units(self) -> dict[str, str]:
        """Units of the parameters."""
        return UNITS

    def signed(self, name: str) -> bool:
        """Return whether a parameter may be 0 or negative."""
        return name in SIGNED | {COULOMB}

    def to_control(self, parameters: ArmParameters) -> control.StateSpace:
        """Return the continuous model, without Coulomb friction."""
        return self.model(parameters)

    def labels(self) -> tuple[list[str], list[str]]:
        """Return the labels of outputs and of states."""
        system = self.model(self.fixed)
        return list(system.output_labels), list(system.state_labels)

    def check(self) -> None:
        """Refuse a model that is not continuous, has several inputs, or lacks the output."""
        if not callable(self.model) or hasattr(self.model, "dt"):
            raise InputTypeError(
                f"model is a {type(self.model).__name__}: give a function of the parameters, "
                "such as armrig.arm, without parentheses"
            )
        system = self.model(self.fixed)
        if system.dt not in (0, None) or system.ninputs != 1:
            raise InputError(
                f"the model has dt={system.dt} and {system.ninputs} inputs; it must be in "
                "continuous time with one input"
            )
        if self.output not in system.output_labels:
            raise InputError(
                f"output={self.output!r} is none of the model's outputs {system.output_labels}"
            )

    def parameters(self, values: dict[str, float]) -> ArmParameters:
        """Return all parameters of the linear model; a viscous friction below 0 becomes 0."""
        linear = {k: v for k, v in values.items() if k != COULOMB}
        return replace(
            self.fixed, **{k: max(v, 0.0) if k in SIGNED else v for k, v in linear.items()}
        )

    def sampled(self, values: dict[str, float], by: Sequence[str], Ts: float) -> Sampled:
        """Return the model, sampled exactly for a zero-order hold, with its derivatives.

        Phi and Gamma are blocks of exp([A B; 0 0] Ts). Their derivatives are blocks of the Fréchet
        derivative in the direction of [dA dB; 0 0] Ts. The coordinate of a parameter is its
        logarithm; the coordinate of a `SIGNED` parameter is the parameter itself.

        References
        ----------
        .. [1] A. H. Al-Mohy, N. J. Higham, SIAM J. Matrix Anal. Appl. 30 (2009) 1639-1657.
        """
        M = self._matrices(values)
        n = M.shape[0] - 1
        block = _hold(M, Ts)
        both = expm(block)
        derivatives = []
        for name in by:
            dM = self._derivative(values, name)
            d = expm_frechet(block, _hold(dM, Ts), compute_expm=False)
            derivatives.append(Sampled(Phi=d[:n, :n], Gamma=d[:n, n], C=dM[n, :n], D=dM[n, n]))
        return Sampled(
            Phi=both[:n, :n], Gamma=both[:n, n], C=M[n, :n], D=float(M[n, n]), by=tuple(derivatives)
        )

    def simulate(self, values: Mapping[str, float], u: ArrayLike, Ts: float) -> Vector:
        """Return the output (N,) for a held input, from rest and without Coulomb friction."""
        return linear_parts(self.sampled(dict(values), (), Ts), column("u", u))[0]

    def _matrices(self, values: dict[str, float]) -> Matrix:
        """Return [A B; C D] (n + 1, n + 1), extrapolated linearly for a friction below 0."""
        p = self.parameters(values)
        M = self._at(p)
        for name in SIGNED & values.keys():
            if values[name] < 0:
                M = M + values[name] * self._slope_from(p, name)
        return M

    def _at(self, p: ArmParameters) -> Matrix:
        system = self.model(p)
        row = [list(system.output_labels).index(self.output)]
        return np.block([[system.A, system.B], [system.C[row], system.D[row]]])

    def _derivative(self, values: dict[str, float], name: str) -> Matrix:
        """Return the derivative of [A B; C D] with respect to one coordinate."""
        p = self.parameters(values)
        if name in SIGNED:
            return self._slope_from(p, name)

        def at(x: float) -> Matrix:
            return self._at(replace(p, **{name: getattr(p, name) * np.exp(x)}))

        near, far = at(_LOG_STEP) - at(-_LOG_STEP), at(2 * _LOG_STEP) - at(-2 * _LOG_STEP)
        return np.asarray((8 * near - far) / (12 * _LOG_STEP))

    def _slope_from(self, p: ArmParameters, name: str) -> Matrix:
        """Return the one-sided derivative, from above, with respect to a `SIGNED` parameter."""
        value, step = getattr(p, name), _LOG_STEP * p.damping
        m0, m1, m2 = (self._at(replace(p, **{name: value + k * step})) for k in range(3))
        return np.asarray((4 * m1 - 3 * m0 - m2) / (2 * step))


def _hold(M: Matrix, Ts: float) -> Matrix:
    block = Ts * M
    block[-1] = 0.0
    return block
