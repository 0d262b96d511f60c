"""Decoding of a daemon's replies; a malformed reply raises an error."""

from __future__ import annotations

import getpass
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import msgspec
from armrig_core.commands import commands
from armrig_core.commands.codes import OutcomeCode, RefusalCode
from armrig_core.errors import MalformedReplyError
from msgspec.structs import replace

from armrig.rig.session import RigError

MOST_BYTES = 1 << 20
"""Longest reply that is read, in B; a daemon's longest replies have a few thousand B."""
_MAX_ERROR_CHARACTERS = 1000

_R = TypeVar("_R")

Progress = Callable[[int, int], None]
"""Callback with two arguments: number of samples taken so far, and number of all samples."""


def reply_of(name: str, payload: bytes, answer: type[_R]) -> _R:
    """Decode the reply to the command `name`.

    Raises MalformedReplyError if the reply is too long or not JSON, or a field is missing or of
    another type. The message contains the name of the field.
    """
    _check_length(name, payload)
    try:
        return msgspec.json.decode(payload, type=answer)
    except (msgspec.DecodeError, UnicodeDecodeError) as err:  # includes ValidationError
        raise MalformedReplyError(f"the answer to {name!r} cannot be read: {err}") from err
    except RecursionError as err:
        raise MalformedReplyError(
            f"the answer to {name!r} cannot be read: nested too deeply"
        ) from err


def refusal_of(name: str, payload: bytes) -> commands.Refused:
    """Decode the refusal of the command `name`; the refusal is JSON or plain text.

    Only a refusal that is too long raises MalformedReplyError.
    """
    _check_length(name, payload)
    try:
        refusal = reply_of(name, payload, commands.Refused)
    except MalformedReplyError:
        refusal = commands.Refused(error=f"{name}: {payload[:200].decode(errors='replace')}")
    if len(refusal.error) > _MAX_ERROR_CHARACTERS:
        refusal = replace(refusal, error=f"{refusal.error[:_MAX_ERROR_CHARACTERS]} …")
    return refusal


def _check_length(name: str, payload: bytes) -> None:
    if len(payload) > MOST_BYTES:
        raise MalformedReplyError(
            f"the answer to {name!r} has {len(payload)} B; at most {MOST_BYTES} B are read"
        )


class RefusedError(RigError):
    """The daemon refused a command; the command had no effect."""

    def __init__(
        self, message: str, code: str = "", parameters: Mapping[str, commands.Fact] | None = None
    ) -> None:
        """Store the message, and the code and parameters that a daemon of this version sends."""
        super().__init__(message)
        self.code = code
        """Code of the reason: an `armrig_core.commands.codes.RefusalCode`; "" if unknown."""
        self.parameters = parameters or {}
        """Values in the message, by name."""


class BusyError(RefusedError):
    """The daemon refused a command temporarily; the same command may succeed shortly after."""


class RunEndedError(RigError):
    """A run ended before its last sample."""

    def __init__(self, why: str, recording: Path, *, is_named: bool = False) -> None:
        """Store the reason; add the recording's path to the message unless `why` contains it."""
        super().__init__(why if is_named else f"{why}; recorded in {recording}")
        self.why = why
        """Text with the number of samples taken, and the reason for the end of the run."""
        self.recording = recording


def this_user() -> str:
    """Return the login name of this user, with ? for bytes that are no text; "" if unknown."""
    try:
        return getpass.getuser().encode(errors="replace").decode()
    except (OSError, KeyError):  # KeyError before Python 3.13
        return ""


def refusal_error(refusal: commands.Refused) -> RefusedError:
    """Return the exception for a refusal."""
    kind = BusyError if refusal.passes else RefusedError
    return kind(refusal.error, refusal.code, refusal.parameters)


def refusal_sentence(err: RigError, way_out: str) -> str:
    """Return the reason for the refusal of a command; for a latched fault, also the remedy."""
    if isinstance(err, RefusedError) and err.code == RefusalCode.IN_FAULT:
        return f"in fault ({err.parameters.get('reason', '')}): repair it, then {way_out}"
    return str(err)


def reset_command(rig: str, connect: str | None) -> str:
    """Return the command that resets this rig."""
    words = ["armrig", "reset"]
    if rig != "1":
        words += ["--rig", rig]
    if connect:
        words += ["--connect", connect]
    return f"`{' '.join(words)}`"


def complete_recording(last: commands.LastRun, asked: int) -> Path:
    """Return the path of a complete run's recording; raise RunEndedError if the run ended early."""
    recording = Path(last.recording)
    if not last.is_complete:
        why = f"the run ended after {last.samples} of {asked} samples: {last.outcome}"
        # If the recording failed, the outcome contains the state and the path of the file.
        raise RunEndedError(why, recording, is_named=last.code == OutcomeCode.RECORDING)
    return recording
