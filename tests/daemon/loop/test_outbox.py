"""Records of the loop to a slow service."""

from __future__ import annotations

from armrig_core.commands.codes import GapCode, OutcomeCode
from armrig_core.telemetry.channels import SAMPLE_FIELDS
from armrig_core.telemetry.telemetry import Sample, decode_sample
from armrig_daemon.loop.outbox import MAX_WAITING_RECORDS, Outbox
from armrig_daemon.pipe import Gap, Log, Record, RunEnded, take_records
from hypothesis import given
from hypothesis import strategies as st

ENDED = RunEnded(run_id="r", outcome="complete", outcome_code=OutcomeCode.COMPLETE)


class Pipe:
    """A pipe that takes so many records, and then no more."""

    def __init__(self, room: int) -> None:
        self.room = room
        self._bytes = bytearray()

    def now_ns(self) -> int:
        """Return a time."""
        return 7

    def put(self, text: bytes) -> bool:
        """Take a record, if there is room."""
        if self.room <= 0:
            return False
        self.room -= 1
        self._bytes += text
        return True

    def taken(self) -> list[int | Record]:
        """Return what came through, samples as their k."""
        records = take_records(self._bytes)
        return [decode_sample(r).k if isinstance(r, bytes) else r for r in records]


def _sample(k: int) -> Sample:
    return Sample(*(0 for _ in SAMPLE_FIELDS))._replace(k=k, t_host_ns=k)


def test_samples_without_room_are_replaced_by_one_gap() -> None:
    """L2: count and first k, both times, the voltage held last; then the samples follow."""
    pipe = Pipe(2)
    outbox = Outbox(pipe)

    for k in range(5):
        outbox.put_sample(_sample(k)._replace(u_applied_v=float(k)))
    pipe.room = 10
    outbox.put_sample(_sample(5))

    zero, one, gap, five = pipe.taken()
    assert (zero, one, five) == (0, 1, 5)
    assert gap == Gap(
        k_first=2,
        count=3,
        t_from_ns=2,
        t_to_ns=4,
        u_held_v=4.0,
        reason="the service did not keep up",
        code=GapCode.SERVICE_LATE,
    )


def test_the_end_of_a_run_waits_for_room() -> None:
    pipe = Pipe(1)
    outbox = Outbox(pipe)

    outbox.put_sample(_sample(0))
    outbox.put_sample(_sample(1))
    outbox.put(ENDED)
    pipe.room = 10
    outbox.flush()

    zero, gap, ended = pipe.taken()
    assert zero == 0
    assert isinstance(gap, Gap)
    assert ended == ENDED


@given(st.lists(st.tuples(st.sampled_from(["sample", "record"]), st.integers(0, 3)), max_size=60))
def test_every_sample_is_delivered_or_reported_in_a_gap(steps: list[tuple[str, int]]) -> None:
    pipe = Pipe(0)
    outbox = Outbox(pipe)
    k = 0
    for kind, room in steps:
        pipe.room += room
        if kind == "sample":
            outbox.put_sample(_sample(k))
            k += 1
        else:
            outbox.put(ENDED)
    pipe.room = 1000
    outbox.put(ENDED)

    seen: list[int] = []
    for item in pipe.taken():
        if isinstance(item, int):
            seen.append(item)
        elif isinstance(item, Gap):
            seen += range(item.k_first, item.k_first + item.count)
    assert seen == list(range(k))


def test_log_lines_are_dropped_from_a_full_outbox_and_the_loss_is_reported() -> None:
    """R1: the end of a run is kept."""
    pipe = Pipe(0)
    outbox = Outbox(pipe)
    for i in range(3 * MAX_WAITING_RECORDS):
        outbox.put(Log(t_host_ns=i, level="info", message="a line"))
    outbox.put(ENDED)

    pipe.room = 10 * MAX_WAITING_RECORDS
    for _ in range(4):  # the loss is reported once
        outbox.flush()

    taken = pipe.taken()
    assert len(taken) == MAX_WAITING_RECORDS + 2
    assert taken[MAX_WAITING_RECORDS] == ENDED
    last = taken[-1]
    assert isinstance(last, Log)
    assert last.message.startswith(f"{2 * MAX_WAITING_RECORDS} messages were dropped")
    assert last.level == "warning"
