"""The faults that the daemon latches: what a program tells them by, and what a person is to do."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from armrig_protocol.messages import Cause


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
    Id.SERVICE: "start armrigd anew; what it printed before may say why",
    Id.LEASE: "have the client send a command more often: in 0.1 s or 5 Ts, the longer of the two",
    Id.LIMITS: "keep the input within [limits] of the configuration",
    Id.RESET: "see to the supply and the cable of the rig",
    Id.DEVICE: "keep to the limit that it names; if this host was late, close other programs "
    "(`armrig doctor`)",
    Id.STATE: "see that nobody else talks to the device",
    Id.APPLIED: "do not drive this rig: its firmware or its converter is broken",
    Id.REQUEST: "see to the cable, then unplug the device and plug it in again",
    Id.FIRMWARE: "flash firmware of this version of the wire (firmware_protocol/PROTOCOL.md)",
    Id.INTERNAL: "report it with the recording: this is a bug in armrig",
}
"""What to do about each, before `armrig reset`."""


OF_DEVICE: dict[int, str] = {
    Cause.WATCHDOG: "it heard nothing from this host in time",
    Cause.RANGE: "a voltage was outside its limits",
    Cause.SLEW: "the voltage changed by more than limits.slew_v in a sample",
    Cause.ADC_RAIL: "a potentiometer was at a rail for device.rail_ticks samples",
    Cause.REV_LIMIT: "the chassis reached limits.revolutions",
    Cause.UNDERRUN: "its queue of setpoints ran dry",
    Cause.VCC_LOW: "its supply is too low",
    Cause.INTERNAL: "a check of its firmware on itself failed",
}
"""What each cause is for which a device stops by itself."""


def of_device(cause: int) -> str:
    """Return the cause in a frame of the device: its name where it has one, and what it is."""
    name = Cause(cause).name if cause in set(Cause) else str(cause)
    return f"{name}, {OF_DEVICE[cause]}" if cause in OF_DEVICE else name


def sentence(fault: Fault) -> str:
    """Return cause and remedy as one sentence."""
    return f"{fault.cause}; {REMEDIES[fault.id]}"
