"""The handout's arm and four others."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from armrig_core.rig.arm import ArmParameters


def parameter_sets() -> list[ArmParameters]:
    """Return the handout's parameters and four sets around them, each within a factor of two."""
    rng = np.random.default_rng(20)
    handout = ArmParameters()
    names = [f.name for f in fields(ArmParameters) if f.name != "b_1"]
    return [
        handout,
        *(
            ArmParameters(**{n: getattr(handout, n) * 2 ** rng.uniform(-1, 1) for n in names})
            for _ in range(4)
        ),
    ]


@pytest.fixture(params=parameter_sets(), ids=["handout", *(f"set {i}" for i in range(1, 5))])
def params(request: pytest.FixtureRequest) -> ArmParameters:
    taken: ArmParameters = request.param
    return taken
