"""Lines that come again and again: one a second, and none uncounted."""

from __future__ import annotations

from armrig_daemon.pipe import Log
from armrig_daemon.service.thinning import HOLD_NS, MAX_KINDS, Thinning

MS = 1_000_000


def _log(ms: int, message: str, level: str = "warning", **fields: str) -> Log:
    return Log(t_host_ns=ms * MS, level=level, message=message, fields=fields)


def _missed(ms: int) -> Log:
    return _log(ms, f"sample {ms} had no setpoint: its input was {ms / 1000} V")


def test_lines_that_differ_in_numbers_only_are_said_once_a_second() -> None:
    thinning = Thinning()

    said = [log for ms in range(1000) if thinning.lets_through(log := _missed(ms))]
    due = thinning.due(HOLD_NS)

    assert said == [_missed(0)]
    (line,) = due
    assert line.message == _missed(999).message + " (999 similar lines since the last)"
    assert line.level == "warning"
    assert thinning.due(HOLD_NS + MS) == []


def test_a_flood_goes_on_at_a_line_a_second() -> None:
    thinning = Thinning()
    lines, counted = 0, 0
    for ms in range(5000):
        lines += thinning.lets_through(_missed(ms))
        for line in thinning.due(ms * MS):
            lines += 1
            counted += int(line.message.rsplit("(", 1)[1].split()[0])
    counted += sum(int(x.message.rsplit("(", 1)[1].split()[0]) for x in thinning.due(0, end=True))

    assert lines <= 6
    assert counted == 4999


def test_a_line_that_comes_now_and_then_is_said_as_it_is() -> None:
    thinning = Thinning()
    assert thinning.lets_through(_missed(0))
    assert not thinning.lets_through(_missed(500))

    assert thinning.due(999 * MS) == []
    assert thinning.due(1000 * MS) == [_missed(500)]
    assert thinning.due(2000 * MS) == []
    assert thinning.lets_through(_missed(3000))


def test_other_lines_and_errors_are_not_held_back() -> None:
    thinning = Thinning()
    assert thinning.lets_through(_missed(0))

    assert thinning.lets_through(_log(1, "the device was reset"))
    assert all(thinning.lets_through(_log(ms, "u[3] is not allowed", "error")) for ms in range(10))


def test_at_the_end_nothing_stays_held_back() -> None:
    thinning = Thinning()
    for ms in range(3):
        thinning.lets_through(_missed(ms))

    (line,) = thinning.due(3 * MS, end=True)

    assert line.message.endswith("(2 similar lines since the last)")


def test_the_number_of_kinds_of_lines_has_a_bound() -> None:
    thinning = Thinning()
    words = ["".join(chr(97 + int(d)) for d in str(i)) for i in range(MAX_KINDS + 50)]

    assert all(thinning.lets_through(_log(0, word)) for word in words)
    assert thinning.lets_through(_log(0, words[-1]))
    assert not thinning.lets_through(_log(0, words[0]))


def test_two_commanders_are_both_named() -> None:
    thinning = Thinning()
    said = [
        thinning.lets_through(_log(0, f"stop: by {who}", "info", command="stop"))
        for who in ("group 3", "group 4", "group 3")
    ]

    assert said == [True, True, False]
