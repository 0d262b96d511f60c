"""Frames of the host as the checks know them, and the effects of a replayed frame."""

from __future__ import annotations

import msgspec
from armrig_protocol.frame import decode
from armrig_protocol.messages import Exchange, Setpoints


class Frame(msgspec.Struct, frozen=True, gc=False):
    """A frame that the host sent."""

    type: int
    seq: int
    t_ns: int
    session: int
    """Number of the session: seq begins again at each start of the host and each link."""
    grant: int
    """Under which lease; 0 is none."""
    code: int
    """Code held by hand at that time; -1 in an experiment."""
    command_ns: int
    """Time at which its command was given."""
    stale: bool
    """Sent when the round trip was too old to drive on."""
    reset: bool
    """A person had requested a reset since the last trip."""
    data: bytes
    host_ns: int
    """Time of sending, by the host's clock; `t_ns` and `command_ns` are given times."""


def exchange(data: bytes) -> Exchange | None:
    """Return the EXCHANGE in the bytes of a frame; None for another frame."""
    m = decode(data[:-1])
    return m if isinstance(m, Exchange) else None


def ask_the_same(a: Frame, b: Frame) -> bool:
    """Return whether two frames are EXCHANGEs for the same sample."""
    m, n = exchange(a.data), exchange(b.data)
    return m is not None and n is not None and m.k == n.k


def may_exchange(frame: Frame, code: int, k: int, *, last_k: int, last_code: int, slew: int) -> str:
    """Return why an EXCHANGE that is played again may not be latched, or nothing.

    PROTOCOL.md, section 7: in RUN it is, where its k is ahead, in range and within `slew`. Here its
    code must have been a command in its own time, too.
    """
    m = exchange(frame.data)
    if m is None or (m.u, m.k) != (code, k):
        return "it says something else"
    if not frame.grant or frame.stale:
        return "it was no command when it was sent"
    if last_k >= 0 and not 1 <= (k - last_k) & 0xFFFFFFFF < 1 << 31:
        return f"its k={k} is not ahead of {last_k}"
    if slew and abs(code - last_code) > slew:
        return f"it is further than {slew} from {last_code}"
    return ""


def may_fill(frame: Frame, code: int, k: int) -> str:
    """Return why SETPOINTS that are played again may not have supplied sample `k`, or nothing."""
    m = decode(frame.data[:-1])
    if not isinstance(m, Setpoints) or not m.k0 <= k < m.k0 + m.n or m.u[k - m.k0] != code:
        return "it says something else"
    return "" if frame.grant else "it was no command when it was sent"
