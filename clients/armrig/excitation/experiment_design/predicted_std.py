"""Predicted standard deviations, and the length that an experiment must have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray

from armrig.data.dataset import Dataset, Vector
from armrig.numerics.checks import column, require_numbers
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PredictedStd:
    """Standard deviations of an efficient estimate (the Cramér-Rao bound)."""

    names: tuple[str, ...]
    """Names of the parameters, in the order of a fit."""
    theta: Vector
    """Parameter values for which the standard deviations are predicted, (d,)."""
    covariance: NDArray[np.float64]
    """Inverse of the Fisher information, (d, d)."""
    N: int
    """Number of samples of the planned experiment; missing samples are not counted."""
    seconds: float
    """Length of the planned experiment, in s."""

    @property
    def std(self) -> Vector:
        """Standard deviations (d,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def seconds_for(self, **wanted: float) -> float:
        """Return the length, in s, at which a similar input reaches all wanted standard deviations.

        The information is assumed to be proportional to the length of the experiment. This
        assumption is inaccurate if the experiment is short compared with the slowest time constant.
        """
        return self.seconds * max(self._times_longer(name, std) for name, std in wanted.items())

    def explain(self, **wanted: float) -> str:
        """Return a text that states whether the experiment is long enough for the wanted accuracy.

        An example is ``predicted.explain(f1=0.001)``. Without arguments the text contains all
        predicted standard deviations.
        """
        if not wanted:
            return repr(self)
        lines = []
        for name, std in wanted.items():
            got = float(self.std[self._index(name)])
            times = self._times_longer(name, std)
            verdict = "is long enough" if times <= 1 else "is too short"
            lines.append(
                f"{name}: {self.seconds:.3g} s give a standard deviation of {got:.3g}, {std:.3g} "
                f"is wanted: {self.seconds:.3g} s {verdict}, about {self.seconds * times:.3g} s "
                "are needed"
            )
        if len(wanted) > 1:
            needed = self.seconds_for(**wanted)
            verdict = "is long enough" if needed <= self.seconds else "is too short"
            lines.append(
                f"together: {self.seconds:.3g} s {verdict}, about {needed:.3g} s are needed"
            )
        return "\n".join(lines)

    def _index(self, name: str) -> int:
        if name not in self.names:
            raise InputError(f"{name!r} is not among the parameters {', '.join(self.names)}")
        return self.names.index(name)

    def _times_longer(self, name: str, std: float) -> float:
        require_numbers(**{name: std})
        if not std > 0:
            raise InputError(f"{name}={std!r}: a wanted standard deviation must be > 0")
        return float(self.std[self._index(name)] / std) ** 2

    def __repr__(self) -> str:
        """Describe the prediction in a few lines."""
        lines = [f"predicted for {self.N} samples in {self.seconds:.4g} s:"]
        for name, value, std in zip(self.names, self.theta, self.std, strict=True):
            share = f" ({100 * std / abs(value):.2g} %)" if value != 0 else ""
            lines.append(f"  {name} = {value:.5g} ± {std:.2g}{share}")
        return "\n".join(lines)


def planned_data(u: ArrayLike | Dataset, Ts: float) -> Dataset:
    """Return a planned input as a `Dataset`."""
    if not isinstance(u, Dataset):
        given = column("u", u)
        return Dataset(u=given, y=np.zeros(given.size), Ts=Ts)
    if not np.isclose(u.Ts, Ts, rtol=1e-9, atol=0.0):
        raise InputError(
            f"the model has Ts={Ts:g} s and the data have Ts={u.Ts:g} s; plan at one rate"
        )
    return u


def inverted(
    Psi: Array, variance: float, names: tuple[str, ...], theta: Vector, planned: Dataset, to: Array
) -> PredictedStd:
    """Return the Cramér-Rao bound from Psi; Psi^T Psi is `variance` times the information.

    The matrix `to` contains the derivatives of the reported parameters with respect to the
    parameters of Psi.
    """
    basis = orthonormal(Psi)
    if basis.rank < Psi.shape[1]:
        raise InputError(
            f"the planned input determines only {basis.rank} of {Psi.shape[1]} parameters; "
            "use a richer input (describe_input reports its order), or lower the orders"
        )
    return PredictedStd(
        names=names,
        theta=theta,
        covariance=to @ (variance * (basis.W @ basis.W.T)) @ to.T,
        N=planned.N - planned.missing,
        seconds=planned.N * planned.Ts,
    )
