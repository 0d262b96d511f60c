"""The physical parameters: names, units, and which of them may be 0."""

from __future__ import annotations

from dataclasses import fields

from armrig_core.arm import ArmParameters

NAMES = tuple(f.name for f in fields(ArmParameters))
SIGNED = frozenset({"b_1"})
"""Parameters that may be 0: estimated as they are, not as logarithms."""
COULOMB = "T_c"
"""Name of the Coulomb friction of the chassis, in Nm."""
UNITS = {
    "J_1": "kg m²",
    "J_2": "kg m²",
    "N": "",
    "K_lin": "Nm/rad",
    "R_m": "Ω",
    "K_m": "Nm/A",
    "b_1": "Nms/rad",
    COULOMB: "Nm",
}
