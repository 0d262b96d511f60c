"""The way to a daemon: its endpoint, a zenoh session, and the errors where nobody replies."""

from __future__ import annotations

import json
import os
import socket
import ssl
import tempfile
from collections.abc import Callable, Collection
from contextlib import suppress
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import zenoh
from armrig_core.client_settings import ClientSettings, client_settings
from armrig_core.credential import Credential, read_credential
from armrig_core.endpoint import (
    SERVICE_USER,
    SERVICES,
    distrust,
    endpoint,
    network_address,
    socket_directory,
)
from armrig_core.errors import FileError, OperationError
from armrig_core.passwords import read_users
from armrig_core.printable import printable
from armrig_core.recording_directory import installed, of_rig
from armrig_core.topics import PLAYED, check_rig_id, is_rig_id

UNIT = Path("/etc/systemd/system/armrigd@.service")
"""The services of this machine, where they are installed."""
MOST_RECEIVED = 16 << 20
"""Longest message that is received, in B; beyond it the connection ends."""
LONGEST_S = 3.0
"""How long each step may take."""
_LISTENS_S = 1.0  # a certificate is refused after the handshake, in TLS 1.3
# X509_V_ERR_… of OpenSSL, x509_vfy.h
_EXPIRED, _OTHER_HOST = 10, (62, 64)
_SILENT = "nothing answers: see that the host is on, and that no firewall stands between"


class RigError(OperationError):
    """A rig, or the way to it, refuses; the message says what to do."""

    def __init__(self, message: str) -> None:
        """Take the message; characters that do not print, as others may write them, are escaped."""
        super().__init__(printable(message))


class NoReplyError(RigError):
    """Nobody replies."""


class Connection(NamedTuple):
    """An open session, which must be closed."""

    session: zenoh.Session
    endpoint: str
    name: str
    """Under which commands are sent: that in our certificate, or of the user; "" on a socket."""


class _Way(NamedTuple):
    """A way to a daemon that has not been tried yet."""

    endpoint: str
    name: str = ""
    proof: tuple[tuple[str, Any], ...] = ()
    """What of zenoh's configuration shows who we are."""
    fault: Callable[[], str] = str
    """Returns why it came to nothing, "" where that is not known."""


def default_endpoint(rig: str) -> str:
    """Return where the daemon of this user and rig listens."""
    return endpoint(rig, _socket_directory())


def own_endpoint(rig: str) -> str:
    """Return where we listen ourselves under the id `rig`, in a directory of this user's alone.

    Raises
    ------
    RigError
        The directory may be another user's, or there is no place for one.
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


def configured_endpoint(rig: str) -> str:
    """Return the endpoint that `[client]` names, or that of this user's daemon."""
    return _settings(rig).connect or default_endpoint(rig)


def configured_connect() -> str:
    """Return the endpoint that `[client]` names; "" where it names none."""
    return _settings("").connect


def local_rigs() -> list[str]:
    """Return the ids of which there is a socket on this machine, of this user or of a service."""
    places = [Path(_socket_directory()), *Path(SERVICES).glob("*")]
    names = {path.stem for place in places for path in place.glob("*.sock")}
    return sorted(name for name in names if is_rig_id(name) and not name.startswith(PLAYED))


def open_endpoint(where: str) -> Connection:
    """Connect to an endpoint where there may be several rigs, as at a router.

    Raises
    ------
    NoReplyError
        Nobody listens there.
    RigError
        `where` is not an endpoint, or the credential that `[client]` names cannot be used.
    """
    way = _way(where, None, _settings(""))
    try:
        return Connection(zenoh.open(_config(way)), way.endpoint, way.name)
    except zenoh.ZError as err:
        fault = way.fault() or "see that `armrig router` or armrigd runs there"
        raise NoReplyError(f"nobody answers at {where}: {fault}") from err


def open_session(
    connect: str | None, *, rig: str, certificate: str | Path | None = None
) -> zenoh.Session:
    """Return the session of `open_connection`."""
    return open_connection(connect, rig=rig, certificate=certificate).session


def open_connection(
    connect: str | None, *, rig: str, certificate: str | Path | None = None
) -> Connection:
    """Connect to a daemon as a client of its endpoint.

    Parameters
    ----------
    connect : str, optional
        Endpoint; None is that of `[client]`, and where that names none the socket of this user's
        daemon, then that of the service of this machine. Nobody but its owner may be able to put a
        socket into its directory.
    certificate : str or Path, optional
        Our credential, for an endpoint tls/HOST:PORT; that of `[client]` where it is left out.

    Raises
    ------
    NoReplyError
        Nobody listens there.
    RigError
        `connect` is not an endpoint, the credential cannot be used, or the directory may be
        another user's.
    """
    settings = _settings(rig)
    where = connect or settings.connect
    ways = [_way(where, certificate, settings)] if where else _local_ways(rig)
    for way in ways:
        try:
            return Connection(zenoh.open(_config(way)), way.endpoint, way.name)
        except zenoh.ZError:
            continue
    raise no_reply(rig, ways[0].endpoint, ways[0].fault())


def _config(way: _Way) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in (
        ("mode", "client"),
        ("connect/endpoints", [way.endpoint]),
        # Only the endpoint asked for: zenoh looks for nobody else, and tells nobody of us.
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
        ("transport/shared_memory/enabled", False),
        # Longer than anything that a daemon sends. What listens there may not be a daemon.
        ("transport/link/rx/max_message_size", MOST_RECEIVED),
        *way.proof,
    ):
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as err:
            raise RigError(
                f"{way.endpoint!r} is no zenoh endpoint, such as unixsock-stream/run/armrig/1.sock"
            ) from err
    return config


def _settings(rig: str) -> ClientSettings:
    if rig:
        check_rig_id(rig)
    try:
        return client_settings(installed(rig), os.environ)
    except ValueError as err:
        raise RigError(str(err)) from err


def _way(where: str, certificate: str | Path | None, settings: ClientSettings) -> _Way:
    """Return the way to an endpoint, with what is needed there to be let in."""
    try:
        if where.startswith("tls/"):
            return _way_by_certificate(where, certificate or settings.certificate)
        if where.startswith("tcp/") and settings.password:
            ((user, password), *others) = read_users(Path(settings.password)).items()
            if others:
                raise RigError(
                    f"{settings.password}: {1 + len(others)} users: your own line alone is needed"
                )
            proof = ("transport/auth/usrpwd", {"user": user, "password": password})
            return _Way(where, user, (proof,))
    except FileError as err:
        raise RigError(str(err)) from err
    return _Way(where)


def _way_by_certificate(where: str, certificate: str | Path) -> _Way:
    if not certificate:
        raise RigError(
            f"{where}: needs your certificate: name its file in [client] certificate of "
            "~/.config/armrig/armrig.toml, or in ARMRIG_CLIENT_CERTIFICATE"
        )
    path = Path(certificate)
    credential = read_credential(path, "client")
    proof = ("transport/link/tls", credential.tls("connect"))
    address = network_address(where)
    if address is None:
        raise RigError(
            f"{where!r} is no endpoint: it must be tls/HOST:PORT, such as tls/lab-1.local:7447"
        )
    return _Way(
        where, credential.name, (proof,), partial(why_not_connected, *address, credential, path)
    )


def _local_ways(rig: str) -> list[_Way]:
    """Return the sockets of this machine that there are: of this user's daemon, then a service's.

    Where there is none, that of the service if this machine has one, else the first of them.
    """
    own, services = Path(_socket_directory()), Path(SERVICES)
    ways = []
    for directory, above, owners in (
        (own, None, {os.getuid()}),
        (services / check_rig_id(rig), services, _service_owners()),
    ):
        where = endpoint(rig, PurePosixPath(directory))
        if directory.is_symlink() or directory.exists():
            for checked in filter(None, (above, directory)):
                _check_directory(checked, owners)
            if directory != own and not os.access(directory, os.X_OK):
                raise RigError(
                    f"{directory}: only the group {SERVICE_USER} may operate rig {rig}: "
                    f"`sudo usermod -aG {SERVICE_USER} $USER`, then log in anew"
                )
            if (directory / f"{rig}.sock").exists():
                ways.append(_Way(where))
    return ways or [_Way(_service_endpoint(rig) if is_served(rig) else default_endpoint(rig))]


def _service_endpoint(rig: str) -> str:
    return endpoint(rig, PurePosixPath(SERVICES) / rig)


def is_served(rig: str) -> bool:
    """Tell whether a service of this machine is to serve a rig."""
    return UNIT.exists() and of_rig(rig).exists()


def _service_owners() -> set[int]:
    """Return who may own the folder of a service: root, and the user that runs it."""
    from pwd import getpwnam

    with suppress(KeyError):  # there is no such user
        return {0, getpwnam(SERVICE_USER).pw_uid}
    return {0}


def _socket_directory() -> PurePosixPath:
    if not hasattr(os, "getuid"):  # Windows
        raise RigError(
            "there is no daemon here: a rig is driven from Linux; name its endpoint with --connect"
        )
    return socket_directory(os.environ, uid=os.getuid(), temporary=tempfile.gettempdir())


def _check_directory(directory: Path, owners: Collection[int]) -> None:
    """Refuse a directory that others may have made, as anybody could in a temporary one."""
    wrong = distrust(directory.lstat(), owners=owners)
    if wrong:
        raise RigError(
            f"{directory}: {wrong}, so what listens there may be a stranger's; set "
            "XDG_RUNTIME_DIR to a directory of yours, for armrigd too, or name the endpoint "
            "with --connect"
        )


def not_permitted(rig: str, where: str, name: str, command: str) -> NoReplyError:
    """Return the error of a daemon over a network that is connected, and passes a command over."""
    return NoReplyError(
        f"no reply from rig {rig} at {where} to {command!r}: not running, or not permitted: its "
        f"access list says what {name} may do"
    )


def no_reply(rig: str, where: str, fault: str = "") -> NoReplyError:
    """Return the error of a daemon that does not answer; `fault` says why, where that is known."""
    if rig.startswith(PLAYED):
        return NoReplyError(
            f"no reply from {rig} at {where}: a recording that is played again takes no commands; "
            f"start it with `armrig play F`, watch it with `armrig watch --rig {rig}`"
        )
    if stopped := service_has_stopped(rig, where):
        return NoReplyError(stopped)
    if fault:
        return NoReplyError(f"no reply from rig {rig} at {where}: {fault}")
    return NoReplyError(
        f"no reply from rig {rig} at {where}: not running, or not permitted; "
        "start it with `armrig lab` or `armrigd run`, or give its endpoint with --connect"
    )


def service_has_stopped(rig: str, where: str) -> str:
    """Return what is said of a daemon that is gone; "" unless it is a service of this machine."""
    folder = Path(SERVICES) / rig
    if where != _service_endpoint(rig) or (folder.exists() and not os.access(folder, os.X_OK)):
        return ""
    return (
        f"the service of rig {rig} has stopped; `systemctl status armrigd@{rig}`; what was "
        "recorded is in `armrig ls`"
    )


def no_daemon(rig: str, where: str, what: str) -> RigError:
    """Return the error where the replies are not those of a daemon of this version."""
    return RigError(
        f"rig {rig} at {where}: {what}; what listens there is no armrigd, or one of another version"
    )


def why_not_connected(host: str, port: int, credential: Credential, path: Path) -> str:
    """Return what is wrong and what to do, found by a handshake of our own; "" where it goes well.

    Parameters
    ----------
    host, port
        Of the rig's daemon.
    credential : Credential
        What is shown to it.
    path : Path
        Its file.
    """
    try:
        line = socket.create_connection((host, port), timeout=LONGEST_S)
    except socket.gaierror:
        return f"there is no host {host}: see how it is spelt"
    except ConnectionRefusedError:
        listener = "armrigd runs, with [access], or `armrig router`"
        return f"nobody listens at port {port} of {host}: see that {listener}"
    except TimeoutError:
        return _SILENT
    except OSError as err:
        return f"{err.strerror or err}: see that {host} can be reached from here"
    with line:
        try:
            connected = _context(credential, path).wrap_socket(line, server_hostname=host)
        except ssl.SSLCertVerificationError as err:
            return _of_its_certificate(err, host)
        except OSError:  # ssl.SSLError and TimeoutError are of them
            return "what listens there does not speak TLS 1.3: see that its [access] listen is tls/"
        with connected:
            return _answer_to_ours(connected, credential)


def _context(credential: Credential, path: Path) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.load_verify_locations(cadata=credential.authority.decode("ascii"))
    context.load_cert_chain(path)
    return context


def _answer_to_ours(connected: ssl.SSLSocket, credential: Credential) -> str:
    """Return why it refuses our certificate; "" where it waits for what we have to say."""
    connected.settimeout(_LISTENS_S)
    try:
        connected.recv(1)
    except TimeoutError:
        return ""
    except ssl.SSLError as err:
        alert = (err.reason or "").rpartition("ALERT_")[2].replace("_", " ").lower()
        return (
            f"it refuses the certificate of {credential.name} ({alert}): see whether both are of "
            "the same authority, and whether its clock is set"
        )
    except OSError:
        return ""
    return ""


def _of_its_certificate(err: ssl.SSLCertVerificationError, host: str) -> str:
    if err.verify_code in _OTHER_HOST:
        return (
            f"its certificate is not for {host}: take a name that is in it, or have another made "
            f"by `armrig pki rig ID --host {host}`"
        )
    if err.verify_code == _EXPIRED:
        return "its certificate has expired: `armrig pki renew` makes a new one"
    return (
        f"its certificate is not of the authority that signed yours ({err.verify_message}): it is "
        "another laboratory's, or a stranger's"
    )
