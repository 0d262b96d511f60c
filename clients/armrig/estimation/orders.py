"""Checks of the orders that a caller asks for."""

from __future__ import annotations

from armrig_core.errors import InputError


def require_samples(orders: str, *, needed: int, got: int) -> None:
    """Refuse orders too high for the data."""
    if got < needed:
        raise InputError(f"{orders} needs at least {needed} samples, got {got}")


SAMPLES_PER_PARAMETER = 10
"""Fewer say nothing: the standard deviations, right for many samples, do not hold any more."""


def require_sensible(*, samples: int, nk: int, integrator: bool = False, **orders: int) -> None:
    """Refuse orders that are absurd for so many measured samples."""
    asked = ", ".join(f"{name}={n}" for name, n in orders.items())
    parameters, most = sum(orders.values()) - int(integrator), samples // SAMPLES_PER_PARAMETER
    if not most:
        needed = SAMPLES_PER_PARAMETER * max(parameters, nk, 1)
        raise InputError(
            f"{samples} samples are too few for a model: record longer, {needed} at least for "
            f"{asked or f'nk={nk}'}"
        )
    if parameters > most:
        raise InputError(
            f"{asked}: {parameters} parameters from {samples} samples; at most {most}, one for "
            f"each {SAMPLES_PER_PARAMETER} samples: lower {' or '.join(orders)}, or record "
            "longer"
        )
    if nk > most:
        raise InputError(
            f"nk={nk}: at most {most} of {samples} samples; lower nk, or record longer"
        )
