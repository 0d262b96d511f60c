"""A model that is believed before there are data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from armrig_core.errors import InputError

from armrig.data.dataset import Vector
from armrig.numerics.checks import column
from armrig.numerics.polynomial import stable, without_integrator


class ModelWithNoise(Protocol):
    """What is asked of a model: a `Fit` has it, and so has `PlannedModel`."""

    @property
    def A(self) -> Vector: ...  # noqa: D102
    @property
    def B(self) -> Vector: ...  # noqa: D102
    @property
    def C(self) -> Vector: ...  # noqa: D102
    @property
    def D(self) -> Vector: ...  # noqa: D102
    @property
    def F(self) -> Vector: ...  # noqa: D102
    @property
    def nk(self) -> int: ...  # noqa: D102
    @property
    def integrator(self) -> bool: ...  # noqa: D102
    @property
    def noise_variance(self) -> float: ...  # noqa: D102
    @property
    def Ts(self) -> float: ...  # noqa: D102


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedModel:
    """A model that is believed before there are data: A y = (B/F) u + (C/D) e.

    Raises
    ------
    ValueError
        A denominator does not begin with 1 or is unstable, or B is nothing but zeros.
    """

    B: Vector
    """Coefficients in q^-1; the zeros that it begins with are the delay."""
    F: Vector = field(default_factory=lambda: np.ones(1))
    """Coefficients in q^-1, beginning with 1; with `integrator` one of its roots is 1."""
    noise_variance: float
    """Variance of e, in y's unit squared."""
    Ts: float
    """Sampling time, in s."""
    integrator: bool = False
    """A, where it has coefficients, or else F has the factor 1 - q^-1, known and not estimated."""
    A: Vector = field(default_factory=lambda: np.ones(1))
    """As F."""
    C: Vector = field(default_factory=lambda: np.ones(1))
    """As F."""
    D: Vector = field(default_factory=lambda: np.ones(1))
    """As F."""

    def __post_init__(self) -> None:
        """Refuse what no model can be."""
        for name in "ABCDF":
            p = column(name, getattr(self, name))
            object.__setattr__(self, name, p)
            if name != "B" and p[0] != 1:
                raise InputError(f"{name}={p.tolist()} must begin with 1")
        if not self.B.any():
            raise InputError("B has no coefficient but 0; give the numerator in q^-1, delay first")
        name = integrating_polynomial(self)
        p = getattr(self, name or "F")
        if name and abs(np.sum(p)) > 1e-8 * np.sum(np.abs(p)):
            raise InputError(
                f"integrator=True, but {name}(1)={np.sum(p):.3g} is not 0; multiply {name} with "
                "1 - q^-1"
            )
        F = without_integrator(self.F) if name == "F" else self.F
        for name, p in (("C", self.C), ("F", F)):
            if not stable(p):
                msg = f"{name} has a root on or outside the unit circle"
                msg += "; an integrator is told by integrator=True" if name == "F" else ""
                raise InputError(msg)

    @property
    def nk(self) -> int:
        """Samples before u reaches y."""
        return int(np.argmax(self.B != 0))


def integrating_polynomial(model: ModelWithNoise) -> str:
    """Return "A" or "F", whichever has the known factor 1 - q^-1, or "" where none has."""
    return "" if not model.integrator else "A" if model.A.size > 1 else "F"
