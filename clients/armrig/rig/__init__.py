"""What opens a session to a daemon."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from armrig.rig.client import BusyError, RefusedError, Rig, RunEndedError
    from armrig.rig.session import NoReplyError, RigError

__all__ = ["BusyError", "NoReplyError", "RefusedError", "Rig", "RigError", "RunEndedError"]


def __getattr__(name: str) -> Any:
    """Return a public name; zenoh is loaded only now."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from armrig.rig import client, session

    return getattr(session if name in ("NoReplyError", "RigError") else client, name)
