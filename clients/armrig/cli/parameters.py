"""The options that change what is simulated: --set, --amplitude and --omega."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated

import typer

from armrig.cli.options import tell

if TYPE_CHECKING:
    from armrig_core.arm import ArmParameters


def _doubted(given: list[str] | None) -> list[str] | None:
    """Return the parameters as given, and tell which can hardly be in SI units."""
    from armrig_core.arm import ArmParameters

    for name, value in _values(given).items():
        handout = getattr(ArmParameters(), name)
        if handout and value > 0 and not 1 / _FAR <= value / handout <= _FAR:
            tell(
                f"--set {name}={value:g}: that is {value / handout:.2g} times the handout's "
                f"{handout:g}; is it in SI units?"
            )
    return given


def _explained_amplitude(volts: float) -> float:
    """Return the amplitude as given, and tell that one beyond the rig's input is simulated only."""
    if not abs(volts) <= AMPLITUDE_V:
        tell(
            f"--amplitude {volts:g}: the sinusoid is simulated, never played; the rig takes 0 to "
            f"5 V, an amplitude of {AMPLITUDE_V:g} V at most"
        )
    return volts


Given = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="A parameter of the rig in SI units; may be repeated.",
        callback=_doubted,
    ),
]
AMPLITUDE_V, OMEGA = 2.5, 10.0
"""Sinusoid of part 4, in V and rad/s."""
Amplitude = Annotated[
    float,
    typer.Option(
        "--amplitude",
        help="Amplitude of the simulated sinusoid, in V.",
        callback=_explained_amplitude,
    ),
]
Omega = Annotated[float, typer.Option("--omega", help="Frequency of the sinusoid, in rad/s.")]
_WITH_UNIT = re.compile(r"[-+]?[\d.]+(e[-+]?\d+)? ?[^\d,.\s]")
_FAR = 100.0
"""Times that a parameter differs from the handout's before it is doubted."""


def parameters(given: list[str] | None) -> ArmParameters:
    """Return the handout's parameters with those given in their place."""
    from dataclasses import replace

    from armrig_core.arm import ArmParameters

    return replace(ArmParameters(), **_values(given))


def cases(given: list[str] | None) -> dict[str, ArmParameters]:
    """Return what is compared in 2.3: the handout's, each change alone, and all of them."""
    from armrig.physics.systems import beside_the_handout

    return beside_the_handout(parameters(given))


def physics_beside(given: list[str] | None) -> dict[str, ArmParameters]:
    """Return the physical models that stand beside others: the changed one with the handout's."""
    from armrig.physics.systems import HANDOUT

    handout = parameters(None)
    return {HANDOUT: handout, changes(given): parameters(given)} if given else {"physics": handout}


def changes(given: list[str] | None) -> str:
    """Return what was changed, as a label; "" where nothing was."""
    return ", ".join(f"{name}={value:g}" for name, value in _values(given).items())


def _values(given: list[str] | None) -> dict[str, float]:
    from dataclasses import fields

    from armrig_core.arm import ArmParameters

    names = [f.name for f in fields(ArmParameters)]
    values: dict[str, float] = {}
    for text in given or ():
        name, _, number = text.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = None
        if name in names and value is None and _WITH_UNIT.match(number):
            from armrig.physics.grey_box.parameters import UNITS

            unit = f", in {UNITS[name]}" if UNITS[name] else ""
            msg = f"--set {text}: give the number alone{unit}, such as "
            raise typer.BadParameter(f"{msg}--set {name}={getattr(ArmParameters(), name):g}")
        if name not in names or value is None:
            raise typer.BadParameter(
                f"--set {text}: give NAME=VALUE, such as J_1=0.0017; names are {', '.join(names)}"
            )
        values[name] = value
    return values
