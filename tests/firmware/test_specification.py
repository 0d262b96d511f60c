"""The specification of the emulated device, applied to the C core: the same tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.daemon.emulator import emulated_host, test_device, test_scheduled
from tests.daemon.emulator.test_device import *  # noqa: F403
from tests.daemon.emulator.test_scheduled import *  # noqa: F403
from tests.firmware.core_device import CoreDevice
from tests.tools import needs

pytestmark = needs("cc", "make")


@pytest.fixture(autouse=True, scope="module")
def core() -> Iterator[None]:
    """Put the C core into each device that these tests make."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (emulated_host, test_device, test_scheduled):
            patch.setattr(module, "Device", CoreDevice)
        yield
