"""A message on its way to the subscribers and into the file."""

from __future__ import annotations

from typing import NamedTuple


class Outgoing(NamedTuple):
    """One message on its way to the subscribers and the file."""

    stream: str
    t_host_ns: int
    """Monotonic time of what it tells."""
    t_sched_ns: int
    """Monotonic time when that was due."""
    sequence: int
    data: bytes
