"""The way in over a network, from `[access]`: judged before the motor's loop is started."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from armrig_core.access_list import AccessList, AccessListError, read_access_list
from armrig_core.bounded import TextError
from armrig_core.credential import Credential, CredentialError, read_credential
from armrig_core.endpoint import check_listen
from armrig_core.passwords import PasswordError, read_passwords

from armrig_daemon.config import Access, Config
from armrig_daemon.service import access_control


class AccessError(ValueError):
    """An `[access]` that is refused; says what is wrong and what to do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Network:
    """Where to listen beside the Unix socket, and who may do what there."""

    endpoint: str
    known_by: str
    """What a name that has asked is that of: `certificate` or `user`."""
    access_control: dict[str, Any]
    low_pass_filter: list[dict[str, Any]]
    transport: dict[str, Any]
    """zenoh's `transport`, as far as it proves who somebody is."""
    operators: int
    observers: int
    expires: datetime | None
    """When the rig's certificate ends; None without one."""


def network_of(config: Config) -> Network | None:
    """Return the way in over a network that a configuration opens, None where it opens none.

    Raises
    ------
    AccessError
        A key is missing or does not fit the others, or a file cannot be used.
    """
    access = config.access
    _check_keys(access)
    if not access.listen:
        return None
    try:
        people = read_access_list(Path(access.names))
        if access.certificate:
            return _by_certificate(config, people, read_credential(Path(access.certificate), "rig"))
        users = read_passwords(Path(access.passwords))
    except (AccessListError, CredentialError, PasswordError, TextError) as err:
        msg = f"[access] {err}"
        raise AccessError(msg) from err
    return _by_password(config, people, users)


def _check_keys(access: Access) -> None:
    given = [key for key in ("certificate", "names", "passwords") if getattr(access, key)]
    if not access.listen:
        if given:
            msg = f"[access] {given[0]} is given and listen is not: nobody could connect; give "
            msg += "listen, such as tls/0.0.0.0:7447"
            raise AccessError(msg)
        return
    protocol = check_listen(access.listen)
    needed = ["certificate", "names"] if protocol == "tls" else ["names", "passwords"]
    makes = {"certificate": "armrig pki rig", "names": "armrig pki ca"}
    for key in needed:
        if key not in given:
            made = f"; `{makes[key]}` makes one" if key in makes else ": a line user:password each"
            msg = f"[access] listen = {access.listen!r}: needs {key}, too{made}"
            raise AccessError(msg)
    for key in given:
        if key not in needed:
            msg = f"[access] {key} does not go with listen = {access.listen!r}: take it away"
            raise AccessError(msg)


def _by_certificate(config: Config, people: AccessList, rig: Credential) -> Network:
    return Network(
        endpoint=config.access.listen,
        known_by="certificate",
        access_control=access_control.remote(config.rig.id, people, "cert_common_names"),
        low_pass_filter=access_control.size_limits(config.rig.id),
        transport={"link": {"tls": rig.tls("listen")}},
        operators=len(people.operators),
        observers=len(people.observers),
        expires=rig.expires,
    )


def _by_password(config: Config, people: AccessList, users: frozenset[str]) -> Network:
    known = AccessList(
        operators=tuple(name for name in people.operators if name in users),
        observers=tuple(name for name in people.observers if name in users),
    )
    return Network(
        endpoint=config.access.listen,
        known_by="user",
        access_control=access_control.remote(config.rig.id, known, "usernames"),
        low_pass_filter=access_control.size_limits(config.rig.id),
        transport={"auth": {"usrpwd": {"dictionary_file": config.access.passwords}}},
        operators=len(known.operators),
        observers=len(known.observers),
        expires=None,
    )
