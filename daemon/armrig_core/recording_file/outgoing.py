"""The form of a message before it is published and recorded."""

from __future__ import annotations

from typing import NamedTuple


class Outgoing(NamedTuple):
    """One message on its way to the subscribers and the file."""

    stream: str
    t_host_ns: int
    """Monotonic time of the content, in ns."""
    t_sched_ns: int
    """Monotonic time at which the content was due, in ns."""
    sequence: int
    data: bytes
