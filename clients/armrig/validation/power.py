"""Power of the tests of residuals on validation data."""

from __future__ import annotations

MOST_ALLOWED = 10.0
"""Largest factor by which uncertain parameters may widen the bands of a test. With a larger factor,
the test has no power."""


def lack_of_power(allowance: float, *, on_estimation_data: bool) -> str:
    """Return the reason why the tests have no power, with a remedy; "" if they have power.

    The tests on validation data allow for the uncertainty of the parameters. If this uncertainty is
    huge, all residuals pass the tests. An example is the uncertainty of a pole that is 1 within
    rounding errors.
    """
    if on_estimation_data or not allowance > MOST_ALLOWED:
        return ""
    return (
        "the deviations of the parameters widen the bands of the correlations by a factor "
        f"of {allowance:.0f}, so these tests find nothing. Fix a pole near 1 "
        "(option integrator), lower the orders, or record more data"
    )
