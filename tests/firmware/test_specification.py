"""What the emulated device is specified to do, asked of the C core: the same tests."""

from __future__ import annotations

from collections.abc import Iterator

import emulated_host
import pytest
import test_device
import test_scheduled
from test_device import *  # noqa: F403
from test_scheduled import *  # noqa: F403
from tools import needs

from firmware.core_device import CoreDevice

pytestmark = needs("cc", "make")


@pytest.fixture(autouse=True, scope="module")
def core() -> Iterator[None]:
    """Put the C core into each device that these tests make."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (emulated_host, test_device, test_scheduled):
            patch.setattr(module, "Device", CoreDevice)
        yield
