"""Codes that programs decide by; each is sent and recorded beside a sentence for a person.

A code keeps its meaning from release to release. A reader treats one that it does not know as it
treats an absent one.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

TRY_AGAIN = ": try again"
"""How the sentence of a refusal ends that passes by itself."""


class RefusalCode(StrEnum):
    """Why a command was refused."""

    NOT_ALLOWED = "not_allowed"
    """The command, or a field of it, is not allowed as it is."""
    TOO_LONG = "too_long"
    """The command has too many bytes: bytes, most_bytes."""
    NOT_HELD = "not_held"
    """The lease is not the one in force."""
    NOT_NEWER = "not_newer"
    """The number does not exceed the last one of the lease: n, last."""
    HELD = "held"
    """Somebody holds the rig: owner."""
    IN_FAULT = "in_fault"
    """A fault is latched: fault, its id; reason."""
    RUNNING = "running"
    """An experiment is running, or about to start."""
    BY_HAND = "by_hand"
    """The motor is driven by hand."""
    CANNOT_PACE = "cannot_pace"
    """The device cannot pace the run as it was asked for."""
    NO_ROOM = "no_room"
    """Nothing can be recorded."""
    NO_RIG = "no_rig"
    """No device answers at the daemon's port."""
    NO_LINK = "no_link"
    """The line to the device is down, or went down meanwhile."""
    NO_EFFECT = "no_effect"
    """The device did not do what it was asked for."""
    READINGS = "readings"
    """A potentiometer does not read what a rig in order would."""
    OVERTAKEN = "overtaken"
    """Another command, or a stop, came before this one had its effect."""
    ENDING = "ending"
    """The daemon is ending."""
    NO_ANSWER = "no_answer"
    """The loop did not answer in time; whether the command had an effect is not known."""
    INTERNAL = "internal"
    """The daemon failed."""
    NO_DEVICE = "no_device"
    """The device does not answer at the moment."""
    BUSY = "busy"
    """The device is being asked for something else: want."""
    STALE = "stale"
    """The device did not answer, or send a sample, of late: age_ms or limit_ms."""
    NOT_AT_REST = "not_at_rest"
    """The device is not at rest yet."""
    LATE = "late"
    """The host woke up too late in the last second: late_ms, most_ms."""
    TOO_MANY = "too_many"
    """Too many commands came at once, from all clients together."""

    @property
    def passes(self) -> bool:
        """Whether the refusal passes by itself: the same command may be taken a little later."""
        return self in _PASSING


_PASSING = frozenset(
    {
        RefusalCode.NO_DEVICE,
        RefusalCode.BUSY,
        RefusalCode.STALE,
        RefusalCode.NOT_AT_REST,
        RefusalCode.LATE,
        RefusalCode.TOO_MANY,
    }
)


class OutcomeCode(StrEnum):
    """How a run, or its recording, ended."""

    COMPLETE = "complete"
    """With the last sample of its input, or of what was to be recorded."""
    CONTINUED = "continued"
    """Of a part: another part follows."""
    STOPPED = "stopped"
    """Somebody stopped it."""
    DISARMED = "disarmed"
    """Its owner gave the rig back."""
    CLIENT_GONE = "client_gone"
    """Its client gave no sign for longer than its dead-man."""
    FAULT = "fault"
    """The rig went into a fault."""
    DEVICE = "device"
    """The device did not take the setpoints."""
    DAEMON_ENDED = "daemon_ended"
    """The daemon, or its loop, ended."""
    RECORDING = "recording"
    """The recording could not begin, or go on; the sentence names the file."""
    MOVED = "moved"
    """Somebody moved the file while it was written."""
    CUT_OFF = "cut_off"
    """The file was cut off, and completed later."""
    RECORDER = "recorder"
    """The recorder from afar ended early, or its rig began to count or to sample otherwise."""
    UNKNOWN = "unknown"
    """It ended early; nothing more is known."""


class Ending(NamedTuple):
    """How a run ended: a code for programs, and a sentence for a person."""

    code: OutcomeCode
    text: str


COMPLETE = Ending(OutcomeCode.COMPLETE, "complete")
CONTINUED = Ending(OutcomeCode.CONTINUED, "continued")
