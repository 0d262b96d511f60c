"""The core decides a traced run again, exactly as before."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import pytest
from armrig_daemon.decisions import step as core_step
from armrig_daemon.decisions import trace
from armrig_daemon.decisions.state import (
    Emit,
    LinkDown,
    LinkUp,
    Ordered,
    Publish,
    Received,
    Send,
    ServiceGone,
    Tick,
    Wakeup,
)
from armrig_daemon.pipe import (
    Answer,
    Arm,
    Run,
    RunStarted,
    Set,
    Trace,
)

from tests.daemon.decision_states import driven
from tests.daemon.virtual_bench import LEASE, Bench, codes

VOLTS = [0.5, 2.0, 5.0, 1.0] * 50


def traced(bench: Bench, *, scheduled: bool) -> list[Trace]:
    """Play a run over a line that spoils some of the bytes, and return its trace."""
    count = iter(range(1_000_000))

    def spoil(data: bytes) -> bytes:
        return data if next(count) % 15 else data[:4] + b"\x55" + data[5:]

    bench.play(VOLTS, 10_000, scheduled=scheduled)
    bench.run_for(150)
    bench.ports.from_device = spoil
    bench.order(Set(order=10, lease=LEASE, n=1, code=3))  # refused
    bench.run_for(2_500)
    chunks: list[Trace] = bench.of(Trace)
    return chunks


@pytest.mark.parametrize("scheduled", [False, True])
def test_the_trace_of_a_run_reproduces_its_decisions(scheduled: bool) -> None:
    bench = Bench()

    chunks = traced(bench, scheduled=scheduled)

    assert [c.number for c in chunks] == list(range(len(chunks)))
    assert len(chunks) > 3
    state = trace.decode_state(chunks[0].state, codes(*VOLTS))
    steps = [step for chunk in chunks for step in trace.steps_of(chunk.steps)]
    assert all(a.now_ns <= b.now_ns for a, b in pairwise(steps))
    for step in steps:
        state, actions = core_step.step(state, step.now_ns, step.events)
        assert tuple(a.data for a in actions if isinstance(a, Send)) == step.sent
    assert sum(len(step.sent) for step in steps) > (10 if scheduled else 150)
    kinds = {type(e) for step in steps for e in step.events}
    assert {Tick, Received, Ordered} <= kinds
    assert state.run is None  # up to the end of the run, that end included


def test_every_event_is_restored_from_its_bytes() -> None:
    bench = Bench()
    traced(bench, scheduled=True)
    book = trace.TraceBuffer(bench.loop.state)
    order = Run(order=1, lease="b" * 32, n=5, run_id="x", codes=b"12", scheduled=True)
    events = [
        *(Tick(7, 70), Wakeup(), Received(b"\0\1\2"), LinkUp(), LinkDown("gone"), ServiceGone()),
        Ordered(order),
    ]

    book.note(123, events, [Send(b"a"), Send(b"bc")])

    (chunk,) = book.rest()
    ((now_ns, come_back, sent),) = trace.steps_of(chunk.steps)
    assert (now_ns, sent) == (123, (b"a", b"bc"))
    assert come_back[:-1] == tuple(events[:-1])
    (last,) = (e for e in come_back if isinstance(e, Ordered))
    assert last.order == Run(order=1, lease="", n=5, run_id="x", codes=b"", scheduled=True)


@pytest.mark.parametrize("version", [1, 3])
def test_a_trace_of_another_version_is_refused(version: int) -> None:
    with pytest.raises(msgspec.DecodeError, match=f"version {version}: only 2 is known"):
        trace.steps_of(msgspec.msgpack.encode([]), version)
    with pytest.raises(msgspec.DecodeError, match=f"version {version}: only 2 is known"):
        trace.decode_state(b"", b"", version)


def test_a_recording_does_not_contain_the_lease() -> None:
    bench = Bench()
    bench.play(VOLTS, scheduled=False)
    bench.run_for(100)
    bench.order(Set(order=10, lease=LEASE, n=1, code=3))  # refused: an experiment is running
    bench.order(Set(order=11, lease="b" * 32, n=2, code=3))  # refused: another lease
    bench.order(Arm(order=12, owner="Ada", lease=LEASE, ts_us=10_000))  # refused: held
    bench.run_for(2_500)

    chunks = bench.of(Trace)
    assert chunks
    assert not any(LEASE.encode() in c.state + c.steps for c in chunks)
    state = trace.decode_state(chunks[0].state, codes(*VOLTS))
    refused = []
    for step in (s for c in chunks for s in trace.steps_of(c.steps)):
        state, actions = core_step.step(state, step.now_ns, step.events)
        refused += [
            a.record.error
            for a in actions
            if isinstance(a, Emit) and isinstance(a.record, Answer) and a.record.error
        ]
    assert [r.split(" ")[0:2] for r in refused] == [
        ["the", "experiment"],
        ["not", "the"],
        ["a", "student"],
    ]


def test_chunks_fit_into_the_pipe_and_a_flood_leaves_a_numbered_gap() -> None:
    """4096 bytes are written at once."""
    bench = Bench()
    book = trace.TraceBuffer(bench.loop.state)
    taken = []
    for n in range(999):
        book.note(n, [Received(b"x" * (7 * n % 2048))], [Send(b"y" * 57)] * 8)
        if n % 3 == 0:
            taken += book.full()
    book.note(1, [Received(b"z" * 5000)], [])
    taken += book.rest()

    assert taken[0].state
    assert all(len(c.state) + len(c.steps) <= trace.CHUNK_BYTES for c in taken)
    numbers = [c.number for c in taken]
    assert numbers[:-1] == list(range(len(numbers) - 1))
    assert numbers[-1] > numbers[-2] + 1


def test_a_state_and_a_long_first_step_are_two_chunks() -> None:
    """Together they had 4.1 kB, of which a pipe that is nearly full takes only a part."""
    state = Bench().loop.state
    book = trace.TraceBuffer(state)

    book.note(1, [Received(b"x" * 2900)], [])
    first, second = book.rest()

    assert trace.decode_state(first.state, b"") == state
    assert trace.steps_of(first.steps) == []
    assert [step.now_ns for step in trace.steps_of(second.steps)] == [1]


def test_the_trace_contains_the_samples_before_its_first_step() -> None:
    """A host that woke up late found the start and the first samples in one step."""
    bench = Bench()
    assert not bench.arm(2_000).error
    bench.lateness_ns = 9_000_000
    play = Run(order=9, lease=LEASE, n=0, run_id="r", codes=codes(*VOLTS), scheduled=True)
    bench.order(play)
    bench.run_for(1_000)

    chunks = bench.of(Trace)
    first = bench.of(RunStarted)[0].k_first
    state = trace.decode_state(chunks[0].state, codes(*VOLTS))
    told, published = state.last_reported_k, []
    for step in (s for c in chunks for s in trace.steps_of(c.steps)):
        state, actions = core_step.step(state, step.now_ns, step.events)
        published += [a.sample for a in actions if isinstance(a, Publish)]
    assert told >= first  # else nothing was tried
    assert [s.k for s in published] == list(range(told + 1, first + len(VOLTS)))


def test_the_trace_lies_between_the_records_of_the_start_and_end_of_a_run() -> None:
    bench = Bench()
    traced(bench, scheduled=True)

    names = [type(r).__name__ for r in bench.records if not isinstance(r, bytes)]
    assert names.index("RunStarted") < names.index("Trace")
    assert len(names) - 1 - names[::-1].index("Trace") < names.index("RunEnded")
    assert [type(r) for r in bench.of(RunStarted)] == [RunStarted]


def test_keys_of_a_trace_are_independent_of_field_names() -> None:
    """A trace of version 2 has these; another name of the field makes no other version."""
    fields = msgspec.msgpack.decode(trace.encode_state(driven().loop.state))

    assert "told" in fields
    assert {"any_ns", "fresh_ns"} <= fields["link"].keys()
