"""Facts that the recording machine contributes to a run: the run's name, the time, the host."""

from __future__ import annotations

import platform
import secrets
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, NamedTuple


class HostFacts(NamedTuple):
    """Facts about the machine and the time of a run."""

    run_id: Callable[[bytes], str]
    """Returns the name of a run, 8 hexadecimal digits; it may depend on the run's codes."""
    now: Callable[[], datetime]
    """Returns the time of day, with its offset from UTC."""
    host: dict[str, Any]
    """Description of the host in a recording, in addition to the loop's description."""


def of_this_host() -> HostFacts:
    """Return the facts of this machine."""
    uname = platform.uname()
    return HostFacts(
        run_id=lambda _: secrets.token_hex(4),
        now=lambda: datetime.now(UTC).astimezone(),
        host={
            "kernel": f"{uname.system} {uname.release} {uname.version}",
            "python": platform.python_version(),
        },
    )
