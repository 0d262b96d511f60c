"""Gaps as lines: a line a second at most, and every sample counted."""

from __future__ import annotations

from armrig.recordings.daemon_reports import Gap, gap_lines
from armrig_core.codes import GapCode


def _gap(t: float, count: int = 1, code: GapCode = GapCode.FRAME_LOST) -> Gap:
    k = round(t * 100)
    return Gap(k_first=k, count=count, t=t, u_held_v=1.0, reason=code.sentence, code=code)


def test_a_gap_alone_is_reported_as_it_is() -> None:
    assert gap_lines([_gap(3.25, 7)]) == ["7 samples at 3.250 s, a frame was lost"]
    assert gap_lines([]) == []


def test_the_gaps_of_a_second_share_a_line() -> None:
    gaps = [_gap(0.5), *(_gap(2 + i / 100) for i in range(50)), _gap(2.9, 3, GapCode.HOST_LATE)]

    assert gap_lines(gaps) == [
        "1 sample at 0.500 s, a frame was lost",
        "53 samples in 51 gaps from 2.000 s to 2.900 s, a frame was lost, the host was late",
    ]
