"""All that a rig publishes, message after message and none twice, from a daemon that may go away.

Nothing is subscribed to: the daemon keeps what it published of late, in one numbered row, and is
asked for what follows the last message that came. A slow line, a lost one and a late beginning are
then the same: the next question begins where the last answer ended.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import zenoh
from armrig_core.errors import MalformedReplyError
from armrig_core.history import REPLY_LIMIT, HistoryRequest, Past, decode_past
from armrig_core.topics import history_key

from armrig.rig.session import RigError

_REPLY_S = 1.0
_NO_DAEMON = "what answers there is no armrigd"


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """What came by one question."""

    past: Past
    """The messages, which follow those of the piece before."""
    is_new_life: bool
    """The daemon was started anew: its numbers, and the samples', begin again."""
    lost: int
    """Messages that are gone for good between the piece before and this one."""

    @property
    def is_full(self) -> bool:
        """Whether there was more than one answer takes."""
        return sum(len(data) for _, data in self.past.messages) >= REPLY_LIMIT


class RemoteSource:
    """A place in the row of what a daemon has published."""

    def __init__(self, session: zenoh.Session, rig: str) -> None:
        """Begin with the oldest message that the daemon keeps."""
        self._session, self._key = session, history_key(rig)
        self._life = b""
        self._next = 0

    def next_piece(self) -> Piece | None:
        """Return what follows, perhaps nothing; None where the daemon does not answer now.

        Raises
        ------
        RigError
            What answers is no daemon of this version.
        """
        past = self._asked(self._next, self._life)
        if past is None:
            return None
        is_new, began = past.life != self._life, bool(self._life)
        if is_new and self._next:
            # What was asked for is a number of another row; this one is taken from its beginning.
            past = self._asked(0, past.life)
            if past is None:
                return None
        lost = past.first if is_new else past.first - self._next
        if lost < 0:
            msg = f"{self._key}: the messages from {self._next} on were asked for, and those from "
            raise RigError(f"{msg}{past.first} on came; {_NO_DAEMON}")
        self._life, self._next = past.life, past.first + len(past.messages)
        return Piece(past=past, is_new_life=is_new and began, lost=lost if began else 0)

    def _asked(self, first: int, life: bytes) -> Past | None:
        """Return the answer of the daemon with this life, or of the only one there is."""
        question = msgspec.json.encode(HistoryRequest(first=first))
        others: dict[bytes, Past] = {}
        refused = False
        for reply in self._session.get(
            self._key,
            payload=question,
            timeout=_REPLY_S,
            # Else one of several answers would be chosen for us, now this one and now that one.
            consolidation=zenoh.ConsolidationMode.NONE,
        ):
            if reply.ok is None:  # too many ask just now, or it came too late
                refused = True
                continue
            try:
                past = decode_past(reply.ok.payload.to_bytes())
            except MalformedReplyError as err:
                raise RigError(f"{self._key}: {err}; {_NO_DAEMON} of this version") from err
            if past.life == life:
                return past
            others[past.life] = past
        if len(others) > 1:
            msg = f"{self._key}: {len(others)} daemons answer, which is which cannot be told; end "
            raise RigError(msg + "all but one, or give each rig an id of its own")
        # One that answers where another has no time to may not be ours.
        return None if refused else next(iter(others.values()), None)
