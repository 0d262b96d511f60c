"""Names, units and checks of the physical parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Literal, get_args

import numpy as np
from armrig_core.arm import ArmParameters
from armrig_core.errors import InputError
from armrig_core.telemetry import OutputName

NAMES = tuple(f.name for f in fields(ArmParameters))
SIGNED = frozenset({"b_1"})
"""Parameters that may be 0, and are therefore not estimated as logarithms."""
COULOMB = "T_c"
"""Name of the parameter for the Coulomb friction of the chassis; its unit is Nm."""
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
Friction = Literal["viscous", "coulomb", "both"]
_RECORDED = get_args(OutputName)


def free_names(free: Sequence[str], friction: Friction | None) -> tuple[str, ...]:
    """Return the names of the free parameters; the parameters of the friction are last."""
    if isinstance(free, str):
        free = (free,)
    if friction not in (None, "viscous", "coulomb", "both"):
        raise InputError(f'friction={friction!r} must be None, "viscous", "coulomb" or "both"')
    for name in free:
        if name not in NAMES:
            msg = f"free={name!r} is none of {', '.join(NAMES)}"
            msg += "; give several names as a sequence" if "," in name else ""
            raise InputError(msg)
    names = list(free)
    if friction in ("viscous", "both") and "b_1" not in names:
        names.append("b_1")
    if friction in ("coulomb", "both"):
        names.append(COULOMB)
    if not free or len(set(names)) < len(names):
        raise InputError(f"free={tuple(free)} must name at least one parameter, and none twice")
    return tuple(names)


def require_output(measured: str, output: str) -> None:
    """Refuse another measured output than the model's, if it is an output of a recording."""
    if measured in _RECORDED and measured != output:
        raise InputError(
            f"the data contain {measured}, the model's output is {output}; use "
            f"recording.dataset(output={output!r})"
        )


def checked_fixed_std(fixed_std: Mapping[str, float], names: tuple[str, ...]) -> dict[str, float]:
    """Return the standard deviations of fixed parameters; refuse a wrong name or number."""
    for name, std in fixed_std.items():
        if name not in NAMES or name in names:
            msg = f"fixed_std={name!r} is not a fixed parameter; the fixed parameters are "
            msg += ", ".join(x for x in NAMES if x not in names)
            raise InputError(msg)
        if not (np.isfinite(std) and std >= 0):
            raise InputError(f"fixed_std[{name!r}]={std!r} must be finite and >= 0")
    return dict(fixed_std)
