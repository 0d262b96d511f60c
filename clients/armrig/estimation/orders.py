"""Checks of requested orders."""

from __future__ import annotations

from armrig_core.errors import InputError


def require_samples(orders: str, *, needed: int, got: int) -> None:
    """Refuse orders that need more samples than the data have."""
    if got < needed:
        raise InputError(f"{orders} needs at least {needed} samples, got {got}")


SAMPLES_PER_PARAMETER = 10
"""Least number of samples per parameter that reliable standard deviations need."""


def require_sensible(*, samples: int, nk: int, integrator: bool = False, **orders: int) -> None:
    """Refuse a model if nk or its number of parameters is above a tenth of the measured samples."""
    asked = ", ".join(f"{name}={n}" for name, n in orders.items())
    parameters, most = sum(orders.values()) - int(integrator), samples // SAMPLES_PER_PARAMETER
    if not most:
        needed = SAMPLES_PER_PARAMETER * max(parameters, nk, 1)
        raise InputError(
            f"{samples} samples are too few for a model: record longer, at least {needed} samples "
            f"for {asked or f'nk={nk}'}"
        )
    if parameters > most:
        raise InputError(
            f"{asked}: {parameters} parameters from {samples} samples; at most {most} parameters, "
            f"one for each {SAMPLES_PER_PARAMETER} samples: lower {' or '.join(orders)}, or "
            "record longer"
        )
    if nk > most:
        raise InputError(
            f"nk={nk}: at most {most} for {samples} samples; lower nk, or record longer"
        )
