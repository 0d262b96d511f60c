"""The rules for boards' names, as udev reads them; the boards' properties are invented."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.systemd.machine import Machine
from tests.tools import needs

pytestmark = [
    pytest.mark.machine,
    needs("udevadm"),
]
RULES = Path("/etc/udev/rules.d")
USB = 'ENV{ID_BUS}="usb", ENV{ID_PATH_TAG}="pci-0000_00_14_0-usb-0_2_1_0"'


def _properties(machine: Machine, board: str) -> list[str]:
    """Return what udev knows of a terminal of this kind."""
    machine.write(RULES / "65-made-up.rules", f'KERNEL=="tty", {board}\n')
    done = machine.run("udevadm", "test", "--action=add", "/sys/class/tty/tty")
    assert "70-armrig.rules:" not in "".join(
        line for line in done.stderr.splitlines() if "nvalid" in line or "nknown" in line
    )
    return done.stdout.splitlines()


@pytest.mark.parametrize(
    ("board", "name"),
    [
        (
            f'{USB}, ENV{{ID_VENDOR_ID}}="2341", ENV{{ID_SERIAL_SHORT}}="5563930353535"',
            "/dev/armrig-5563930353535",
        ),
        (
            f'{USB}, ENV{{ID_VENDOR_ID}}="1a86"',
            "/dev/armrig-pci-0000_00_14_0-usb-0_2_1_0",
        ),
    ],
)
def test_a_board_has_one_persistent_name(machine: Machine, board: str, name: str) -> None:
    properties = _properties(machine, board)

    assert f"DEVLINKS={name}" in properties
    assert "ID_MM_DEVICE_IGNORE=1" in properties


@pytest.mark.parametrize(
    "other", [f'{USB}, ENV{{ID_VENDOR_ID}}="1199"', 'ENV{ID_VENDOR_ID}="2341"']
)
def test_a_device_that_is_not_a_board_gets_no_name(machine: Machine, other: str) -> None:
    assert not [line for line in _properties(machine, other) if "armrig" in line or "MM" in line]
