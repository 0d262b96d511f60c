"""Message about a stall of the computer, during which an emulated device's clock stood still."""

from __future__ import annotations


def held_up(ns: int) -> str:
    """Return the sentence that reports that the emulator was stalled for `ns` ns."""
    return f"emulator held up {round(ns / 1e6)} ms by this machine; its device's clock stood still"
