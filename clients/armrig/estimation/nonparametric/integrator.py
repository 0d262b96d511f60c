"""Outputs that integrate: their rate is what can be estimated without a parametric model."""

from __future__ import annotations

from dataclasses import dataclass

from armrig.data.dataset import Dataset
from armrig.data.treatment import INTEGRATING_OUTPUTS, integrating


@dataclass(frozen=True, slots=True, kw_only=True)
class Integration:
    """Whether an output is taken as integrating, and what a result says of it."""

    integrates: bool
    """y is treated as the sum of its rate."""
    reason: str = ""
    """What the data decided it by; "" where the caller or the output's name did."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What a result says of it."""
        if not self.reason:
            return ()
        what = "taken as integrating (in Python integrator=False takes it as it is)"
        return (f"{self.reason}: {what}",)


def integration(data: Dataset, integrator: bool | None) -> Integration:
    """Tell whether the output is to be taken as integrating.

    What the caller says holds. With None an output known by name to integrate (theta_1) does, and
    so does one that a unit root test finds to integrate (`integrating`), which the notes say.
    """
    if integrator is not None:
        return Integration(integrates=integrator)
    if data.output in INTEGRATING_OUTPUTS:
        return Integration(integrates=True)
    found = integrating(data)
    return Integration(integrates=found is not None, reason=found.text if found else "")
