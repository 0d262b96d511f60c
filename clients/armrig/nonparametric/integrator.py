"""Outputs that integrate: their rate is what can be estimated without a parametric model."""

from __future__ import annotations

import warnings

from armrig.data.dataset import Dataset
from armrig.data.treatment import INTEGRATING_OUTPUTS, IntegratingOutputWarning, integrating


def is_integrating(data: Dataset, integrator: bool | None, what: str) -> bool:
    """Tell whether the output is to be taken as integrating.

    What the caller says holds. With None an output known by name to integrate (theta_1) does;
    another one that a unit root test finds to integrate does not, but warns.

    Warns
    -----
    IntegratingOutputWarning
        The test finds an integrating output and nobody has said whether it is one.
    """
    if integrator is not None:
        return integrator
    if data.output in INTEGRATING_OUTPUTS:
        return True
    if reason := integrating(data):
        warnings.warn(
            f"{what}: {reason}; {what} of it assumes a response that dies out. "
            "Say integrator=True to estimate its rate and integrate, or integrator=False",
            IntegratingOutputWarning,
            stacklevel=3,
        )
    return False
