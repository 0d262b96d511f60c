"""A comparison of models for programs."""

from __future__ import annotations

from typing import Any


def row_facts(row: Any) -> dict[str, Any]:
    """Return one model's row of a comparison, its figures included."""
    t = row.characteristics
    figures = {name: {"value": getattr(t, name), "std": std} for name, std in t.std.items()}
    poles = [[z.real, z.imag] for z in t.poles.tolist()]
    return {
        "model": row.name,
        "fit_percent": row.fit_percent,
        "rms_error": row.rms_error,
        "velocity_fit_percent": row.velocity_fit_percent,
        "on_estimation_data": row.on_estimation_data,
        "of_rate": t.integrating,
        "figures": figures,
        "poles": poles,
    }
