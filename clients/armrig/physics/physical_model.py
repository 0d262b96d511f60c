"""The physics of the whole arm as a model from voltage to angle, nothing of it estimated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from armrig_core.arm import ArmParameters, arm_matrices
from armrig_core.calls import checked_call

from armrig.data.argument import as_dataset
from armrig.data.dataset import Dataset, Vector
from armrig.models.model import Model
from armrig.physics.discretisation import transfer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from armrig.models.summary import Summary


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PhysicalModel(Model):
    """The rig's equations, sampled: a claim, not an estimate, and nothing in it is uncertain."""

    @property
    def label(self) -> str:
        """What a table or a legend calls it."""
        return "physics"

    def predict(self, data: Dataset, horizon: int | None = None) -> Vector:
        """Return ŷ(t) (N,), simulated by default: see `armrig.Fit.predict`."""
        from armrig.models.prediction import predicted

        return predicted(self, data, horizon)

    def summary(self) -> Summary:
        """Return poles, zeros, gain, bandwidth and the like; print it."""
        from armrig.models.summary import summary

        return summary(self)

    def plot(self) -> Figure:
        """Return a figure of frequency and step response, poles and zeros."""
        from armrig.models.figures import plot_fit

        return plot_fit(self)

    def __repr__(self) -> str:
        """Say it in a few lines, equation first."""
        from armrig.models.equation import equations, heading

        return "\n".join([heading(self), *equations(self)])


@checked_call
def physical_model(p: ArmParameters, data: Dataset) -> PhysicalModel:
    """Return the physics of the whole arm from u to theta_1 as a model, nothing estimated.

    Sampled exactly for an input held over Ts, see `armrig.physics.discretisation.transfer`. Its
    standard deviations are 0: it is a claim, not an estimate.
    """
    A, B, C = arm_matrices(p)
    data = as_dataset(data)
    numerator, denominator = transfer(A, B, C[0], data.Ts)
    return PhysicalModel(
        B=numerator,
        F=denominator,
        nk=1,
        integrator=True,
        Ts=data.Ts,
        output=data.output,
        unit=data.unit,
        input_unit=data.input_unit,
    )
