"""What a daemon says of the real-time scheduling that it got."""

from __future__ import annotations

from typing import Any


def scheduling(host: dict[str, Any]) -> list[str]:
    """Return what the daemon says of real-time scheduling, in words."""
    if not host:
        return ["nothing known yet"]
    fifo = host.get("fifo")
    said = [f"real-time scheduling at priority {fifo}" if fifo else "no real-time scheduling"]
    refused = host.get("refused", [])
    said += [
        f"not allowed: {what}" for what in (refused if isinstance(refused, list) else [refused])
    ]
    return said
