"""Source that returns each message of a rig only once, even if the daemon is restarted.

The source uses no subscription. The daemon keeps its recent messages in one numbered sequence. The
source queries the messages after the last received message. A slow connection, a lost connection
and a late start therefore need no special cases.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import zenoh
from armrig_core.errors import MalformedReplyError
from armrig_core.telemetry.history import REPLY_LIMIT, HistoryRequest, Past, decode_past
from armrig_core.telemetry.topics import history_key

from armrig.rig.session import RigError

_REPLY_TIMEOUT_S, _FIRST_REPLY_TIMEOUT_S = 1.0, 5.0  # the first answer may wait for a busy machine
_NO_DAEMON = "the sender is not an armrigd"


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """Messages in the answer to one query."""

    past: Past
    """Messages that follow the messages of the previous piece."""
    is_new_life: bool
    """True if the daemon was restarted: the numbers of messages and samples begin again."""
    lost: int
    """Number of messages lost between the previous piece and this piece."""

    @property
    def is_full(self) -> bool:
        """True if the answer is full, so that more messages may be available."""
        return sum(len(data) for _, data in self.past.messages) >= REPLY_LIMIT


class RemoteSource:
    """Reader of a daemon's messages; the reader stores its position in the sequence of messages."""

    def __init__(self, session: zenoh.Session, rig: str) -> None:
        """Prepare queries, beginning with the oldest message that the daemon keeps."""
        self._session, self._key = session, history_key(rig)
        self._life = b""
        self._next = 0

    def next_piece(self) -> Piece | None:
        """Return the next messages, or an empty piece if there are none; None if no answer comes.

        Raises RigError if the sender is not a daemon of this version.
        """
        past = self._request_past(self._next, self._life)
        if past is None:
            return None
        is_new, began = past.life != self._life, bool(self._life)
        if is_new and self._next:
            # The queried number belongs to the old sequence. The new sequence is read from its
            # beginning.
            past = self._request_past(0, past.life)
            if past is None:
                return None
        lost = past.first if is_new else past.first - self._next
        if lost < 0:
            msg = f"{self._key}: messages from number {self._next} on were requested, but messages "
            raise RigError(f"{msg}from {past.first} on arrived; {_NO_DAEMON}")
        self._life, self._next = past.life, past.first + len(past.messages)
        return Piece(past=past, is_new_life=is_new and began, lost=lost if began else 0)

    def _request_past(self, first: int, life: bytes) -> Past | None:
        """Return the answer of the daemon with the id `life`, or of the only answering daemon."""
        question = msgspec.json.encode(HistoryRequest(first=first))
        others: dict[bytes, Past] = {}
        refused = False
        for reply in self._session.get(
            self._key,
            payload=question,
            timeout=_REPLY_TIMEOUT_S if self._life else _FIRST_REPLY_TIMEOUT_S,
            # With consolidation, zenoh would choose one of several answers at random.
            consolidation=zenoh.ConsolidationMode.NONE,
        ):
            if reply.ok is None:  # too many queries at the moment, or the answer came too late
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
            msg = f"{self._key}: {len(others)} daemons answer and cannot be distinguished; end "
            raise RigError(msg + "all but one, or give each rig an id of its own")
            # The only answer may be of another daemon if the right daemon was too busy to answer.
        return None if refused else next(iter(others.values()), None)
