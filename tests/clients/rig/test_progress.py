"""Numbers of the progress bar of a run."""

from __future__ import annotations

from typing import Any, NamedTuple

from armrig.rig.progress import TimingNote

from tests.clients.made_recordings import sample, timing


class Missing(NamedTuple):
    """Content of a gap record."""

    k_first: int
    count: int


def test_missing_counts_what_the_recording_counts() -> None:
    arrived: list[list[Any]] = [[sample(k) for k in (100, 101)]]
    gaps: list[list[Any]] = [[Missing(95, 3), Missing(102, 2), Missing(108, 5), Missing(111, 1)]]
    note = TimingNote(
        10, lambda: arrived.pop() if arrived else [], lambda: gaps.pop() if gaps else [], list
    )

    assert "missing 4" in note()


def test_the_lateness_is_the_last_second_s_and_the_queue_the_last_report_s() -> None:
    def late(first: int, count: int, late_us: int) -> list[Any]:
        return [
            sample(k, t_host_ns=sample(k).t_sched_ns + late_us * 1000)
            for k in range(first, first + count)
        ]

    def report(p50: float, n: int) -> Any:
        made = timing(0)
        made.queue_depth.p50, made.queue_depth.n = p50, n
        return made

    lots = [
        [sample(6, flags=0)],
        [sample(6, flags=0), *late(7, 100, 5000)],
        late(107, 20, 300),
        late(127, 80, 50),
    ]
    gaps: list[list[Any]] = [[Missing(5, 4)], [], [Missing(206, 9)]]
    reports = [[report(3, 9)], [report(17, 100)], [report(17, 100), report(5, 0)]]
    pieces = [iter(each) for each in (lots, gaps, reports)]

    note = TimingNote(200, *(lambda piece=piece: next(piece) for piece in pieces))

    assert [note() for _ in range(4)] == [
        "",
        "host late p99 5000 µs, missing 2, queue 3",
        "host late p99 5000 µs, missing 2, queue 17",
        "host late p99 300 µs, missing 3",
    ]
