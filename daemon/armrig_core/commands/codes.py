"""Codes by which programs decide; each code is sent and recorded with a sentence for a person.

A code keeps its meaning from release to release. A reader treats an unknown code like an absent
code.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple, Self

TRY_AGAIN = ": try again"
"""Ending of the sentence in a temporary refusal."""


class RefusalCode(StrEnum):
    """Reason of a refusal."""

    NOT_ALLOWED = "not_allowed"
    """The command, or one of its fields, is not allowed."""
    EXPIRED = "expired"
    """The client no longer waits for the reply, or the command names no time of validity."""
    CANCELLED = "cancelled"
    """A stop, a reset or the end of the lease came while the run was prepared."""
    TOO_LONG = "too_long"
    """The command has `bytes` bytes, more than the allowed `most_bytes`."""
    NOT_HELD = "not_held"
    """The lease is not the current lease."""
    NOT_NEWER = "not_newer"
    """The number `n` does not exceed the last number `last` of the lease."""
    HELD = "held"
    """The client `owner` holds the rig."""
    IN_FAULT = "in_fault"
    """A fault is latched: `fault` is its id, `reason` its sentence."""
    RUNNING = "running"
    """An experiment is running, or about to start."""
    BY_HAND = "by_hand"
    """The motor is driven by hand, with `set`."""
    CANNOT_PACE = "cannot_pace"
    """The device cannot pace the run as requested."""
    NO_ROOM = "no_room"
    """Nothing can be recorded: the directory cannot be written, or lacks space."""
    NO_RIG = "no_rig"
    """No device answers at the daemon's port."""
    NO_LINK = "no_link"
    """The line to the device is down, or went down during the command."""
    NO_EFFECT = "no_effect"
    """The device did not execute the request."""
    READINGS = "readings"
    """A potentiometer has a reading that is impossible at an intact rig."""
    OVERTAKEN = "overtaken"
    """Another command, or a stop, arrived before the command took effect."""
    ENDING = "ending"
    """The daemon is ending."""
    NO_ANSWER = "no_answer"
    """The loop did not answer in time; it is unknown if the command took effect."""
    INTERNAL = "internal"
    """The daemon failed."""
    NO_DEVICE = "no_device"
    """The device does not answer at present."""
    BUSY = "busy"
    """Another request to the device, `want`, is in progress."""
    STALE = "stale"
    """The device's last answer (`age_ms` old) or last sample (older than `limit_ms`) is too old."""
    NOT_AT_REST = "not_at_rest"
    """The device is not at rest yet."""
    LATE = "late"
    """In the last second the host woke up `late_ms` late; `most_ms` is allowed."""
    TOO_MANY = "too_many"
    """All clients together sent too many commands at once."""

    @property
    def passes(self) -> bool:
        """True if the refusal is temporary: the same command may be accepted a little later."""
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
    """Outcome of a run or of its recording."""

    COMPLETE = "complete"
    """The run or the recording ended with its last sample."""
    CONTINUED = "continued"
    """The file is one part of a run, and another part follows."""
    STOPPED = "stopped"
    """A client stopped the run."""
    DISARMED = "disarmed"
    """The owner released the rig."""
    CLIENT_GONE = "client_gone"
    """The client was silent for longer than the dead-man time."""
    FAULT = "fault"
    """The run ended at a fault of the rig."""
    DEVICE = "device"
    """The device did not accept the setpoints."""
    TRACKING = "tracking"
    """The control error was beyond the bound of the law for too long."""
    BLIND = "blind"
    """No valid sample of an output reached the control law for too long."""
    AT_LIMIT = "at_limit"
    """The control law was at a limit of the voltage for too long."""
    DAEMON_ENDED = "daemon_ended"
    """The daemon or its loop ended."""
    RECORDING = "recording"
    """The recording could not begin or continue; the sentence of the outcome names the file."""
    MOVED = "moved"
    """The file was moved during the recording."""
    CUT_OFF = "cut_off"
    """The file was cut off, and recovered later."""
    RECORDER = "recorder"
    """The remote recorder ended early, or the rig's sample count or sampling time changed."""
    UNKNOWN = "unknown"
    """The run ended early for an unknown reason."""


class GapCode(StrEnum):
    """Reason of a gap; a member contains the sentence for a person."""

    sentence: str
    """Reason in words, for a log or a page."""

    HOST_LATE = "host_late", "the host was late"
    """The loop did not run at the ticks of the samples."""
    DEVICE_LATE = "device_late", "the device was late"
    """Too many requests were unanswered, so the loop sent no request at the tick."""
    FRAME_LOST = "frame_lost", "a frame was lost"
    """The line lost the request or the sample."""
    NO_ANSWER = "no_answer", "no answer came"
    """No sample arrived, for an unknown reason."""
    FAULT = "fault", "the rig went into a fault"
    """The device stopped before its run ended; the gap's sentence is the cause of the fault."""
    SERVICE_LATE = "service_late", "the service did not keep up"
    """The pipe between loop and service was full."""
    RECORDER_CUT_OFF = (
        "recorder_cut_off",
        "the recorder was cut off for longer than the daemon keeps what it published",
    )
    """The daemon published the samples; the remote recorder missed them."""
    LISTENER_LATE = "listener_late", "the listener, or the way to it, did not keep up"
    """The daemon published the samples; a live listener missed them."""
    UNKNOWN = "unknown", "the reason is not known"
    """The record contains no code."""

    def __new__(cls, code: str, sentence: str) -> Self:
        """Create a member from its code and its sentence."""
        member = str.__new__(cls, code)
        member._value_, member.sentence = code, sentence
        return member


class Ending(NamedTuple):
    """End of a run: a code for programs, and a sentence for a person."""

    code: OutcomeCode
    text: str


COMPLETE = Ending(OutcomeCode.COMPLETE, "complete")
CONTINUED = Ending(OutcomeCode.CONTINUED, "continued")
