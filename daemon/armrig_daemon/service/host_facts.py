"""What a run takes from the machine that it runs on: its name, the time of day, the host."""

from __future__ import annotations

import platform
import secrets
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, NamedTuple


class HostFacts(NamedTuple):
    """Where and when runs are made."""

    run_id: Callable[[bytes], str]
    """Draws the name of a run, 8 hexadecimal digits; it may follow from the run's codes."""
    now: Callable[[], datetime]
    """Return the time of day, with its offset from UTC."""
    host: dict[str, Any]
    """What a recording says of the host, beside what the loop tells of it."""


def of_this_host() -> HostFacts:
    """Return what is so here and now."""
    uname = platform.uname()
    return HostFacts(
        run_id=lambda _: secrets.token_hex(4),
        now=lambda: datetime.now(UTC).astimezone(),
        host={
            "kernel": f"{uname.system} {uname.release} {uname.version}",
            "python": platform.python_version(),
        },
    )
