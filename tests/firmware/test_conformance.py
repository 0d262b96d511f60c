"""The C core obeys PROTOCOL.md, rule by rule, as a board in a laboratory must."""

from __future__ import annotations

import pytest
from armrig_daemon.conformance.host import LineHost
from armrig_daemon.conformance.line import VirtualLine
from armrig_daemon.conformance.suite import FAIL, NOT_TRIED, run
from armrig_daemon.emulator.settings import EmulatorSettings

from tests.daemon.conformance.spoilt_devices import AT_A_RAIL
from tests.firmware.core_device import CoreDevice
from tests.tools import needs

pytestmark = needs("cc", "make")


@pytest.mark.parametrize(
    ("resets", "settings"),
    [(True, {"queue": 256}), (False, {"baud": 1_000_000})],
    ids=str,
)
def test_the_c_core_passes_all_rules_of_the_protocol(
    settings: dict[str, int], resets: bool
) -> None:
    emulated = EmulatorSettings(boot_ms=5.0, **AT_A_RAIL, **settings)
    device = CoreDevice(emulated, 0)

    results = run(LineHost(VirtualLine(device, resets=resets), emulated.baud), lambda result: None)

    assert [r for r in results if r.outcome == FAIL] == []
    assert [r.outcome for r in results].count(NOT_TRIED) == (not resets)
    assert device.board.volts == 0.0
