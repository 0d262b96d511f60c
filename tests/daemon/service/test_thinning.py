"""Lines that come again and again: one a second, and none uncounted."""

from __future__ import annotations

from armrig_daemon.pipe import Log
from armrig_daemon.service.thinning import MAX_KINDS, Thinning

MS = 1_000_000


def _log(ms: int, message: str, level: str = "warning", **fields: str) -> Log:
    return Log(t_host_ns=ms * MS, level=level, message=message, fields=fields)


def test_the_number_of_kinds_of_lines_has_a_bound() -> None:
    thinning = Thinning()
    words = ["".join(chr(97 + int(d)) for d in str(i)) for i in range(MAX_KINDS + 50)]

    assert all(thinning.lets_through(_log(0, word)) for word in words)
    assert thinning.lets_through(_log(0, words[-1]))
    assert not thinning.lets_through(_log(0, words[0]))
