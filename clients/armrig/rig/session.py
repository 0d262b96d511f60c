"""Connection to a daemon: its endpoint, its zenoh session, and the errors for missing replies."""

from __future__ import annotations

import json
import os
import socket
import ssl
import tempfile
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import zenoh
from armrig_core.access import daemon_lock
from armrig_core.access.client_settings import ClientSettings, client_settings
from armrig_core.access.credential import Credential, read_credential, utc
from armrig_core.access.endpoint import (
    SERVICE_USER,
    SERVICES,
    endpoint,
    network_address,
    require_trusted,
    socket_directory,
)
from armrig_core.errors import FileError, InputError, OperationError
from armrig_core.process.printable import printable
from armrig_core.recording_file.recording_directory import configuration_files, of_rig
from armrig_core.telemetry.topics import PLAYED, check_rig_id, is_rig_id

UNIT = Path("/etc/systemd/system/armrigd@.service")
"""Path of the systemd unit of the rigs' services; the file exists if a service is installed."""
MOST_RECEIVED = 16 << 20
"""Longest received message, in B; a longer message ends the connection."""
LONGEST_S = 3.0
"""Longest time of each step of a test connection, in s."""
_RETRY_MS = 500
_ANSWER_TIMEOUT_S = 1.0  # in TLS 1.3, a refusal of the certificate follows after the handshake
# X509_V_ERR_… of OpenSSL, x509_vfy.h
_NOT_YET, _EXPIRED, _OTHER_HOST = 9, 10, (62, 64)


class RigError(OperationError):
    """A rig refuses a command, or the connection fails; the message contains the remedy.

    Examples
    --------
    >>> try:
    ...     with armrig.Rig("no-such-rig") as rig:
    ...         print(rig.status())
    ... except armrig.RigError as err:
    ...     print(err)
    no rig no-such-rig runs here; in another terminal: `armrig lab ...
    """

    def __init__(self, message: str) -> None:
        """Store the message; replace its unprintable characters by escapes."""
        super().__init__(printable(message))


class NoReplyError(RigError):
    """The daemon does not reply; `endpoint` is the place where it listens, if that is known."""

    def __init__(self, message: str, endpoint: str = "") -> None:
        super().__init__(message)
        self.endpoint = endpoint


class LostLinkError(NoReplyError):
    """The link to a rig was lost during a run, and did not return in time."""


class ServiceStoppedError(RigError):
    """The service of a rig of this machine stopped during a run."""

    def __init__(self, rig: str) -> None:
        super().__init__(service_stop_sentence(rig))


class Connection(NamedTuple):
    """An open session, which must be closed."""

    session: zenoh.Session
    endpoint: str
    name: str
    """Client's name, from its certificate; "" for a socket.

    The keys of the client's commands contain this name.
    """


class _Way(NamedTuple):
    endpoint: str
    name: str = ""
    proof: tuple[tuple[str, Any], ...] = ()
    """Part of zenoh's configuration that proves the client's identity."""
    fault: Callable[[], str] = str
    """Function that returns the reason for a failed connection; "" if the reason is unknown."""


def default_endpoint(rig: str) -> str:
    """Return the endpoint at which this user's own daemon of a rig listens."""
    return endpoint(rig, _socket_directory())


def own_endpoint(rig: str) -> str:
    """Return an endpoint for this process, in a directory that only this user can open.

    Raises RigError if another user owns the directory or may write to it, or the directory cannot
    be created.
    """
    directory = Path(_socket_directory())
    try:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as err:
        raise RigError(
            f"{directory}: {err.strerror}; set XDG_RUNTIME_DIR to a directory of yours"
        ) from err
    where = default_endpoint(rig)
    _check_directory(directory, {os.getuid()})
    return where


def client_endpoint(rig: str) -> str:
    """Return the endpoint in `[client]`; if there is none, the endpoint of this user's daemon."""
    return _settings(rig).connect or default_endpoint(rig)


def connect_setting() -> str:
    """Return the endpoint in `[client]`; "" if it is not configured."""
    return _settings("").connect


def local_rigs() -> list[str]:
    """Return the ids of the rigs that have a socket of this user's daemon or of a service."""
    places = [Path(_socket_directory()), *Path(SERVICES).glob("*")]
    names = {path.stem for place in places for path in place.glob("*.sock")}
    return sorted(name for name in names if is_rig_id(name) and not name.startswith(PLAYED))


def open_endpoint(where: str) -> Connection:
    """Connect to an endpoint with several rigs, such as a router.

    Raises NoReplyError if nobody listens at the endpoint. Raises RigError if `where` is not an
    endpoint, or the credential in `[client]` cannot be used.
    """
    way = _way(where, None, _settings(""))
    try:
        return Connection(zenoh.open(_config(way)), way.endpoint, way.name)
    except zenoh.ZError as err:
        fault = way.fault() or "check that `armrig router` or armrigd runs there"
        raise NoReplyError(f"nobody answers at {where}: {fault}") from err


def open_session(
    connect: str | None, *, rig: str, certificate: str | Path | None = None
) -> zenoh.Session:
    """Connect as `open_connection` does, but return only the session."""
    return open_connection(connect, rig=rig, certificate=certificate).session


def open_connection(
    connect: str | None, *, rig: str, certificate: str | Path | None = None
) -> Connection:
    """Connect to a daemon as a client of its endpoint; the arguments are those of `armrig.Rig`.

    The directories of local sockets must be writable for their owners only.

    Raises NoReplyError if nobody listens at the endpoint. Raises RigError if `connect` is not an
    endpoint, the credential cannot be used, or another user owns the directory of a socket or may
    write to it.
    """
    settings = _settings(rig)
    where = connect or settings.connect
    ways = [_way(where, certificate, settings)] if where else _local_ways(rig)
    for way in ways:
        try:
            return Connection(zenoh.open(_config(way)), way.endpoint, way.name)
        except zenoh.ZError:
            continue
    # A dead daemon of this user must not hide a living service.
    alive = [way for way in ways if daemon_lock.living_daemon(way.endpoint)]
    way = [*alive, *ways][0]
    is_local = not (where or rig.startswith(PLAYED) or alive)
    if is_local and way.endpoint == default_endpoint(rig):
        named = ("", "") if rig == "1" else (f" {rig}", f" --rig {rig}")
        msg = "no rig{} runs here; in another terminal: `armrig lab{}`; "
        msg += "a rig elsewhere needs --connect ENDPOINT"
        raise NoReplyError(msg.format(*named), way.endpoint)
    raise no_reply(rig, way.endpoint, way.fault())


def _config(way: _Way) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in (
        ("mode", "client"),
        ("connect/endpoints", [way.endpoint]),
        # zenoh uses only the given endpoint, without discovery.
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
        ("transport/shared_memory/enabled", False),
        # A client connects again to a router that was away, within a second of its return.
        ("connect/retry", {"period_init_ms": _RETRY_MS, "period_max_ms": _RETRY_MS}),
        # All messages of a daemon are shorter. The limit is needed because another program may
        # listen at the endpoint.
        ("transport/link/rx/max_message_size", MOST_RECEIVED),
        *way.proof,
    ):
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as err:
            raise RigError(
                f"{way.endpoint!r}: not a zenoh endpoint, such as unixsock-stream/run/armrig/1.sock"
            ) from err
    return config


def _settings(rig: str) -> ClientSettings:
    if rig:
        check_rig_id(rig)
    try:
        return client_settings(configuration_files(rig), os.environ)
    except ValueError as err:
        raise RigError(str(err)) from err


def _way(where: str, certificate: str | Path | None, settings: ClientSettings) -> _Way:
    """Return the connection to an endpoint, with the necessary proof of identity."""
    if not where.startswith("tls/"):
        return _Way(where)
    if not (certificate or settings.certificate):
        raise RigError(
            f"{where} needs your certificate: name its file in [client] certificate of "
            "~/.config/armrig/armrig.toml, or in ARMRIG_CLIENT_CERTIFICATE"
        )
    path = Path(certificate or settings.certificate)
    try:
        credential = read_credential(path, "client")
    except FileError as err:
        raise RigError(str(err)) from err
    proof = ("transport/link/tls", credential.tls("connect"))
    address = network_address(where)
    if address is None:
        raise RigError(
            f"{where!r} is not an endpoint: it must be tls/HOST:PORT, such as tls/lab-1.local:7447"
        )
    return _Way(
        where, credential.name, (proof,), partial(why_not_connected, *address, credential, path)
    )


def _local_ways(rig: str) -> list[_Way]:
    """Return connections to the sockets of this user's daemon and of this machine's service."""
    user_directory, services = Path(_socket_directory()), Path(SERVICES)
    ways = []
    for directory, above, owners in (
        (user_directory, None, {os.getuid()}),
        (services / check_rig_id(rig), services, daemon_lock.service_owners()),
    ):
        where = endpoint(rig, PurePosixPath(directory))
        if directory.is_symlink() or directory.exists():
            for checked in filter(None, (above, directory)):
                _check_directory(checked, owners)
            if directory != user_directory and not os.access(directory, os.X_OK):
                raise RigError(
                    f"{directory}: only the group {SERVICE_USER} may operate rig {rig}: "
                    f"`sudo usermod -aG {SERVICE_USER} $USER`, then log in again"
                )
            if daemon_lock.has_socket(where):
                ways.append(_Way(where))
    return ways or [_Way(_service_endpoint(rig) if is_served(rig) else default_endpoint(rig))]


def _service_endpoint(rig: str) -> str:
    return endpoint(rig, PurePosixPath(SERVICES) / rig)


def is_served(rig: str) -> bool:
    """Return whether a service of this machine is configured for a rig."""
    return UNIT.exists() and of_rig(rig).exists()


def _socket_directory() -> PurePosixPath:
    if not hasattr(os, "getuid"):  # Windows
        raise RigError(
            "there is no daemon here: a rig is driven from Linux; name its endpoint with --connect"
        )
    return socket_directory(os.environ, uid=os.getuid(), temporary=tempfile.gettempdir())


def _check_directory(directory: Path, owners: Collection[int]) -> None:
    """Raise RigError for a directory that another user may have created."""
    try:
        require_trusted(directory.lstat(), owners=owners)
    except InputError as err:
        raise RigError(
            f"{directory}: {err}, so a stranger may listen there; set XDG_RUNTIME_DIR to a "
            "directory of yours, for armrigd too, or name the endpoint with --connect"
        ) from err


def not_permitted(rig: str, where: str, name: str, command: str) -> NoReplyError:
    """Return the error for a daemon that does not answer a client's command over a network."""
    return NoReplyError(
        f"no reply from rig {rig} at {where} to {command!r}: not running, or not permitted: "
        f"look for {name} in the access list of the rig"
    )


def no_reply(rig: str, where: str, fault: str = "") -> NoReplyError:
    """Return the error for a daemon that does not answer; `fault` is a known reason."""
    if rig.startswith(PLAYED):
        return NoReplyError(
            f"no reply from {rig} at {where}: a played recording takes no commands; "
            f"start it with `armrig play F`, watch it with `armrig watch --rig {rig}`"
        )
    if pid := daemon_lock.living_daemon(where):
        unit = f"`sudo systemctl stop armrigd@{rig}`"
        return NoReplyError(
            f"rig {rig} at {where}: its daemon (process {pid}) runs, but does not answer: "
            f"{unit if where == _service_endpoint(rig) else f'`kill -9 {pid}`'} ends it, then the "
            "device stops the motor; or use the emergency switch",
            where,
        )
    if service_has_stopped(rig, where):
        return NoReplyError(service_stop_sentence(rig), where)
    if not fault:
        fault = "not running, or not permitted; start it with `armrig lab` or `armrigd run`, "
        fault += "or give its endpoint with --connect"
    return NoReplyError(f"no reply from rig {rig} at {where}: {fault}", where)


def service_has_stopped(rig: str, where: str) -> bool:
    """Return True if the silent endpoint `where` is the socket of this machine's service.

    If the service's folder exists but this user may not enter it, the result is False.
    """
    folder = Path(SERVICES) / rig
    return where == _service_endpoint(rig) and (not folder.exists() or os.access(folder, os.X_OK))


def service_stop_sentence(rig: str) -> str:
    """Return a sentence on a stopped service of this machine, with the remedy."""
    return (
        f"the service of rig {rig} has stopped; `systemctl status armrigd@{rig}`; what was "
        "recorded is in `armrig ls`"
    )


def no_daemon(rig: str, where: str, why: str) -> RigError:
    """Return the error for replies that do not come from a daemon of this version."""
    return RigError(f"rig {rig} at {where}: {why}; the listener is not an armrigd of this version")


def why_not_connected(host: str, port: int, credential: Credential, path: Path) -> str:
    """Try a TLS handshake with a daemon, and return the fault with its remedy; "" without a fault.

    `path` is the file of the client's credential.
    """
    try:
        line = socket.create_connection((host, port), timeout=LONGEST_S)
    except socket.gaierror:
        return f"there is no host {host}: check its spelling"
    except ConnectionRefusedError:
        listener = "armrigd runs, with [access], or `armrig router`"
        return f"nobody listens at port {port} of {host}: check that {listener}"
    except TimeoutError:
        return "no answer: check that the host is on, and that no firewall blocks the connection"
    except OSError as err:
        return f"{err.strerror or err}: check that {host} can be reached from here"
    with line:
        try:
            connected = _context(credential, path).wrap_socket(line, server_hostname=host)
        except ssl.SSLCertVerificationError as err:
            return _of_its_certificate(err, host)
        except OSError:  # includes ssl.SSLError and TimeoutError
            return "the listener does not speak TLS 1.3: check that its [access] listen is tls/"
        with connected:
            return _answer_to_ours(connected, credential)


def _context(credential: Credential, path: Path) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.load_verify_locations(cadata=credential.authority.decode("ascii"))
    context.load_cert_chain(path)
    return context


def _answer_to_ours(connected: ssl.SSLSocket, credential: Credential) -> str:
    """Return why the listener refuses the client's certificate; "" if the listener accepts it."""
    connected.settimeout(_ANSWER_TIMEOUT_S)
    try:
        connected.recv(1)
    except TimeoutError:
        return ""
    except ssl.SSLError as err:
        alert = (err.reason or "").rpartition("ALERT_")[2].replace("_", " ").lower()
        if "expired" in alert:  # zenoh also sends this alert before the time of a certificate
            begins, expires = utc(credential.begins), utc(credential.expires)
            return (
                f"by its clock, the listener refuses the certificate of {credential.name}, which "
                f"is not valid before {begins} and after {expires}: check the listener's clock"
            )
        return (
            f"the listener refuses the certificate of {credential.name} ({alert}): check that both "
            "certificates are of one authority, and that the clock of the listener's machine is set"
        )
    except OSError:
        return ""
    return ""


def _of_its_certificate(err: ssl.SSLCertVerificationError, host: str) -> str:
    if err.verify_code in _OTHER_HOST:
        return (
            f"the listener's certificate is not for {host}: use a name in it, or make "
            f"another certificate by `armrig pki rig ID --host {host}`"
        )
    if err.verify_code == _NOT_YET:
        return "the listener's certificate is not valid yet: check the clocks of both machines"
    if err.verify_code == _EXPIRED:
        return "the listener's certificate has expired: `armrig pki renew` makes a new one"
    return (
        "the authority that signed your certificate did not sign the listener's certificate "
        f"({err.verify_message}): the listener belongs to another laboratory, or to a stranger"
    )
