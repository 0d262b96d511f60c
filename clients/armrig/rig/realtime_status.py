"""What a daemon reports of the real-time scheduling that it got."""

from __future__ import annotations

from typing import Any


def scheduling_sentences(host: dict[str, Any]) -> list[str]:
    """Return what the daemon reports of real-time scheduling, a sentence each."""
    if not host:
        return ["nothing known yet"]
    fifo = host.get("fifo")
    sentences = [f"real-time scheduling at priority {fifo}" if fifo else "no real-time scheduling"]
    refused = host.get("refused", [])
    sentences += [
        f"not allowed: {what}" for what in (refused if isinstance(refused, list) else [refused])
    ]
    return sentences
