"""End of the search for a minimum."""

from __future__ import annotations

import numpy as np
from armrig.numerics.levenberg_marquardt import levenberg_marquardt


def test_residuals_of_nothing_end_the_search() -> None:
    """Data without noise have no relative change that becomes small."""
    truth = np.array([3.0, -5.0])

    found = levenberg_marquardt(
        lambda theta: (truth - theta, np.eye(2)), np.zeros(2), admissible=lambda _: True
    )

    assert found.converged
    assert found.cost == 0
    assert found.theta.tolist() == truth.tolist()
