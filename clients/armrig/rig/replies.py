"""The replies of a daemon: decoded, or refused where no daemon of this version replies so."""

from __future__ import annotations

import getpass
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import msgspec
from armrig_core import commands, version_1
from armrig_core.codes import OutcomeCode
from armrig_core.errors import MalformedReplyError
from msgspec.structs import replace

from armrig.rig.session import RigError

MOST_BYTES = 1 << 20
"""Longest reply that is read, in B; a daemon's longest have a few thousand."""
_LONGEST_ERROR = 1000  # characters that are shown

_R = TypeVar("_R")

Progress = Callable[[int, int], None]
"""Called with the samples taken and the samples asked for."""


def reply_of(name: str, payload: bytes, answer: type[_R]) -> _R:
    """Return the reply to the command `name`.

    Raises
    ------
    MalformedReplyError
        It is too long, is not JSON, or a field is missing or of another type; the message says
        which.
    """
    _check_length(name, payload)
    try:
        return msgspec.json.decode(payload, type=answer)
    except (msgspec.DecodeError, UnicodeDecodeError) as err:  # ValidationError is one of the first
        raise MalformedReplyError(f"the answer to {name!r} cannot be read: {err}") from err
    except RecursionError as err:
        raise MalformedReplyError(
            f"the answer to {name!r} cannot be read: nested too deeply"
        ) from err


def refusal_of(name: str, payload: bytes) -> commands.Refused:
    """Return why the command `name` was refused; raises as `reply_of`, but not for plain text.

    A daemon of an earlier release sends a sentence alone: of that one `version_1` says whether it
    passes by itself, and its code stays empty.
    """
    _check_length(name, payload)
    try:
        refusal = reply_of(name, payload, commands.Refused)
    except MalformedReplyError:
        refusal = commands.Refused(error=f"{name}: {payload[:200].decode(errors='replace')}")
    if refusal.passes is None:
        refusal = replace(refusal, passes=version_1.passes(refusal.error))
    if len(refusal.error) > _LONGEST_ERROR:
        refusal = replace(refusal, error=f"{refusal.error[:_LONGEST_ERROR]} …")
    return refusal


def _check_length(name: str, payload: bytes) -> None:
    if len(payload) > MOST_BYTES:
        raise MalformedReplyError(
            f"the answer to {name!r} has {len(payload)} B, at most {MOST_BYTES} B are read"
        )


class RefusedError(RigError):
    """The daemon refuses a command, which had no effect."""

    def __init__(
        self, message: str, code: str = "", parameters: Mapping[str, commands.Fact] | None = None
    ) -> None:
        """Take the message, and what a daemon of today says beside it."""
        super().__init__(message)
        self.code = code
        """Why, for programs: an `armrig_core.codes.RefusalCode`; "" where it is not known."""
        self.parameters = parameters or {}
        """What the message is about, by name."""


class BusyError(RefusedError):
    """The daemon refuses a command for the moment, and may take the same a little later."""


class RunEndedError(RigError):
    """A run ended before its last sample."""

    def __init__(self, why: str, recording: Path, *, is_named: bool = False) -> None:
        """Take the reason; the message says where the recording is, unless the reason does."""
        super().__init__(why if is_named else f"{why}; recorded in {recording}")
        self.why = why
        """How many samples were taken, and why the run ended."""
        self.recording = recording


def this_user() -> str:
    """Return the login name; "" where there is none."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # the latter before Python 3.13
        return ""


def refused(refusal: commands.Refused) -> RefusedError:
    """Return what is raised for a refusal."""
    kind = BusyError if refusal.passes else RefusedError
    return kind(refusal.error, refusal.code, refusal.parameters)


def complete_recording(last: commands.LastRun, asked: int) -> Path:
    """Return the recording of a run that has played all samples asked for."""
    recording = Path(last.recording)
    if not last.is_complete:
        why = f"the run ended after {last.samples} of {asked} samples: {last.outcome}"
        # Where the file failed, the outcome says what became of it, and where it is.
        raise RunEndedError(why, recording, is_named=last.code == OutcomeCode.RECORDING)
    return recording
