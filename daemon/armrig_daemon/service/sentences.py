"""What the service says to whoever reads its log or its standard error."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

from armrig_core.printable import printable

from armrig_daemon.config import Config


def served(config: Config) -> str:
    """Return what is served, and how it is asked and ended."""
    limits = config.limits
    rig = "" if config.rig.id == "1" else f" --rig {config.rig.id}"
    return (
        f"port {config.device.port} at {config.device.baud} baud, {limits.u_min_v:g} to "
        f"{limits.u_max_v:g} V; ask it with `armrig status{rig}`, end it with Ctrl-C"
    )


def left_behind(path: Path, error: str) -> str:
    """Return what is said of an unfinished recording that was found at the start.

    Parameters
    ----------
    path : Path
        Whatever bytes it has: a message is UTF-8.
    error : str
        Why it cannot be looked at; empty for a recording that nobody writes.
    """
    left = "left by a daemon that died; `armrig info` says what it holds"
    found = f"{error}; passed over" if error else left
    return f"{bytes(path).decode(errors='replace')}: {found}"


def endpoint_error(endpoint: str, rig: str, err: Exception) -> str:
    """Return why nobody can be served at `endpoint`."""
    if "lock" in str(err):
        return f"a daemon of rig {rig} already runs at {endpoint}; end it, or choose another --rig"
    return f"{endpoint}: {str(err).splitlines()[0][:200]}; see that the directory can be written"


def print_line(line: str) -> None:
    """Say a line on standard error; that nobody reads it must not end the service."""
    with contextlib.suppress(OSError):
        print(printable(line), file=sys.stderr, flush=True)
