"""Sentences of the service for its log and its standard error."""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import sys
from collections.abc import Mapping
from datetime import datetime, timedelta

from armrig_core.access.endpoint import network_address
from armrig_core.access.owned_session import os_error_number
from armrig_core.process.journal import log_prefix
from armrig_core.process.printable import printable

from armrig_daemon.config import Config
from armrig_daemon.pipe import Log, State
from armrig_daemon.service.access import Network
from armrig_daemon.service.host.systemd import journal_entry, send_to_journal

_EXPIRY_NOTICE = timedelta(days=30)


def startup_sentence(config: Config, ended_by: str = "Ctrl-C") -> str:
    """Return the rig's port and limits, and how to request the status and end the service."""
    rig = "" if config.rig.id == "1" else f" --rig {config.rig.id}"
    how = f"ask it with `armrig status{rig}`, end it with {ended_by}"
    return f"{line_and_limits(config)}; {how}"


def line_and_limits(config: Config) -> str:
    """Return the port and the range of voltages."""
    device, limits = config.device, config.limits
    volts = f"{limits.u_min_v:g} to {limits.u_max_v:g} V"
    return f"port {device.port} at {device.baud} baud, {volts}"


def endpoint_error(endpoint: str, rig: str, err: Exception) -> str:
    """Return the reason why the service cannot listen at `endpoint`."""
    if "lock" in str(err):
        return f"a daemon of rig {rig} already runs at {endpoint}; end it, or choose another --rig"
    return f"{endpoint}: {str(err).splitlines()[0][:200]}; check that the directory is writable"


def unreachable(endpoint: str, devices: str) -> str:
    """Return the reason why no client can connect over a network, or an empty text.

    `devices` is the content of /proc/net/dev: two lines of headings, then a line for each
    interface.
    """
    interfaces = {line.split(":")[0].strip() for line in devices.splitlines()[2:]}
    host, _ = network_address(endpoint) or ("", 0)
    with contextlib.suppress(ValueError):  # a name may resolve to any address
        if ipaddress.ip_address(host).is_loopback:
            return ""
    if interfaces - {"lo"}:
        return ""
    return (
        f"[access] {endpoint}: nobody can connect, because the only network interface is the "
        "loopback. If armrigd runs as a service, set PrivateNetwork=no in its unit (docs/access.md)"
    )


def network_notice(network: Network, now: datetime) -> tuple[str, str]:
    """Return a level, and a line with the permitted clients and the expiry of the certificate."""
    who = f"{network.operators} may drive and {network.observers} may watch, by certificate"
    text = f"also at {network.endpoint}: {who}"
    if network.is_router:
        text = f"also through the router {network.endpoint}, for the clients that it admits"
    text += f"; the rig's certificate is valid until {network.expires:%Y-%m-%d}"
    if network.expires - now > _EXPIRY_NOTICE:
        return "info", text
    return "warning", f"{text}: `armrig pki renew rig-ID` makes a new one"


def network_error(endpoint: str, err: Exception) -> str:
    """Return the reason why the service cannot listen at the endpoint of a network."""
    number = os_error_number(err)
    if number == errno.EADDRINUSE:
        return f"[access] listen = {endpoint!r}: another program listens there; use another port"
    if number == errno.EADDRNOTAVAIL:
        return f"[access] listen = {endpoint!r}: this machine has no such address"
    if number == errno.EAFNOSUPPORT:
        return (
            f"[access] listen = {endpoint!r}: the sandbox permits no network; permit one by "
            "`systemctl edit armrigd@ID`, as docs/access.md shows"
        )
    if number == errno.EACCES:
        return f"[access] listen = {endpoint!r}: not permitted; use a port from 1024 on"
    reason = str(err).splitlines()[0][:200]
    way_out = "check that host and port belong to this machine"
    return f"[access] listen = {endpoint!r}: {reason}; {way_out}"


def state_sentence(state: State, line: str) -> str:
    """Return the state of the rig as a line; `line` says why no device answers."""
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
    """Print a line on standard error; a closed standard error must not end the service.

    On a terminal, the program's name precedes the line. The journal knows the name, and
    receives the line with its priority and its fields.
    """
    with contextlib.suppress(OSError):
        prefix = log_prefix(level)
        if prefix is not None and fields:
            printable_fields = {name: printable(value) for name, value in fields.items()}
            if send_to_journal(journal_entry(level, printable(message), printable_fields)):
                return
        line = f"armrigd: {level}: {message}" if prefix is None else f"{prefix}{message}"
        print(printable(line), file=sys.stderr, flush=True)
