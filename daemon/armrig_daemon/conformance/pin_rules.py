"""Rules about a board's pins; they need simulated pins."""

from __future__ import annotations

from collections.abc import Sequence

from armrig_daemon.conformance.host import Host
from armrig_daemon.conformance.rule import Rule, expect
from armrig_daemon.emulator.harness import CYCLES_PER_US, Violated, Violation
from armrig_daemon.emulator.pin import sentence

_RULES = (
    (
        7,
        "At the pins: outside RUN, the motor's pin and the enable line are low, from the reset on",
        {Violation.PIN_HIGH_WITHOUT_ENABLE, Violation.DRIVEN_OUTSIDE_RUN},
    ),
    (
        5,
        "At the pins: in RUN, the motor's pin has the code that SAMPLE reports",
        {Violation.CODE_NOT_AT_PIN},
    ),
    (
        1,
        "At the pins: the program does not stop, and the transmitter is not overwritten",
        {Violation.CPU_STOPPED, Violation.TX_OVERRUN},
    ),
)


def pin_rules(violations: Sequence[Violated]) -> tuple[Rule, ...]:
    """Return the rules about a board's pins; they must be tested after all other rules."""
    return tuple(_rule(section, text, kinds, violations) for section, text, kinds in _RULES)


def _rule(section: int, text: str, kinds: set[Violation], violations: Sequence[Violated]) -> Rule:
    def check(host: Host) -> None:
        host.fence()
        seen = [v for v in violations if v.what in kinds]
        if seen:
            ms = seen[0].cycle / CYCLES_PER_US / 1000
            expect(
                False,
                f"{sentence(seen[0].what)}: {len(seen)} times, first {ms:.2f} ms after power-on",
            )

    return Rule(section=section, sentence=text, check=check)
