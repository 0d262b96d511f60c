"""ESTOP for a device whose daemon has died: sent three times, with a check of the answer."""

from __future__ import annotations

import contextlib
import select
import time

from armrig_protocol.decoder import feed
from armrig_protocol.frame import Spoilt, Unknown, encode
from armrig_protocol.messages import Estop, Event, Message
from armrig_protocol.messages import State as DeviceState

from armrig_daemon.loop.link import Link, TakenPortError, open_link

WITHIN_S = 0.5
"""Longest duration of a call of `estop`, in s, by default."""
_PORT_WAIT_S = 0.2  # a dying daemon releases its port within milliseconds
_ESTOP_COUNT = 3  # PROTOCOL.md, section 9, ESTOP
_SPACING_S = 0.02  # a burst of noise that spoils one frame does not spoil them all
_POLL_S = 0.01


def estop(
    port: str, baud: int, *, within_s: float = WITHIN_S, port_wait_s: float = _PORT_WAIT_S
) -> bool:
    """Send ESTOP three times; return whether the device reported that it has stopped.

    Opening the port may reset the device. A reset device is at 0 V and discards all bytes that
    arrive while it boots. When it reports that it has booted, ESTOP is sent three more times.

    If a daemon has opened the port, no byte is sent and the daemon is not disturbed.

    Raises LinkError if the port cannot be opened or written; `TakenPortError` if another program
    has opened it.
    """
    until_s = time.monotonic() + within_s
    link = _open_port(port, baud, time.monotonic() + port_wait_s)
    try:
        pending, has_to_hear, seq = b"", True, 0
        while (now_s := time.monotonic()) < until_s:
            last = seq + _ESTOP_COUNT if has_to_hear else seq
            heard = []
            while seq < last:
                # The leading 00 ends an unfinished frame of another sender.
                link.write(b"\0" + encode(Estop(0, seq)))
                seq += 1
                pending, messages = _hear(link, pending, time.monotonic() + _SPACING_S)
                heard += messages
            pending, messages = _hear(link, pending, min(until_s, now_s + _POLL_S))
            heard += messages
            if any(message.state == DeviceState.ESTOP for message in heard):
                return True
            has_to_hear = any(isinstance(m, Event) and m.was == DeviceState.BOOT for m in heard)
        return False
    finally:
        link.close()


def _open_port(port: str, baud: int, until_s: float) -> Link:
    """Open the port; if another program holds the port, try again until `until_s`."""
    while time.monotonic() < until_s:
        with contextlib.suppress(TakenPortError):
            return open_link(port, baud)
        time.sleep(_POLL_S)
    return open_link(port, baud)


def _hear(link: Link, pending: bytes, until_s: float) -> tuple[bytes, list[Message]]:
    """Return the bytes of an unfinished frame, and the messages that arrive until `until_s`."""
    heard: list[Message] = []
    while (left_s := until_s - time.monotonic()) > 0:
        if select.select([link.fd], [], [], left_s)[0] or link.has_rest:
            pending, messages = feed(pending, link.read())
            heard += [m for m in messages if not isinstance(m, Spoilt | Unknown)]
    return pending, heard
