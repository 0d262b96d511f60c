"""The last value that is allowed and the first that is not, with both firmwares."""

from __future__ import annotations

import pytest
from armrig_protocol.messages import Code, Config, ConfigReply

from tests.daemon.emulator.emulated_host import CONFIG
from tests.firmware.both_devices import MS, BothDevices
from tests.firmware.test_wraps import INSTANT
from tests.tools import needs

pytestmark = needs("cc", "make")


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"u_min": 300, "u_max": 300}, Code.OK),
        ({"u_min": 301, "u_max": 300}, Code.BAD_VALUE),
        ({"u_min": 300, "u_max": 400, "u_rest": 300}, Code.OK),
        ({"u_min": 300, "u_max": 400, "u_rest": 400}, Code.OK),
        ({"u_min": 300, "u_max": 400, "u_rest": 401}, Code.BAD_VALUE),
        ({"u_min": 300, "u_max": 400, "u_rest": 299}, Code.BAD_VALUE),
        ({"ts_us": 208 + 254 * 208, "oversampling": 255}, Code.OK),
        ({"ts_us": 207 + 254 * 208, "oversampling": 255}, Code.BAD_VALUE),
        ({"oversampling": 0, "ts_us": 2**32 - 1}, Code.BAD_VALUE),
    ],
)
def test_a_configuration_is_accepted_exactly_up_to_its_bounds(
    fields: dict[str, int], code: int
) -> None:
    """One code is a range, too; the shortest Ts grows with the oversampling."""
    both = BothDevices(INSTANT)
    both.wait(1 * MS)

    both.put(Config, **{**CONFIG, **fields})
    both.wait(1 * MS)

    assert [m.code for m in both.heard if isinstance(m, ConfigReply)] == [code]
