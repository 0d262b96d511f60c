"""Checks of the orders that a caller asks for."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """What an output-error problem looks for; F is the denominator without an integrator."""

    nb: int
    """Numerator coefficients."""
    nf: int
    """Coefficients of F after the 1."""
    nk: int
    """Samples before u reaches y."""
    count: int
    """Transients of each experiment; 0 where it starts from rest."""
    drift: bool
    """Level and ramp of each experiment are free."""


def require_order(**orders: tuple[int, int]) -> None:
    """Refuse an order (value, lowest allowed) that is no integer or too low."""
    for name, (value, lowest) in orders.items():
        if not isinstance(value, int) or isinstance(value, bool) or value < lowest:
            msg = f"{name}={value!r} must be an integer >= {lowest}"
            raise ValueError(msg)


def require_samples(orders: str, *, needed: int, got: int) -> None:
    """Refuse orders too high for the data."""
    if got < needed:
        msg = f"{orders} needs at least {needed} samples, got {got}"
        raise ValueError(msg)
