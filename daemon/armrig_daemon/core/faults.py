"""The faults that the daemon latches: what a program tells them by, and what a person is to do."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class Id(StrEnum):
    """What a program tells a fault by; it does not change from release to release."""

    LINK = "link"
    """The port is gone."""
    STALE = "stale"
    """No round trip for too long."""
    PAUSE = "pause"
    """The host was away for too long."""
    MISSED = "missed"
    """More ticks in a row were missed than the config allows."""
    SERVICE = "service"
    """The service is frozen."""
    LEASE = "lease"
    """The holder's commands stayed away."""
    LIMITS = "limits"
    """An experiment left the limits."""
    RESET = "reset"
    """The device started anew."""
    DEVICE = "device"
    """The device stopped by itself."""
    STATE = "state"
    """The device is in a state that nobody asked for."""
    APPLIED = "applied"
    """The device latched another code than was commanded."""
    REQUEST = "request"
    """The device does not do what it is asked."""
    FIRMWARE = "firmware"
    """Another firmware, or one that must not be driven."""
    INTERNAL = "internal"
    """The daemon contradicts itself."""


class Fault(NamedTuple):
    """A fault as it happened."""

    id: Id
    cause: str
    """What came and what is allowed, for a person."""


REMEDIES: dict[Id, str] = {
    Id.LINK: "plug the rig in, and see that its supply is on",
    Id.STALE: "see to the cable, the baud rate and the load of this host (`armrig doctor`)",
    Id.PAUSE: "let this host neither sleep nor starve the daemon (`armrig doctor`)",
    Id.MISSED: "lower the load of this host, or sample slower (`armrig doctor`)",
    Id.SERVICE: "restart the daemon, and see what its log says",
    Id.LEASE: "have the client command at least once in each lease",
    Id.LIMITS: "keep the input within the limits of the config",
    Id.RESET: "see to the supply and the cable of the rig",
    Id.DEVICE: "see what the cause names: range, turns, potentiometer, watchdog or supply",
    Id.STATE: "see that nobody else talks to the device",
    Id.APPLIED: "do not drive this rig: its firmware or its converter is broken",
    Id.REQUEST: "see to the cable, then reset the device",
    Id.FIRMWARE: "flash firmware of this version of the wire (firmware_protocol/PROTOCOL.md)",
    Id.INTERNAL: "report it with the recording: this is a bug in armrig",
}
"""What to do about each, before `armrig reset`."""


def sentence(fault: Fault) -> str:
    """Return cause and remedy as one sentence."""
    return f"{fault.cause}; {REMEDIES[fault.id]}"
