"""What a board says of itself after its boot: HELLO, and its answer."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import serial
from armrig_core.errors import OperationError
from armrig_protocol.decoder import feed
from armrig_protocol.frame import encode
from armrig_protocol.messages import SCHEMA_HASH, VERSION, Hello, HelloReply

WITHIN_S = 6.0
"""How long a board may take: its boot loader listens for a second or two, in s."""
_AGAIN_S = 0.25  # what comes during the boot is lost


def greeting(port: str, baud: int, within_s: float = WITHIN_S) -> HelloReply | None:
    """Open the port, which resets an Uno, and return its answer to HELLO; None where none comes.

    HELLO commands nothing: whatever the board runs, the motor does not turn by it. The caller
    holds the port (`boards.held`).

    Raises
    ------
    OperationError
        The port cannot be opened, or is gone.
    """
    until_s = time.monotonic() + within_s
    with _opened(port, baud) as line:
        pending, seq = b"", 0
        while time.monotonic() < until_s:
            line.write(b"\0" + encode(Hello(0, seq, VERSION, SCHEMA_HASH)))
            seq += 1
            again_s = time.monotonic() + _AGAIN_S
            while time.monotonic() < again_s:
                pending, messages = feed(pending, line.read(1) + line.read(line.in_waiting))
                for message in messages:
                    if isinstance(message, HelloReply):
                        return message
    return None


@contextmanager
def _opened(port: str, baud: int) -> Iterator[serial.Serial]:
    try:
        with serial.Serial(port, baudrate=baud, timeout=0.02, write_timeout=1.0) as line:
            yield line
    except (OSError, ValueError) as err:  # also SerialException, of a board that is unplugged
        raise OperationError(f"{port}: {' '.join(str(err).split())}") from err
