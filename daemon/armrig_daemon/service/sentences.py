"""What the service says to whoever reads its log or its standard error."""

from __future__ import annotations

import contextlib
import sys

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


def endpoint_error(endpoint: str, rig: str, err: Exception) -> str:
    """Return why nobody can be served at `endpoint`."""
    if "lock" in str(err):
        return f"a daemon of rig {rig} already runs at {endpoint}; end it, or choose another --rig"
    return f"{endpoint}: {str(err).splitlines()[0][:200]}; see that the directory can be written"


def print_line(line: str) -> None:
    """Say a line on standard error; that nobody reads it must not end the service."""
    with contextlib.suppress(OSError):
        print(printable(line), file=sys.stderr, flush=True)
