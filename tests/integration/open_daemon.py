"""The daemon without its guard, as the control for the tests of the guard.

`python open_daemon.py run …`: any TLS client may connect and do everything.
"""

from __future__ import annotations

from typing import Any

from armrig_core import access_control
from armrig_core.credential import Credential
from armrig_daemon.__main__ import main

_tls = Credential.tls


def _without_mutual_tls(self: Credential, side: Any) -> dict[str, Any]:
    return {**_tls(self, side), "enable_mtls": False}


def _nothing_denied(*_: Any) -> dict[str, Any]:
    return {"enabled": False, "default_permission": "allow"}


Credential.tls = _without_mutual_tls  # type: ignore[method-assign]
access_control.remote = _nothing_denied  # type: ignore[assignment]

if __name__ == "__main__":
    main()
