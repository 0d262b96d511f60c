"""Faults that the daemon latches: a code for programs, a cause and a remedy for people."""

from __future__ import annotations

from enum import IntEnum, StrEnum
from typing import NamedTuple

from armrig_protocol.messages import Cause


class Id(StrEnum):
    """Code of a fault, for programs; it does not change from release to release."""

    LINK = "link"
    """The port is gone."""
    STALE = "stale"
    """The device answered no frame for longer than allowed."""
    PAUSE = "pause"
    """The host did not run the loop for longer than allowed."""
    MISSED = "missed"
    """The number of consecutive missed ticks has reached the configured limit."""
    SERVICE = "service"
    """The service is frozen."""
    LEASE = "lease"
    """No command of the lease's holder arrived in time."""
    LIMITS = "limits"
    """The input of an experiment left the limits."""
    CONTROL = "control"
    """A control law computed no finite number."""
    INNOVATION = "innovation"
    """A measured output differs from the one-step prediction of the law's monitor."""
    SIMULATION = "simulation"
    """A measured output differs from the simulation of the law's monitor."""
    OUTPUT = "output"
    """A measured output left its limits."""
    BLIND = "blind"
    """No valid sample of a limited output arrived in time."""
    RESET = "reset"
    """The device restarted."""
    DEVICE = "device"
    """The device stopped by itself."""
    STATE = "state"
    """The device is in a state that the daemon did not request."""
    APPLIED = "applied"
    """The device latched a code other than the commanded code."""
    REQUEST = "request"
    """The device refuses or does not answer a request."""
    FIRMWARE = "firmware"
    """The firmware is unknown, or must not drive a motor."""
    INTERNAL = "internal"
    """The state of the daemon is inconsistent."""


class Fault(NamedTuple):
    """A fault, with the values that were observed."""

    id: Id
    cause: str
    """Observed and allowed values, as text for a person."""
    device_cause: int = Cause.NONE
    """Number of the cause that the device reported, see `Cause`; NONE if it reported no cause."""
    output: str = ""
    """Name of the measured output that caused the fault; empty for another cause."""
    value: float | None = None
    """Newest valid value of this output, in its unit."""


REMEDIES: dict[Id, str] = {
    Id.LINK: "plug the rig in, and check that its supply is on",
    Id.STALE: "check the cable, the baud rate and the load of this host (`armrig doctor`)",
    Id.PAUSE: "keep this host from sleeping, and lower its load (`armrig doctor`)",
    Id.MISSED: "lower the load of this host, or sample more slowly (`armrig doctor`)",
    Id.SERVICE: "start armrigd again; its earlier output may say why it froze",
    Id.LEASE: "let the client send a command at least every 0.1 s or 5 Ts, whichever is longer",
    Id.LIMITS: "keep the input within [limits] of the configuration",
    Id.CONTROL: "rehearse the control law on a model of the rig, and design the law again",
    Id.INNOVATION: "check this sensor, its wires and the sign of the input; begin at rest; if the "
    "rig is as it was, design the law on a new model",
    Id.SIMULATION: "check this sensor and the actuator; begin at rest; if the rig is as it was, "
    "design the law on a new model",
    Id.OUTPUT: "bring the output back into its limits ([limits], or the rig's description); a "
    "smaller or shorter input may keep it there",
    Id.BLIND: "check the wires of this sensor, and that its reading is not at an end of its range",
    Id.RESET: "check the supply and the cable of the rig",
    Id.DEVICE: "stay within the limit in this message; if this host was late, close other programs "
    "(`armrig doctor`)",
    Id.STATE: "check that no other program uses the device",
    Id.APPLIED: "do not drive this rig: its firmware or its converter is broken",
    Id.REQUEST: "check the cable, then unplug the device and plug it in again",
    Id.FIRMWARE: "unplug the actuator, and flash the firmware of this version of armrig",
    Id.INTERNAL: "report this bug of armrig, with the recording",
}
"""Remedy of each fault; after the remedy, `armrig reset` clears the fault."""

_EMULATOR_MODEL = (
    "check [emulator] and the description of the rig; begin at rest; if the rig is as it was, "
    "design the law on a new model"
)
EMULATOR_REMEDY = "continue the emulator if its process is stopped, or start `armrig lab` again"
REMEDIES_OF_EMULATED: dict[Id, str] = {
    Id.LINK: EMULATOR_REMEDY,
    Id.STALE: f"{EMULATOR_REMEDY}; if this host was late, close other programs (`armrig doctor`)",
    Id.RESET: "wait until the emulator, which was started again, answers",
    Id.INNOVATION: _EMULATOR_MODEL,
    Id.SIMULATION: _EMULATOR_MODEL,
    Id.BLIND: "check the description of the rig and [emulator]: this reading is at an end of its "
    "range",
    Id.APPLIED: "start `armrig lab` again, and report this bug of the emulator",
    Id.REQUEST: EMULATOR_REMEDY,
    Id.FIRMWARE: "start the emulator of this version of armrig, with the image that the rig needs",
}
"""Remedy of an emulated rig, for each fault whose usual remedy names a cable, supply or board."""


OF_DEVICE: dict[int, str] = {
    Cause.WATCHDOG: "it received nothing from this host in time",
    Cause.RANGE: "a voltage was outside its limits",
    Cause.SLEW: "the voltage changed by more than limits.slew_v in a sample",
    Cause.ADC_RAIL: "a potentiometer was at a rail for device.rail_ticks samples",
    Cause.REV_LIMIT: "the shaft reached limits.revolutions, or turns of its description",
    Cause.UNDERRUN: "its queue of setpoints ran dry",
    Cause.VCC_LOW: "its supply is too low",
    Cause.INTERNAL: "an internal check of its firmware failed",
}
"""Meaning of each cause for which a device stops by itself."""


def name_of(kind: type[IntEnum], number: int) -> str:
    """Return the name of a number that the device reported, or the number if it has no name."""
    return kind(number).name if number in set(kind) else str(number)


def of_device(cause: int) -> str:
    """Return the name (or number) and the meaning of a cause that the device reported."""
    name = name_of(Cause, cause)
    return f"{name}, {OF_DEVICE[cause]}" if cause in OF_DEVICE else name


def remedy(fault: Id, *, is_emulated: bool) -> str:
    """Return the remedy of a fault; an emulated rig has no cable and no supply."""
    usual = REMEDIES[fault]
    return REMEDIES_OF_EMULATED.get(fault, usual) if is_emulated else usual


def sentence(fault: Fault, *, is_emulated: bool) -> str:
    """Return cause and remedy as one sentence."""
    return f"{fault.cause}; {remedy(fault.id, is_emulated=is_emulated)}"
