"""Violations planted in the firmware's C: conformance on simavr sees each, on the line or at a pin.

The binary is built with each, and run. Where the line shows nothing, a rule of the pins does.
"""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import pytest
from armrig_daemon.conformance.host import Host
from armrig_daemon.conformance.pin_rules import pin_rules
from armrig_daemon.conformance.suite import FAIL, RULES, run
from armrig_daemon.conformance.virtual_line import VirtualLine
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.uno import Uno

from tests.daemon.conformance.spoilt_devices import UNPLUGGED
from tests.firmware.uno_host import broken, harness
from tests.sampling import sampled
from tests.tools import needs

pytestmark = needs("cc", "make", "simavr", "avr-gcc")


class Planted(NamedTuple):
    """A piece of a file of the firmware, what replaces it, and words of the rule that sees it."""

    file: str
    old: str
    new: str
    found_by: str
    shows: str = ""
    """Words of the rule that drives the pin there, where the pin alone shows it."""


PLANTED = {
    "two of the CRC's four bytes are compared": Planted(
        "core/rig_frame.c",
        "memcmp(frame->message.bytes + length - CRC_BYTES, &crc, CRC_BYTES)",
        "memcmp(frame->message.bytes + length - CRC_BYTES, &crc, 2)",
        "wrong CRC",
    ),
    "lost bytes are not counted": Planted(
        "boards/uno/uart.c",
        "const uint8_t lost = rx_lost;",
        "const uint8_t lost = 0;",
        "lost in a flood",
    ),
    "the pin is high at reset": Planted(
        "boards/uno/motor.c",
        "    PORTB = 0;\n    DDRB = PWM_PIN;\n",
        "    PORTB = PWM_PIN;\n    DDRB = PWM_PIN;\n",
        "outside RUN, the motor's pin",
        "HELLO_R identifies the device",
    ),
    "the enable line stays high": Planted(
        "boards/uno/motor.c",
        "    PORTB = 0;\n    PORTD = 0;\n",
        "    PORTB = 0;\n",
        "outside RUN, the motor's pin",
        "Both ends of the range",
    ),
    "the PWM goes on outside RUN": Planted(
        "boards/uno/motor.c",
        "    is_staged = false;\n    TCCR1A = DISCONNECTED;\n",
        "    is_staged = false;\n",
        "outside RUN, the motor's pin",
        "Both ends of the range",
    ),
    "the pin has half of what is reported": Planted(
        "boards/uno/motor.c",
        "    staged = duty;\n",
        "    staged = duty / 2;\n",
        "has the code that SAMPLE reports",
        "u_k is the code",
    ),
    "STOP leads out of ESTOP": Planted(
        "core/rig_transitions.c",
        "    if (is_latched())\n        rig_answer(&m->header, RIG_CODE_WRONG_STATE);\n"
        "    else if (rig.state == RIG_STATE_IDLE)",
        "    if (rig.state == RIG_STATE_IDLE)",
        "In ESTOP, these requests",
    ),
}


@pytest.mark.parametrize("how", sampled(PLANTED, 2))
def test_a_violation_of_the_firmware_is_seen(how: str, tmp_path: Path) -> None:
    planted = PLANTED[how]
    image = broken(tmp_path, planted.file, planted.old, planted.new)
    with closing(Uno(harness(), image, EmulatorSettings(**UNPLUGGED), 0)) as uno:
        words = (planted.shows or planted.found_by, planted.found_by)
        rules = [
            r for r in (*RULES, *pin_rules(uno.violations)) if any(w in r.sentence for w in words)
        ]

        results = run(Host(VirtualLine(uno)), lambda result: None, rules)

    broken_rules = [r for r in results if r.outcome == FAIL]
    assert [r for r in broken_rules if planted.found_by in r.sentence], results
    assert bool(planted.shows) == all("At the pins" in r.sentence for r in broken_rules)
