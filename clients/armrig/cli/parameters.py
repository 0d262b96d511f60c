"""Options of simulations: --set, --amplitude and --omega."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated

import typer

from armrig.cli.options import option
from armrig.cli.printing import tell

if TYPE_CHECKING:
    from armrig_core.rig.arm import ArmParameters


def _doubted(given: list[str] | None) -> list[str] | None:
    """Return the parameters unchanged; print the parameters that are probably not in SI units."""
    from armrig_core.rig.arm import ArmParameters

    for name, value in _values(given).items():
        handout = getattr(ArmParameters(), name)
        if handout and value > 0 and not 1 / _MAX_RATIO <= value / handout <= _MAX_RATIO:
            tell(
                f"--set {name}={value:g}: this is {value / handout:.2g} times the value of the "
                f"handout, {handout:g}; is it in SI units?"
            )
    return given


def _explained_amplitude(volts: float) -> float:
    """Return the amplitude unchanged; print a note if it exceeds the rig's largest input."""
    if not abs(volts) <= AMPLITUDE_V:
        tell(
            f"--amplitude {volts:g}: the sinusoid is only simulated, never played; the rig takes "
            f"0 to 5 V, an amplitude of at most {AMPLITUDE_V:g} V"
        )
    return volts


PARAMETERS = "J_1, J_2, N, K_lin, R_m, K_m or b_1"
"""Names of the parameters of `ArmParameters` for the help, which must not import numpy."""
AMPLITUDE_V, OMEGA = 2.5, 10.0
"""Amplitude in V and frequency in rad/s of the sinusoid of handout part 4."""
OF_CHANGES = option(
    "--set NAME=VALUE", f"Value of {PARAMETERS}, in SI units; repeatable.", callback=_doubted
)
OF_AMPLITUDE = option(
    "--amplitude",
    "Amplitude of the simulated sinusoid, in V.",
    callback=_explained_amplitude,
)
OF_OMEGA = option("--omega", "Angular frequency of the sinusoid, in rad/s.")
Given = Annotated[list[str] | None, OF_CHANGES]
Amplitude = Annotated[float, OF_AMPLITUDE]
Omega = Annotated[float, OF_OMEGA]
_WITH_UNIT = re.compile(r"[-+]?[\d.]+(e[-+]?\d+)? ?[^\d,.\s]")
_MAX_RATIO = 100.0
"""Ratio of a parameter to the handout's value, or the inverse, above which a note is printed."""


def parameters(given: list[str] | None) -> ArmParameters:
    """Return the parameters of the handout with the given changes."""
    from dataclasses import replace

    from armrig_core.rig.arm import ArmParameters

    return replace(ArmParameters(), **_values(given))


def cases(given: list[str] | None) -> dict[str, ArmParameters]:
    """Return the parameters by case (handout 2.3): no change, each change alone, all changes."""
    from armrig.physics.systems import beside_the_handout

    return beside_the_handout(parameters(given))


def physics_beside(given: list[str] | None) -> dict[str, ArmParameters]:
    """Return the physical models to compare: the handout's model, and the changed model if any."""
    from armrig.physics.systems import HANDOUT

    handout = parameters(None)
    return {HANDOUT: handout, changes(given): parameters(given)} if given else {"physics": handout}


def changes(given: list[str] | None) -> str:
    """Return the changes as a label; "" without a change."""
    return ", ".join(f"{name}={value:g}" for name, value in _values(given).items())


def _values(given: list[str] | None) -> dict[str, float]:
    from dataclasses import fields

    from armrig_core.rig.arm import ArmParameters

    names = [f.name for f in fields(ArmParameters)]
    values: dict[str, float] = {}
    for text in given or ():
        name, _, number = text.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = None
        if name in names and value is None and _WITH_UNIT.match(number):
            from armrig.physics.grey_box.sampled_model import UNITS

            unit = f", in {UNITS[name]}" if UNITS[name] else ""
            msg = f"--set {text}: give the number alone{unit}, such as "
            raise typer.BadParameter(f"{msg}--set {name}={getattr(ArmParameters(), name):g}")
        if name not in names or value is None:
            raise typer.BadParameter(
                f"--set {text}: give NAME=VALUE, such as J_1=0.0017; names are {', '.join(names)}"
            )
        values[name] = value
    return values
