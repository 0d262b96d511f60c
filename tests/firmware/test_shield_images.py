"""The images of the shields: the pin D3 without an enable line, and bugs planted in their pins."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest
from armrig_daemon.emulator.board import VoltageError
from armrig_daemon.emulator.layout import LAYOUTS
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.uno import Uno
from armrig_protocol.messages import Capability, Sample, Status, Stop

from tests.firmware.harness_orders import figures
from tests.firmware.uno_host import (
    BOOT_NS,
    MS,
    Host,
    assert_low_outside_run,
    broken,
    harness,
    powered,
)
from tests.tools import needs

pytestmark = needs("cc", "make", "simavr")
CODES = [65_535, 0, 256, 40_000, 0, 32_768, 65_535, 12_345]
PERIOD_NS = 128_000
SHIELDS = [name for name in LAYOUTS if name != "uno"]
BOARD = "boards/uno/"
OFF = "    PWM_MODE = DISCONNECTED;\n    PWM_PORT = 0;\n    PORTD = 0;\n"
PLANTED = {
    "the pin is high before main": (
        "motor.c",
        "PWM_PORT = 0;\n    PWM_DDR",
        "PWM_PORT = PWM_PIN;\n    PWM_DDR",
    ),
    "a stop leaves the pin connected": ("motor.c", OFF, "    PWM_PORT = 0;\n    PORTD = 0;\n"),
    "a stop leaves the port high": ("motor.c", OFF, OFF.replace("PORTD = 0", "PORTD = PWM_PIN")),
    "each later duty is a step too long": (
        "motor.c",
        "PWM_COMPARE = duty - 1;",
        "PWM_COMPARE = duty;",
    ),
    "the first duty is a step too long": ("motor.c", "connect(duty - 1)", "connect(duty)"),
    "duty 0 is the longest": ("motor.c", "if (duty == 0)", "if (duty > 256)"),
    "the pin stays an input": ("motor.c", "    PWM_DDR = PWM_PIN;\n    PWM_CLOCK", "    PWM_CLOCK"),
    "the timer stays stopped": (
        "motor.c",
        "PWM_DDR = PWM_PIN;\n    PWM_CLOCK = COUNTS;",
        "PWM_DDR = PWM_PIN;",
    ),
    "the compare value is not set": (
        "motor.c",
        "    PWM_COMPARE = compare;\n",
        "    (void)compare;\n",
    ),
    "0 V leaves the pin connected": (
        "pwm_d3.h",
        "DISCONNECTED (_BV(WGM21)",
        "DISCONNECTED (_BV(COM2B1) | _BV(WGM21)",
    ),
    "the pin is never connected": ("pwm_d3.h", "| _BV(COM2B1))", ")"),
    "another clock": ("pwm_d3.h", "COUNTS _BV(CS21)", "COUNTS _BV(CS22)"),
    "another pin": ("pwm_d3.h", "PWM_PIN _BV(PD3)", "PWM_PIN _BV(PD4)"),
    "a duty of 9 bits": ("pwm_d3.h", "PWM_BITS 8", "PWM_BITS 9"),
    "an enable line is reported": (
        "board_constants.h",
        "RIG_CAPABILITY_ENABLE_LINE : 0",
        "0 : RIG_CAPABILITY_ENABLE_LINE",
    ),
    "the supply is the reference": ("layouts/tclab.h", "AREF_AS", "SUPPLY_AS"),
}


def session(host: Host) -> list[str]:
    """Drive the pin with several codes, stop, and return what is wrong."""
    uno, found = host.uno, []
    hello = host.hello()
    if hello.pwm_bits != 8 or hello.capabilities & Capability.ENABLE_LINE:
        found.append(f"HELLO_R: {hello}")
    host.start()
    for i, u in enumerate(CODES):
        host.drive(u, 2, 1 + 2 * i)
    stopped_ns = host.say(Stop)
    host.wait(1100)
    if uno.ns(figures(uno.harness).last_high) > stopped_ns + PERIOD_NS:
        found.append("the pin is high after a stop")
    if host.last(Status).vcc_mv:
        found.append("the supply was measured")
    return found + [v.what.sentence for v in uno.violations]


@pytest.mark.parametrize("name", SHIELDS)
def test_the_pin_of_a_shield_has_the_commanded_duty_and_is_low_after_a_stop(name: str) -> None:
    with powered(name=name) as host:
        found = session(host)

        assert found == ([] if name == "tclab" else ["the supply was measured"])
        highs = [high for _, high, _ in host.uno.duties]
        assert {2048, 8, 8 * 156, 1024, 8 * 48, 0} <= set(highs)
        assert_low_outside_run(host)


def test_the_analogue_pins_are_those_of_the_layout() -> None:
    readings = {0: 300, 1: 500}  # theta_1, alpha
    for name in SHIELDS:
        with powered(name=name) as host:
            host.uno.stuck = lambda _, channel: readings.get(channel, 900)
            host.start()
            host.drive(0, 2)

            sample = host.last(Sample)
            assert (sample.y0 >> 6, sample.y1 >> 6) == (300, 500 if name == "tclab" else 300)


@needs("avr-gcc")
@pytest.mark.exhaustive
@pytest.mark.parametrize("bug", PLANTED)
def test_a_bug_planted_in_the_pins_of_a_shield_is_seen(bug: str, tmp_path: Path) -> None:
    file, old, new = PLANTED[bug]
    image = broken(tmp_path, BOARD + file, old, new, "tclab")
    uno = Uno(harness(), image, EmulatorSettings(), 0, layout=LAYOUTS["tclab"])
    with closing(uno):
        host = Host(uno)
        host.wait(BOOT_NS / MS)

        try:
            found = session(host)
        except VoltageError as err:  # the emulated rig refuses more than the full scale
            found = [str(err)]
        assert found
