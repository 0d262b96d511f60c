"""Codes for the sentences in files and replies of version 1, which contain no codes.

Files and replies of the current version contain codes and do not need this module.
"""

from __future__ import annotations

import re

from armrig_core.codes import TRY_AGAIN, GapCode, OutcomeCode

_OUTCOMES = {
    "complete": OutcomeCode.COMPLETE,
    "continued": OutcomeCode.CONTINUED,
    "stopped": OutcomeCode.STOPPED,
    "disarmed": OutcomeCode.DISARMED,
    "the daemon was ended": OutcomeCode.DAEMON_ENDED,
    "the loop ended": OutcomeCode.DAEMON_ENDED,
    "the device does not take the setpoints": OutcomeCode.DEVICE,
    "its recording was moved while it was written": OutcomeCode.MOVED,
    "cut off: its daemon died": OutcomeCode.CUT_OFF,
}
_BEGINNINGS = {
    "stopped by ": OutcomeCode.STOPPED,
    "its client went away: ": OutcomeCode.CLIENT_GONE,
    "its recording ended: ": OutcomeCode.RECORDING,
    "the recorder ended: ": OutcomeCode.RECORDER,
}

_EMULATOR_STALL = re.compile(r"emulator held up (\d+) ms")
_GAPS = {
    "the host was late": GapCode.HOST_LATE,
    "the device was late": GapCode.DEVICE_LATE,
    "a frame was lost": GapCode.FRAME_LOST,
    "no answer came": GapCode.NO_ANSWER,
    "the service did not keep up": GapCode.SERVICE_LATE,
    "the recorder was cut off for longer than the daemon keeps what it published": (
        GapCode.RECORDER_CUT_OFF
    ),
}


def passes(error: str) -> bool:
    """Return whether a refusal without a code is temporary, judged by its text."""
    return error.endswith(TRY_AGAIN)


def outcome_code(text: str) -> OutcomeCode:
    """Return the outcome code for the sentence `text` of a file or a status without codes."""
    return next(
        (code for begin, code in _BEGINNINGS.items() if text.startswith(begin)),
        _OUTCOMES.get(text, OutcomeCode.UNKNOWN),
    )


def gap_code(reason: str) -> GapCode:
    """Return the gap code for the sentence `reason` in a message of version 1."""
    return _GAPS.get(reason, GapCode.UNKNOWN)


def emulator_stall_ns(message: str) -> int:
    """Return the length of the stall that an event's sentence reports, in ns; 0 for no stall."""
    found = _EMULATOR_STALL.match(message)
    return int(found[1]) * 1_000_000 if found else 0
