"""Each message of a rig once and in order, from any daemon that answers for it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from armrig.rig import remote_source
from armrig.rig.remote_source import RemoteSource
from armrig.rig.session import RigError
from armrig_core.telemetry.history import HistoryRequest, encode_past

LIFE, OTHER = b"a" * 16, b"b" * 16


class _Daemon:
    """Keeps messages from a number on, and answers some of them at once."""

    def __init__(self, life: bytes, first: int, n: int, most: int = 3) -> None:
        self.life, self.first, self.n, self.most = life, first, n, most

    def answer(self, asked: int) -> bytes:
        first = max(asked, self.first)
        last = min(first + self.most, self.first + self.n)
        sent = [("event", b"%d" % k) for k in range(first, last)]
        return encode_past(self.life, first, 7, sent)


class _Line:
    """Session at which these daemons answer; None is a refusal, b"" an answer of a stranger."""

    def __init__(self, *daemons: Any) -> None:
        self.daemons: list[Any] = [*daemons]
        self.asked: list[int] = []

    def get(self, key: str, *, payload: bytes, **_: Any) -> list[Any]:
        assert key == "rig/lab-2/history"
        first = msgspec.json.decode(payload, type=HistoryRequest).first
        self.asked.append(first)
        return [SimpleNamespace(ok=self._ok(daemon, first)) for daemon in self.daemons]

    @staticmethod
    def _ok(daemon: Any, first: int) -> Any:
        if daemon is None:
            return None
        answer = daemon.answer(first) if isinstance(daemon, _Daemon) else daemon
        return SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: answer))


def _source(*daemons: Any) -> tuple[_Line, RemoteSource]:
    line: Any = _Line(*daemons)
    return line, RemoteSource(line, "lab-2")


def _next(source: RemoteSource) -> tuple[list[int], bool, int]:
    """Return the next messages, whether their daemon is new, and how many messages are lost."""
    piece = source.next_piece()
    assert piece is not None
    return [int(data) for _, data in piece.past.messages], piece.is_new_life, piece.lost


def test_each_message_is_returned_once_and_dropped_messages_are_counted() -> None:
    line, source = _source(daemon := _Daemon(LIFE, 5, 4))

    assert [_next(source) for _ in range(3)] == [
        ([5, 6, 7], False, 0),  # what was before the recorder is not lost
        ([8], False, 0),
        ([], False, 0),
    ]
    daemon.first, daemon.n = 12, 2
    assert _next(source) == ([12, 13], False, 3)
    assert line.asked == [0, 8, 9, 9]


def test_the_history_of_a_restarted_daemon_is_read_from_its_beginning() -> None:
    line, source = _source(_Daemon(LIFE, 0, 3))
    _next(source)
    line.daemons = [_Daemon(OTHER, 2, 5)]

    assert _next(source) == ([2, 3, 4], True, 2)
    assert _next(source) == ([5, 6], False, 0)
    assert line.asked == [0, 3, 0, 5]


@pytest.mark.parametrize("others", [(None,), (), (b"",)])
def test_a_silent_rig_yields_no_messages(others: tuple[Any, ...]) -> None:
    line, source = _source(*others)
    if others == (b"",):
        with pytest.raises(RigError, match=r"^rig/lab-2/history: 0 B: .* not an armrigd of this"):
            source.next_piece()
        return

    assert source.next_piece() is None
    line.daemons = [_Daemon(LIFE, 0, 1)]
    assert _next(source) == ([0], False, 0)


def test_the_source_keeps_the_daemon_that_answered_first() -> None:
    line, source = _source(_Daemon(OTHER, 0, 9), _Daemon(LIFE, 0, 9))

    with pytest.raises(RigError, match="2 daemons answer and cannot be distinguished"):
        source.next_piece()
    line.daemons = [_Daemon(LIFE, 0, 9)]
    _next(source)
    line.daemons = [_Daemon(OTHER, 0, 9), None, _Daemon(LIFE, 0, 9)]
    assert _next(source) == ([3, 4, 5], False, 0)
    line.daemons = [None, _Daemon(OTHER, 0, 9)]  # the one that was heard is too busy
    assert source.next_piece() is None


def test_messages_before_the_requested_number_are_refused() -> None:
    line, source = _source(_Daemon(LIFE, 0, 3))
    _next(source)
    line.daemons = [encode_past(LIFE, 1, 7, [])]

    with pytest.raises(RigError, match="from number 3 on were requested, but messages from 1 on"):
        source.next_piece()


@pytest.mark.parametrize(("size", "is_full"), [(9, False), (10, True), (11, True)])
def test_an_answer_is_full_at_its_limit(
    monkeypatch: pytest.MonkeyPatch, size: int, is_full: bool
) -> None:
    monkeypatch.setattr(remote_source, "REPLY_LIMIT", 10)
    _, source = _source(encode_past(LIFE, 0, 7, [("event", b"1" * 4), ("gap", b"2" * (size - 4))]))

    piece = source.next_piece()

    assert piece is not None
    assert piece.is_full == is_full
