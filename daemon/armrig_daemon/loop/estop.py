"""The last word to a device whose daemon has died: ESTOP, three times, and what it answers."""

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
"""How long all of it may take, in s."""
_FREE_S = 0.2  # a daemon that is dying gives its port back within milliseconds
_TIMES = 3  # PROTOCOL.md, section 9, ESTOP
_APART_S = 0.02  # a burst that spoils one frame does not spoil them all
_LOOK_S = 0.01


def estop(port: str, baud: int) -> bool:
    """Send ESTOP three times; return whether the device said that it has stopped.

    A device that is reset by the opening of its port is at 0 V by that, throws away what comes
    while it boots, and is sent ESTOP three times more when it says that it has booted.

    Of a daemon that holds the port nothing is taken and nothing is disturbed: not a byte is sent.

    Raises
    ------
    LinkError
        The port cannot be opened, or takes no bytes; `TakenPortError` where another holds it.
    """
    until_s = time.monotonic() + WITHIN_S
    link = _opened(port, baud, time.monotonic() + _FREE_S)
    try:
        pending, has_to_hear, seq = b"", True, 0
        while (now_s := time.monotonic()) < until_s:
            last = seq + _TIMES if has_to_hear else seq
            heard = []
            while seq < last:
                # Begun by a 00: what another sender has left half said is then no part of it.
                link.write(b"\0" + encode(Estop(0, seq)))
                seq += 1
                pending, messages = _hear(link, pending, time.monotonic() + _APART_S)
                heard += messages
            pending, messages = _hear(link, pending, min(until_s, now_s + _LOOK_S))
            heard += messages
            if any(message.state == DeviceState.ESTOP for message in heard):
                return True
            has_to_hear = any(isinstance(m, Event) and m.was == DeviceState.BOOT for m in heard)
        return False
    finally:
        link.close()


def _opened(port: str, baud: int, until_s: float) -> Link:
    """Open the port; one that is taken is tried again for a while."""
    while time.monotonic() < until_s:
        with contextlib.suppress(TakenPortError):
            return open_link(port, baud)
        time.sleep(_LOOK_S)
    return open_link(port, baud)


def _hear(link: Link, pending: bytes, until_s: float) -> tuple[bytes, list[Message]]:
    """Return what is left over, and what the device has said by then."""
    heard: list[Message] = []
    while (left_s := until_s - time.monotonic()) > 0:
        if select.select([link.fd], [], [], left_s)[0] or link.has_rest:
            pending, messages = feed(pending, link.read())
            heard += [m for m in messages if not isinstance(m, Spoilt | Unknown)]
    return pending, heard
