"""Orders to the harness that only tests give: supply, converter, EEPROM, boot loader, counts."""

from __future__ import annotations

from struct import Struct
from typing import NamedTuple

from armrig_daemon.emulator.harness import Harness

_FIGURES = Struct("<6Q")


class Figures(NamedTuple):
    """Counts and times of the harness."""

    last_high: int
    """Cycle at which the PWM pin was last high."""
    interrupts_off_max: int
    """Longest time with interrupts off, in cycles."""
    interrupts_off_pc: int
    """Address in the program at which the longest time with interrupts off began."""
    idle: int
    """Number of cycles asleep."""
    boots: int
    edges: int
    """Number of edges of the PWM pin."""


def optiboot(harness: Harness, version: int, r2: int) -> None:
    """Put a boot loader of `version`, such as 0x0803, into flash; it leaves `r2` in register r2."""
    harness.order(b"O", r2, version)


def supply(harness: Harness, millivolts: int) -> None:
    """Set the supply voltage, in mV."""
    harness.order(b"V", 0, millivolts)


def stand(harness: Harness) -> None:
    """Stop the converter."""
    harness.order(b"S", 0, True)


def eeprom_byte(harness: Harness, us: int) -> None:
    """Set the time to write a byte of the EEPROM, in µs."""
    harness.order(b"B", 0, us)


def read_eeprom(harness: Harness, start: int, n: int) -> bytes:
    """Return n bytes of the EEPROM."""
    harness.order(b"E", start, n)
    return harness.data()


def write_eeprom(harness: Harness, start: int, data: bytes) -> None:
    """Change bytes of the EEPROM."""
    harness.order(b"W", start, len(data), data)


def figures(harness: Harness) -> Figures:
    """Return the counts so far."""
    harness.order(b"F", 0, 0)
    return Figures._make(_FIGURES.unpack(harness.data()))
