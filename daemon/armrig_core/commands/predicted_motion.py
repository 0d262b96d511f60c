"""Motion of the rig that a rehearsal predicts; a client reads it without numpy."""

from __future__ import annotations

from math import degrees

import msgspec


class Rehearsal(msgspec.Struct, frozen=True, kw_only=True):
    """Response of the model to an input, from standstill."""

    revolutions: float
    """Largest rotation of the chassis from its start, in either direction, in turns."""
    alpha_rad: float
    """Largest deflection of the arm, in either direction, in rad."""
    turned_rad: float
    """Rotation of the chassis at the end, from its start, in rad."""
    theta_1_rad: float | None = None
    """Angle of the chassis at the end, turns included, in rad; None if the start is unknown."""


def sentence(rehearsal: Rehearsal) -> str:
    """Return the result as a line for a person."""
    return (
        f"rehearsed on the model: the chassis turns {rehearsal.revolutions:.1f} times and ends "
        f"{degrees(rehearsal.turned_rad):.0f}° from its start; "
        f"the arm deflects by up to {degrees(rehearsal.alpha_rad):.1f}°"
    )
