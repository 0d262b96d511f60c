"""The replies of a daemon: decoded, or refused where no daemon of this version replies so."""

from __future__ import annotations

from typing import TypeVar

import msgspec
from armrig_core import commands, version_1
from armrig_core.errors import MalformedReplyError
from msgspec.structs import replace

MOST_BYTES = 1 << 20
"""Longest reply that is read, in B; a daemon's longest have a few thousand."""
_LONGEST_ERROR = 1000  # characters that are shown

_R = TypeVar("_R")


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
