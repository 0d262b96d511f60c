"""The daemon, or the router, without its guard, as the control for the tests of the guard.

`python unguarded.py run …`, `python unguarded.py router …`: any TLS client may do everything.
"""

from __future__ import annotations

import sys
from typing import Any

from armrig_core.access import access_control
from armrig_core.access.credential import Credential

_tls = Credential.tls


def _without_mutual_tls(self: Credential, side: Any) -> dict[str, Any]:
    return {**_tls(self, side), "enable_mtls": False}


def _nothing_denied(*_: Any) -> dict[str, Any]:
    return {"enabled": False, "default_permission": "allow"}


Credential.tls = _without_mutual_tls  # type: ignore[method-assign]
access_control.remote = _nothing_denied  # type: ignore[assignment]
access_control.of_router = _nothing_denied  # type: ignore[assignment]

if __name__ == "__main__":
    if sys.argv[1] == "router":
        from armrig.cli import main
    else:
        from armrig_daemon.__main__ import main
    sys.exit(main())
