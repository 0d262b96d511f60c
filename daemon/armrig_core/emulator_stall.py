"""What is said of an emulated rig that its machine held up: by the daemon, and read again."""

from __future__ import annotations

import re

_SENTENCE = re.compile(r"emulator held up (\d+) ms")


def held_up(ns: int) -> str:
    """Return what is told of an emulator that was held up for so long, in ns."""
    return f"emulator held up {round(ns / 1e6)} ms by this machine; its device's clock stood still"


def held_up_ms(message: str) -> int:
    """Return how long an emulator was held up, as an event tells it, in ms; 0 for other events."""
    found = _SENTENCE.match(message)
    return int(found[1]) if found else 0
