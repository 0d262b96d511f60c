"""Identity and ports of emulated rigs."""

from __future__ import annotations

from typing import Final

EMULATOR_UID: Final = int.from_bytes(b"emulator", "little")
"""Identity that the emulated device reports."""
VIRTUAL_PORT: Final = "emulated"
"""Port of a rig that is emulated in virtual time."""
SOCKET_PREFIX: Final = "unix:"
"""First characters of a port that names the socket of an emulated rig."""


def is_emulated(*, uid: str, port: str) -> bool:
    """Return whether the identity of the device or the port shows that a rig is emulated.

    `uid` is the identity that the device reported, in hexadecimal. `port` is the port to which the
    daemon was connected.
    """
    return uid == f"{EMULATOR_UID:016x}" or port == VIRTUAL_PORT or port.startswith(SOCKET_PREFIX)


def stall_sentence(ns: int) -> str:
    """Return the sentence that reports that the emulator was stalled for `ns` ns."""
    return f"emulator held up {round(ns / 1e6)} ms by this machine; its device's clock stood still"
