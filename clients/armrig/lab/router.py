"""Router of a lab: a zenoh router that controls access with an access list.

Rigs and people connect to the router with their own certificates. The router forwards the messages
that its access list permits, and stores nothing.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import zenoh
from armrig_core.access import access_control
from armrig_core.access.access_list import AccessList, read_access_list
from armrig_core.access.credential import Credential, read_credential
from armrig_core.access.endpoint import check_listen
from armrig_core.access.owned_session import (
    LANES,
    NOT_FOUND,
    lane,
    listening,
    os_error_number,
    strangers,
    transport,
)
from armrig_core.commands.commands import CalibrateRequest, RunRequest
from armrig_core.errors import OperationError
from armrig_core.process import open_files
from armrig_core.telemetry.topics import EVERY_RIG, command_key

MOST_LINKS = 500
"""Largest number of connected rigs and people."""
_UPLOADS = lane(
    "uploads",
    [command_key(EVERY_RIG, command.name, "*") for command in (RunRequest, CalibrateRequest)],
    "data_low",
    "block",  # a part of a long command must not be dropped
)
_HELD_US = 100_000  # a link to a rig then carries long commands at 0.7 MB/s or more


def router_config(endpoint: str, credential: Credential, people: AccessList) -> dict[str, Any]:
    """Return zenoh's configuration of a router that listens on `endpoint`.

    The router identifies itself to rigs and people by its credential. The access list contains the
    rigs, and the rights of people. The router does not answer discovery messages.
    """
    way = transport(access_control.MOST_MESSAGE_BYTES, held_us=_HELD_US)
    way["link"]["tls"] = credential.tls("listen")
    way["unicast"] = strangers(MOST_LINKS)
    return {
        "mode": "router",
        **listening(endpoint),
        **NOT_FOUND,
        "access_control": access_control.of_router(people),
        "low_pass_filter": access_control.size_limits(EVERY_RIG),
        "qos": {"network": [*LANES["network"], _UPLOADS]},
        "transport": way,
    }


def open_router(endpoint: str, certificate: Path, names: Path) -> tuple[zenoh.Session, AccessList]:
    """Open a router, and return its session and access list; the caller must close the session.

    The endpoint is an address such as tls/0.0.0.0:7447. `armrig pki router` writes the file
    `certificate`. `names` is the file of the access list.

    Raises ValueError if the endpoint is not tls/HOST:PORT, or a file cannot be used. Raises
    OperationError if the router cannot listen on the endpoint.
    """
    check_listen(endpoint)
    people = read_access_list(names)
    config = router_config(endpoint, read_credential(certificate, "router"), people)
    open_files.raise_limit()
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(config))), people
    except zenoh.ZError as err:
        number = os_error_number(err)
        why = os.strerror(number) if number else str(err).splitlines()[0][:200]
        raise OperationError(
            f"{endpoint}: {why}; check that the host is this machine and the port is free"
        ) from err
