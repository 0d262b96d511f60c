"""What the service says to whoever reads its log or its standard error."""

from __future__ import annotations

import contextlib
import ipaddress
import sys
from collections.abc import Mapping
from datetime import datetime, timedelta

from armrig_core.endpoint import network_address
from armrig_core.journal import log_prefix
from armrig_core.printable import printable

from armrig_daemon.config import Config
from armrig_daemon.pipe import Log, State
from armrig_daemon.service.access import Network
from armrig_daemon.service.systemd import journal_entry, send_to_journal

_SOON = timedelta(days=30)


def served(config: Config, ended_by: str = "Ctrl-C") -> str:
    """Return what is served, and how it is asked and ended."""
    rig = "" if config.rig.id == "1" else f" --rig {config.rig.id}"
    how = f"ask it with `armrig status{rig}`, end it with {ended_by}"
    return f"{line_and_limits(config)}; {how}"


def line_and_limits(config: Config) -> str:
    """Return the line to the device, the voltages of commands, and a key that means nothing."""
    device, limits = config.device, config.limits
    volts = f"{limits.u_min_v:g} to {limits.u_max_v:g} V"
    rest = "" if config.motor.rest_v is None else "; motor.rest_v = 0 means nothing: remove it"
    return f"port {device.port} at {device.baud} baud, {volts}{rest}"


def endpoint_error(endpoint: str, rig: str, err: Exception) -> str:
    """Return why nobody can be served at `endpoint`."""
    if "lock" in str(err):
        return f"a daemon of rig {rig} already runs at {endpoint}; end it, or choose another --rig"
    return f"{endpoint}: {str(err).splitlines()[0][:200]}; see that the directory can be written"


def unreachable(endpoint: str, devices: str) -> str:
    """Return why nobody can reach us by a network, or nothing.

    Parameters
    ----------
    devices : str
        What /proc/net/dev holds: two lines of headings, then one for each interface.
    """
    interfaces = {line.split(":")[0].strip() for line in devices.splitlines()[2:]}
    host, _ = network_address(endpoint) or ("", 0)
    with contextlib.suppress(ValueError):  # a name may lead anywhere
        if ipaddress.ip_address(host).is_loopback:
            return ""
    if interfaces - {"lo"}:
        return ""
    return (
        f"[access] {endpoint}: there is no interface but the loopback: nobody can connect; in a "
        "service PrivateNetwork=no is missing, see docs/access.md"
    )


def reached(network: Network, now: datetime) -> tuple[str, str]:
    """Return, with its level, who may come over a network, and until when."""
    who = f"{network.operators} may drive and {network.observers} may watch, by {network.known_by}"
    text = f"also at {network.endpoint}: {who}"
    if network.is_router:
        text = f"also through the router {network.endpoint}: whom that lets in, by certificate"
    if network.expires is None:
        return "info", text
    text += f"; the rig's certificate counts until {network.expires:%Y-%m-%d}"
    if network.expires - now > _SOON:
        return "info", text
    return "warning", f"{text}: `armrig pki renew rig-ID` makes a new one"


def network_error(endpoint: str, err: Exception) -> str:
    """Return why nobody can be served at the endpoint of a network."""
    if "os error 98" in str(err):  # EADDRINUSE
        return f"[access] listen = {endpoint!r}: another program listens there; take another port"
    if "os error 99" in str(err):  # EADDRNOTAVAIL
        return f"[access] listen = {endpoint!r}: this machine has no such address"
    if "os error 97" in str(err):  # EAFNOSUPPORT
        return (
            f"[access] listen = {endpoint!r}: the sandbox lets no network in; open one by "
            "`systemctl edit armrigd@ID`, as docs/access.md shows"
        )
    if "os error 13" in str(err):  # EACCES
        return f"[access] listen = {endpoint!r}: not permitted; take a port from 1024 on"
    reason = str(err).splitlines()[0][:200]
    return f"[access] listen = {endpoint!r}: {reason}; see that host and port are this machine's"


def state_sentence(state: State, line: str) -> str:
    """Return how the rig is, in a line; `line` tells why no device answers, if none does."""
    if state.reason:
        return printable(f"{state.phase}: {state.reason}; {state.remedy}, then `armrig reset`")
    if line:
        return printable(f"not ready: {line}")
    who = f"{state.owner} has it" if state.owner else "nobody has it"
    return printable(f"{state.phase}, {who}")


def log_line(log: Log) -> str:
    """Return the line of a log record, with the author of a note."""
    return f"note by {log.fields['owner']}: {log.message}" if log.is_note else log.message


def print_line(level: str, message: str, fields: Mapping[str, str] | None = None) -> None:
    """Say a line on standard error; that nobody reads it must not end the service.

    To a terminal with who says it; to the journal, which knows that, with its priority and with
    the fields that it is given, which a terminal is not shown.
    """
    with contextlib.suppress(OSError):
        prefix = log_prefix(level)
        if prefix is not None and fields:
            shown = {name: printable(value) for name, value in fields.items()}
            if send_to_journal(journal_entry(level, printable(message), shown)):
                return
        line = f"armrigd: {level}: {message}" if prefix is None else f"{prefix}{message}"
        print(printable(line), file=sys.stderr, flush=True)
