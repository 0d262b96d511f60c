"""One model's row of a comparison, for a person and for a program."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from armrig.validation.comparison import Comparison


def row_line(name: str, row: Comparison, unit: str) -> str:
    """Return a model's row in a line."""
    velocity = row.velocity_fit_percent
    line = f"  {name} fit {row.fit_percent:7.2f} %  rms {row.rms_error:.4g} {unit}".rstrip()
    if velocity is not None:
        line += f"  velocity fit {velocity:7.2f} %"
    if row.on_estimation_data:
        line += "  (estimation data)"
    return line


def row_facts(row: Comparison) -> dict[str, Any]:
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
