"""Network endpoints of the daemon, from `[access]`; checked before the loop is started."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from armrig_core.access import access_control
from armrig_core.access.access_list import AccessList, read_access_list
from armrig_core.access.credential import read_credential, read_passwords, rig_name
from armrig_core.access.endpoint import check_listen
from armrig_core.errors import FileError, InputError

from armrig_daemon.config import Access, Config


@dataclass(frozen=True, slots=True, kw_only=True)
class Network:
    """Network endpoint in addition to the Unix socket, with the permissions of its clients."""

    endpoint: str
    """Endpoint at which the daemon listens, or endpoint of the router to which it connects."""
    known_by: str
    """Proof of a client's name: `certificate`, or `user` for a user name with password."""
    access_control: dict[str, Any]
    low_pass_filter: list[dict[str, Any]]
    transport: dict[str, Any]
    """Part of zenoh's `transport` that identifies clients."""
    operators: int
    observers: int
    expires: datetime | None
    """Time at which the rig's certificate expires; None without a certificate."""
    is_router: bool = False
    """True for a router: the daemon connects to the router, and the router identifies clients."""


class Networks(NamedTuple):
    """Network endpoints that a configuration opens; an endpoint that is not configured is None."""

    own: Network | None
    """Endpoint at which the daemon itself listens."""
    router: Network | None


def networks_of(config: Config) -> Networks:
    """Return the network endpoints that a configuration opens.

    Raises InputError if a key of `[access]` is missing or contradicts another key, or a file cannot
    be used.
    """
    return Networks(network_of(config), router_of(config))


def router_of(config: Config) -> Network | None:
    """Return the router to connect to, or None if the configuration names no router.

    Raises InputError if the rig's certificate is missing or cannot be used.
    """
    access, rig = config.access, config.rig.id
    if not access.router:
        return None
    if not access.certificate:
        msg = f"[access] router = {access.router!r}: needs certificate, too; "
        raise InputError(msg + "`armrig pki rig` makes one")
    try:
        credential = read_credential(Path(access.certificate), "rig at a router")
    except FileError as err:
        raise InputError(f"[access] {err}") from err
    if credential.name != rig_name(rig):
        msg = f"[access] {access.certificate}: certificate of {credential.name}; the router admits "
        raise InputError(f"{msg}this rig only with a certificate of {rig_name(rig)}")
    return Network(
        endpoint=access.router,
        known_by="certificate",
        access_control=access_control.at_router(rig),
        low_pass_filter=access_control.size_limits(rig),
        transport={"link": {"tls": credential.tls("connect")}},
        operators=0,
        observers=0,
        expires=credential.expires,
        is_router=True,
    )


def network_of(config: Config) -> Network | None:
    """Return the network endpoint at which the daemon itself listens, or None.

    Raises InputError if a key of `[access]` is missing or contradicts another key, or a file cannot
    be used.
    """
    access = config.access
    _check_keys(access)
    if not access.listen:
        return None
    expires: datetime | None = None
    transport: dict[str, Any]
    subject: access_control.Subject
    try:
        people = read_access_list(Path(access.names))
        if access.certificate:
            rig = read_credential(Path(access.certificate), "rig")
            known_by, subject, expires = "certificate", "cert_common_names", rig.expires
            transport = {"link": {"tls": rig.tls("listen")}}
        else:
            users = read_passwords(Path(access.passwords))
            people = AccessList(
                operators=tuple(name for name in people.operators if name in users),
                observers=tuple(name for name in people.observers if name in users),
            )
            known_by, subject = "user", "usernames"
            transport = {"auth": {"usrpwd": {"dictionary_file": access.passwords}}}
    except FileError as err:
        raise InputError(f"[access] {err}") from err
    return Network(
        endpoint=access.listen,
        known_by=known_by,
        access_control=access_control.remote(config.rig.id, people, subject),
        low_pass_filter=access_control.size_limits(config.rig.id),
        transport=transport,
        operators=len(people.operators),
        observers=len(people.observers),
        expires=expires,
    )


def _check_keys(access: Access) -> None:
    given = [key for key in ("certificate", "names", "passwords") if getattr(access, key)]
    if not access.listen:
        if access.router:
            given = [key for key in given if key != "certificate"]
        if given:
            raise InputError(
                f"[access] {given[0]} is given, but listen is not, so that nobody could connect; "
                "give listen, such as tls/0.0.0.0:7447"
            )
        return
    protocol = check_listen(access.listen)
    needed = ["certificate", "names"] if protocol == "tls" else ["names", "passwords"]
    makes = {"certificate": "armrig pki rig", "names": "armrig pki ca"}
    for key in needed:
        if key not in given:
            made = f"; `{makes[key]}` makes one" if key in makes else ": lines user:password"
            raise InputError(f"[access] listen = {access.listen!r}: needs {key}, too{made}")
    for key in given:
        if key not in needed:
            raise InputError(
                f"[access] {key} is not allowed with listen = {access.listen!r}: remove {key}"
            )
