"""The Uno's binary does what PROTOCOL.md says, rule by rule.

In simavr, in virtual time; the PWM pin is judged in addition to the answers.
"""

from __future__ import annotations

from contextlib import closing
from itertools import product

import pytest
from armrig_daemon.conformance.host import LineHost
from armrig_daemon.conformance.line import VirtualLine
from armrig_daemon.conformance.rule import Result
from armrig_daemon.conformance.suite import FAIL, NOT_TRIED, run
from armrig_daemon.emulator.harness import Violation
from armrig_daemon.emulator.settings import EmulatorSettings

from tests.daemon.conformance.spoilt_devices import AT_A_RAIL
from tests.firmware.uno_host import switch_on
from tests.sampling import sampled
from tests.tools import needs

pytestmark = needs("cc", "make", "simavr")


@pytest.mark.parametrize(
    ("name", "resets", "boot_loader"),
    sampled(
        [
            *product(["uno", "tclab"], [True, False], [False]),
            ("heatshield", True, False),
            ("optoshield", True, False),
            ("uno", True, True),
        ]
    ),
)
def test_the_uno_passes_all_rules_of_the_protocol(
    name: str, resets: bool, boot_loader: bool
) -> None:
    """Each rule holds for each image, whether the opening of the port resets the device or not.

    A reset may also end in a boot loader, which is deaf for a second.
    """
    settings = EmulatorSettings(**AT_A_RAIL)
    with closing(switch_on(settings, 0, name, boot_loader=boot_loader)) as uno:
        line = VirtualLine(uno, resets=resets)
        told: list[Result] = []

        run(LineHost(line), told.append)

        assert [r for r in told if r.outcome == FAIL] == []
        assert [r.outcome for r in told].count(NOT_TRIED) == (not resets)
        uno.advance(line.now_ns() + 1_000_000)
        assert (uno.duties[-1].high, uno.duties[-1].enabled) == (0, False)
        assert {v.what for v in uno.violations} == {Violation.RX_OVERRUN}
