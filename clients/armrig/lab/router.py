"""A lab's router: zenoh's own, with the access control of one access list.

Rigs connect to it as who they are, people as themselves; it passes on what both may say to each
other, and keeps nothing.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import zenoh
from armrig_core import access_control, open_files
from armrig_core.access_list import AccessList, read_access_list
from armrig_core.credential import Credential, read_credential
from armrig_core.endpoint import check_listen
from armrig_core.errors import InputError, OperationError
from armrig_core.owned_session import NOT_FOUND, ROUTED_US, listening, strangers, transport
from armrig_core.topics import EVERY_RIG

MOST_LINKS = 500
"""Rigs and people at a time."""
_OS_ERROR = re.compile(r"os error (\d+)")


def router_config(endpoint: str, credential: Credential, people: AccessList) -> dict[str, Any]:
    """Return the configuration of a router that is found by nobody.

    Parameters
    ----------
    endpoint : str
        Where it listens.
    credential : Credential
        What it shows to rigs and people.
    people : AccessList
        Which rigs there may be, and who may do what with them.
    """
    way = transport(access_control.MOST_IN_A_MESSAGE, answer_us=ROUTED_US)
    way["link"]["tls"] = credential.tls("listen")
    way["unicast"] = strangers(MOST_LINKS)
    return {
        "mode": "router",
        **listening(endpoint),
        **NOT_FOUND,
        "access_control": access_control.of_router(people),
        "low_pass_filter": access_control.size_limits(EVERY_RIG),
        "transport": way,
    }


def open_router(endpoint: str, certificate: Path, names: Path) -> tuple[zenoh.Session, AccessList]:
    """Return a router's session, which must be closed, and who may use it.

    Parameters
    ----------
    endpoint : str
        Where it listens, such as tls/0.0.0.0:7447.
    certificate : Path
        Its credential, which `armrig pki router` writes.
    names : Path
        The access list.

    Raises
    ------
    ValueError
        The endpoint is not tls/HOST:PORT, or one of the files cannot be used.
    OperationError
        It cannot listen there.
    """
    if check_listen(endpoint) != "tls":
        msg = f"{endpoint!r}: a router knows rigs and people by their certificates: take "
        raise InputError(msg + f"tls/{endpoint.partition('/')[2]}")
    people = read_access_list(names)
    config = router_config(endpoint, read_credential(certificate, "router"), people)
    open_files.raise_limit()
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(config))), people
    except zenoh.ZError as err:
        found = _OS_ERROR.search(str(err))
        why = os.strerror(int(found[1])) if found else str(err).splitlines()[0][:200]
        raise OperationError(
            f"{endpoint}: {why}; see that host and port are this machine's, and free"
        ) from err
