"""Network endpoints of the daemon, from `[access]`; checked before the loop is started."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from armrig_core.access import access_control
from armrig_core.access.access_list import read_access_list
from armrig_core.access.credential import read_credential, rig_name
from armrig_core.errors import FileError, InputError

from armrig_daemon.config import Config


@dataclass(frozen=True, slots=True, kw_only=True)
class Network:
    """Network endpoint in addition to the Unix socket, with the permissions of its clients."""

    endpoint: str
    """Endpoint at which the daemon listens, or endpoint of the router to which it connects."""
    access_control: dict[str, Any]
    low_pass_filter: list[dict[str, Any]]
    tls: dict[str, Any]
    """Part of zenoh's `transport/link` that identifies both ends."""
    operators: int
    observers: int
    expires: datetime
    """Time at which the rig's certificate expires."""
    is_router: bool = False
    """True for a router: the daemon connects to the router, and the router identifies clients."""


def networks_of(config: Config) -> tuple[Network | None, Network | None]:
    """Return the endpoint at which the daemon listens on a network, and its router.

    Raises InputError if a key of `[access]` is missing or contradicts another key, or a file cannot
    be used.
    """
    return network_of(config), router_of(config)


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
        access_control=access_control.at_router(rig),
        low_pass_filter=access_control.size_limits(rig),
        tls=credential.tls("connect"),
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
    if not access.listen:
        needless = "certificate" if access.certificate and not access.router else "names"
        if getattr(access, needless):
            raise InputError(
                f"[access] {needless} is given, but listen is not, so that nobody could connect; "
                "give listen, such as tls/0.0.0.0:7447"
            )
        return None
    for key, made_by in (("certificate", "armrig pki rig"), ("names", "armrig pki ca")):
        if not getattr(access, key):
            raise InputError(
                f"[access] listen = {access.listen!r}: needs {key}, too; `{made_by}` makes one"
            )
    try:
        people = read_access_list(Path(access.names))
        rig = read_credential(Path(access.certificate), "rig")
    except FileError as err:
        raise InputError(f"[access] {err}") from err
    return Network(
        endpoint=access.listen,
        access_control=access_control.remote(config.rig.id, people),
        low_pass_filter=access_control.size_limits(config.rig.id),
        tls=rig.tls("listen"),
        operators=len(people.operators),
        observers=len(people.observers),
        expires=rig.expires,
    )
