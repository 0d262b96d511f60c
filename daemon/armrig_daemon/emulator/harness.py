"""Pipe to the harness, the program that runs the firmware's binary (firmware_protocol/simavr).

Time is virtual, in cycles of the processor, and advances only at a command of this module.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from enum import IntEnum
from pathlib import Path
from struct import Struct
from typing import IO, Final, NamedTuple, Self

from armrig_core.errors import OperationError

CYCLES_PER_US: Final = 16
_ORDER = Struct("<cQI")
_RECORD = Struct("<BQI")
_READING = Struct("<H")


class Violation(IntEnum):
    """Forbidden events on the board: `fil` detects 1 to 4 (fil.h), the module `pin` 5 and 6."""

    sentence: str
    """Description of the event for a person."""

    PIN_HIGH_WITHOUT_ENABLE = 1, "the motor's pin is high while the enable line is low"
    RX_OVERRUN = 2, "a byte was lost in the receiver"  # which can store only two bytes
    TX_OVERRUN = 3, "a byte was written into a full transmit buffer"
    CPU_STOPPED = 4, "the processor left its program, or sleeps with interrupts off"
    DRIVEN_OUTSIDE_RUN = 5, "the motor's pin or its enable line is high outside RUN"
    CODE_NOT_AT_PIN = 6, "the motor's pin has another duty than SAMPLE reports"

    def __new__(cls, number: int, sentence: str = "") -> Self:
        """Create a member from its number and its sentence."""
        member = int.__new__(cls, number)
        member._value_, member.sentence = number, sentence
        return member


class Duty(NamedTuple):
    """Duty of the PWM pin, measured over one PWM period; it is valid until the next `Duty`."""

    cycle: int
    high: int
    """Number of cycles of the period during which the pin is high."""
    enabled: bool
    """Level of the enable line; false if the layout has no enable line."""


class Left(NamedTuple):
    """A byte was sent to the host."""

    cycle: int
    byte: int


class Violated(NamedTuple):
    """A forbidden event."""

    cycle: int
    what: Violation


Record = Duty | Left | Violated
Convert = Callable[[int, int], int]
"""Function of a cycle and a channel that returns the channel's reading, 10 bits, at the cycle."""


class Harness:
    """A simulated Uno, switched on at cycle 0."""

    def __init__(
        self,
        program: Path,
        image: Path,
        *,
        baud: int,
        pwm: str = "D9",
        trace: Path | None = None,
    ) -> None:
        """Start the harness.

        `baud` is the speed of the host's line, in bit/s. `pwm` is the pin to measure, D9 or D3.
        `trace` is a VCD file with the levels of the PWM pin and the enable line.
        """
        arguments = [str(program), "--baud", str(baud), "--pwm", pwm]
        if trace is not None:
            arguments += ["--vcd", str(trace)]
        try:
            self._process = subprocess.Popen(
                [*arguments, str(image)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C goes to this process, which ends the harness
            )
        except OSError as err:
            raise OperationError(f"{program}: {err.strerror}") from err
        self.cycle = 0

    def advance(
        self, cycle: int, convert: Convert, *, until_frame: bool = False
    ) -> Iterator[Record]:
        """Advance to a cycle or, with `until_frame`, to the end of a sent frame; yield the records.

        `convert` is called for each conversion. The caller must consume all records.
        """
        self.order(b"A", cycle, until_frame)
        while True:
            kind, cycle, value = _RECORD.unpack(self._read(_RECORD.size))
            match chr(kind):
                case "a":
                    self._in.write(_READING.pack(convert(cycle, value)))
                    self._in.flush()
                case "t":
                    yield Left(cycle, value)
                case "v":
                    yield Duty(cycle, value & 0xFFFF, bool(value >> 16))
                case "x":
                    yield Violated(cycle, Violation(value))
                case "d":
                    self.cycle = cycle
                    return

    def send(self, cycle: int, data: bytes) -> None:
        """Put bytes on the line to the device at `cycle`, or as soon as the line is free."""
        self.order(b"I", cycle, len(data), data)

    def reset(self, deaf_cycles: int = 0) -> None:
        """Reset the board; for `deaf_cycles`, a boot loader runs, which clears MCUSR."""
        self.order(b"R", 0, deaf_cycles)

    def close(self) -> None:
        """End the harness."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(BrokenPipeError):  # the harness has ended, and an order is unread
                    pipe.close()
        self._process.wait()

    @property
    def _in(self) -> IO[bytes]:
        if self._process.stdin is None:
            raise OperationError("the harness has no input")
        return self._process.stdin

    def order(self, order: bytes, cycle: int, n: int, data: bytes = b"") -> None:
        """Send an order of firmware_protocol/simavr/README.md."""
        try:
            self._in.write(_ORDER.pack(order, cycle, n) + data)
            self._in.flush()
        except BrokenPipeError as err:
            raise OperationError(
                f"the harness ended with exit code {self._process.wait()}"
            ) from err

    def _read(self, n: int) -> bytes:
        pipe = self._process.stdout
        data = pipe.read(n) if pipe is not None else b""
        if len(data) < n:
            raise OperationError(f"the harness ended with exit code {self._process.wait()}")
        return data

    def data(self) -> bytes:
        """Return the answer to an order."""
        _, _, n = _RECORD.unpack(self._read(_RECORD.size))
        return self._read(n)
