"""What files and daemons of version 1 told by sentences alone, as today's codes.

A file or a reply of today carries a code, and no sentence of it comes here.
"""

from __future__ import annotations

from armrig_core.codes import TRY_AGAIN, OutcomeCode

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


def passes(error: str) -> bool:
    """Return whether a refusal of a daemon without codes passes by itself."""
    return error.endswith(TRY_AGAIN)


def outcome_code(text: str) -> OutcomeCode:
    """Return the code of a sentence by which a file or a status without codes tells an outcome."""
    return next(
        (code for begin, code in _BEGINNINGS.items() if text.startswith(begin)),
        _OUTCOMES.get(text, OutcomeCode.UNKNOWN),
    )
