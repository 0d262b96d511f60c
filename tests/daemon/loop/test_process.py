"""The loop's pipes and its line, by the real descriptors."""

from __future__ import annotations

import gc
import os
import select
import socket
import tty
import weakref
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import msgspec
import pytest
from armrig_core.access.emulator_socket import lock_path
from armrig_core.process import realtime
from armrig_daemon.config import Config
from armrig_daemon.decisions.state import LinkDown, LinkUp, Ordered, Received, ServiceGone
from armrig_daemon.loop import process
from armrig_daemon.loop.link import READ, TakenPortError
from armrig_daemon.loop.process import REOPEN_NS, LoopSettings, ProcessPorts
from armrig_daemon.pipe import Alive, Host, Log, record_bytes, take_records
from armrig_protocol.frame import encode
from armrig_protocol.messages import Estop
from msgspec.structs import replace

MS = 1_000_000


class _Circle:
    """Object that only a collection finds."""

    def __init__(self) -> None:
        self.itself = self


@pytest.fixture
def pipes() -> Iterator[dict[str, int]]:
    """Give both pipes and a pseudo-terminal; what the test has closed stays closed."""
    master, slave = os.openpty()
    orders_out, orders_in = os.pipe()
    records_out, records_in = os.pipe()
    for fd in (orders_out, records_in):
        os.set_blocking(fd, False)
    given = {
        "orders_out": orders_out,
        "orders_in": orders_in,
        "records_out": records_out,
        "records_in": records_in,
        "master": master,
        "slave": slave,
    }
    yield given
    for fd in given.values():
        os.close(fd)


@pytest.fixture
def ports(pipes: dict[str, int]) -> ProcessPorts:
    """Return ports whose line is open."""
    settings = LoopSettings(
        rules=Config().rules(),
        port=os.ttyname(pipes["slave"]),
        baud=115_200,
        priority=0,
        cpu=None,
        spin_ns=50_000,
    )
    ports = ProcessPorts(settings, pipes["orders_out"], pipes["records_in"])
    assert ports.wait(realtime.now_ns()) == [LinkUp()]
    return ports


def _read(fd: int, size: int) -> bytes:
    """Return so many bytes; a terminal gives them in pieces."""
    data = b""
    while len(data) < size:
        assert select.select([fd], [], [], 1)[0], data
        data += os.read(fd, size - len(data))
    return data


def test_an_undeliverable_record_does_not_hide_the_end_of_the_service(
    ports: ProcessPorts, pipes: dict[str, int]
) -> None:
    os.close(pipes.pop("records_out"))
    for _ in range(2):
        assert not ports.put(b"a record")

    os.close(pipes.pop("orders_in"))

    assert ports.wait(realtime.now_ns() + 100 * MS) == [ServiceGone()]
    assert ports.wait(realtime.now_ns() + MS) == []


def test_large_input_is_returned_in_pieces_without_waiting(
    ports: ProcessPorts, pipes: dict[str, int]
) -> None:
    tty.setraw(pipes["slave"])
    sent = bytes(range(1, 251)) * 12
    os.write(pipes["master"], sent)

    come = []
    while sum(map(len, come)) < len(sent):
        (event,) = ports.wait(realtime.now_ns() + 10_000 * MS)
        assert isinstance(event, Received)
        come.append(event.data)

    assert b"".join(come) == sent
    assert max(map(len, come)) <= READ


def test_a_disconnected_line_is_read_to_its_end_before_the_loss_is_reported(
    ports: ProcessPorts, pipes: dict[str, int]
) -> None:
    tty.setraw(pipes["slave"])
    os.write(pipes["master"], b"last words")
    os.close(pipes.pop("master"))

    events = []
    while not any(isinstance(event, LinkDown) for event in events):
        events += ports.wait(realtime.now_ns() + 10_000 * MS)

    assert len([event for event in events if isinstance(event, LinkDown)]) == 1


def test_a_hung_up_line_is_read_to_its_end_after_a_single_report(
    ports: ProcessPorts, pipes: dict[str, int]
) -> None:
    tty.setraw(pipes["slave"])
    os.write(pipes["master"], b"last words")
    ((fd, _),) = ports._waiter.wait_until(realtime.now_ns() + 30_000 * MS)
    told = [[], [(fd, select.EPOLLIN | select.EPOLLHUP)]]
    ports._waiter = SimpleNamespace(
        wait_until=lambda _: told.pop(), ready=list, forget=lambda _: None
    )

    assert ports.wait(0) == [Received(b"last words")]
    os.close(pipes.pop("master"))

    assert [type(event) for event in ports.wait(0)] == [LinkDown]


def test_an_order_and_an_answer_that_arrive_together_are_both_processed(
    ports: ProcessPorts, pipes: dict[str, int]
) -> None:
    tty.setraw(pipes["slave"])
    os.write(pipes["orders_in"], record_bytes(Alive()))
    os.write(pipes["master"], b"answer")
    select.select([pipes["slave"]], [], [])  # both are there

    events = ports.wait(realtime.now_ns() + 10_000 * MS)
    while len(events) < 2:
        events += ports.wait(realtime.now_ns() + 10_000 * MS)

    assert {type(event) for event in events} == {Ordered, Received}


def test_a_record_without_room_is_not_reported_as_written(
    ports: ProcessPorts, pipes: dict[str, int]
) -> None:
    """L2: a written record can be read whole; any other counts as missing."""
    offered, size = 100, 4000

    written = [ports.put(bytes([i]) * size) for i in range(offered)]

    got = os.read(pipes["records_out"], offered * size)
    assert got == b"".join(bytes([i]) * size for i in range(offered) if written[i])
    assert 0 < sum(written) < offered
    assert ports.put(b"there is room again")


def test_a_failing_loop_sends_estop_three_times(ports: ProcessPorts, pipes: dict[str, int]) -> None:
    half = b"half a fra"
    os.write(pipes["slave"], half)

    ports.stop_hard()

    wanted = b"".join(b"\0" + encode(Estop(0, seq)) for seq in range(3))
    assert _read(pipes["master"], len(half + wanted)) == half + wanted


def test_stop_hard_without_a_line_does_nothing(ports: ProcessPorts, pipes: dict[str, int]) -> None:
    os.close(pipes.pop("master"))
    ports.stop_hard()

    assert [type(event) for event in ports.wait(realtime.now_ns() + 100 * MS)] == [LinkDown]
    ports.stop_hard()


def test_lost_line_is_opened_again_after_the_interval(
    ports: ProcessPorts, pipes: dict[str, int]
) -> None:
    now_ns = realtime.now_ns()
    ports.now_ns = lambda: now_ns
    os.close(pipes.pop("master"))
    assert [type(event) for event in ports.wait(now_ns + 10_000 * MS)] == [LinkDown]

    now_ns += REOPEN_NS - 1
    assert ports.wait(now_ns) == []
    now_ns += 1
    assert [type(event) for event in ports.wait(now_ns)] == [LinkDown]
    now_ns += REOPEN_NS
    assert ports.wait(now_ns) == []


def test_a_line_that_was_opened_again_is_read_when_it_is_readable(
    ports: ProcessPorts, pipes: dict[str, int]
) -> None:
    os.close(pipes.pop("master"))
    now_ns = realtime.now_ns() + 30_000 * MS
    assert [type(event) for event in ports.wait(now_ns)] == [LinkDown]
    master, pipes["another"] = os.openpty()
    pipes["master"] = master
    ports._settings = replace(ports._settings, port=os.ttyname(pipes["another"]))
    ports.now_ns = lambda: now_ns + REOPEN_NS
    assert ports.wait(now_ns) == [LinkUp()]

    ports._link.read = lambda: pytest.fail("nobody said that there is more")

    assert ports.wait(0) == []


def test_tidy_collects_and_freezes_the_objects_of_a_run(ports: ProcessPorts) -> None:
    """A later collection would take longer, the more objects there are."""
    kept = [[k] for k in range(1000)]
    gone = weakref.ref(_Circle())
    collections, frozen = ports.collections, gc.get_freeze_count()

    ports.tidy()

    newly_frozen = gc.get_freeze_count() - frozen
    assert ports.collections > collections
    assert newly_frozen >= len(kept)
    assert gone() is None


def test_the_loop_does_not_spin_before_its_priority_is_granted(ports: ProcessPorts) -> None:
    """Without the priority a spin takes the processor from the program that it waits for."""
    assert ports.spin_ns == 0


@pytest.fixture
def emulator(tmp_path: Path) -> Iterator[socket.socket]:
    """Give a socket that listens as an emulator does."""
    path = tmp_path / "rig.sock"
    lock_path(path).touch(0o600)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(os.fspath(path))
        listener.listen()
        yield listener


class _Ports:
    """Ports of a program whose loop ends at once."""

    def __init__(self) -> None:
        self.spin_ns = 0
        self.done: list[object] = []

    def put(self, text: bytes) -> bool:
        """Note a record."""
        self.done += take_records(bytearray(text))
        return True

    def end_at(self, _: object) -> None:
        """Watch no signal."""

    def stop_hard(self) -> None:
        """Note the stop."""
        self.done.append("stop hard")


@pytest.fixture
def program() -> Iterator[_Ports]:
    """Give the ports of a program that changes nothing of this process."""
    ports = _Ports()
    loop = SimpleNamespace(run=lambda: None)
    prepared = {"fifo": 0, "refused": []}
    with (
        mock.patch.multiple(
            process, ProcessPorts=lambda *_: ports, SignalPipe=lambda: None, Loop=lambda *_: loop
        ),
        mock.patch.multiple(
            realtime, end_with_parent=int, ignore_signals=int, prepare=lambda *_: prepared
        ),
    ):
        yield ports


def _main(pipes: dict[str, int]) -> int:
    settings = LoopSettings(
        rules=Config().rules(), port="/dev/odd", baud=9600, priority=7, cpu=1, spin_ns=50_000
    )
    fds = [str(pipes["orders_out"]), str(pipes["records_in"])]
    return process.main([*fds, msgspec.json.encode(settings).decode()])


@pytest.mark.parametrize(("timer_ms", "warns"), [(None, 0), (1, 0), (2, 1), (16, 1)])
def test_an_adapter_that_delays_bytes_is_reported(
    pipes: dict[str, int],
    program: _Ports,
    timer_ms: int | None,
    warns: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(process, "latency_timer_ms", lambda port: timer_ms)

    assert _main(pipes) == 0

    logs = [record for record in program.done if isinstance(record, Log)]
    assert [(log.level, log.message) for log in logs] == [
        ("warning", f"/dev/odd: latency timer {timer_ms} ms, 1 ms is wanted: see `armrig doctor`")
    ] * warns


@pytest.mark.parametrize("fifo", [0, 7])
def test_the_loop_spins_if_it_has_its_priority(
    pipes: dict[str, int], program: _Ports, fifo: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    granted = {"fifo": fifo, "refused": ["mlockall"]}
    asked: list[object] = []
    monkeypatch.setattr(realtime, "prepare", lambda *of: asked.append(of) or granted)

    assert _main(pipes) == 0

    assert program.spin_ns == (50_000 if fifo else 0)
    assert (asked, program.done) == ([(7, 1)], [Host(granted=granted)])


def test_a_program_without_a_usable_port_reports_the_reason_and_its_exit_code(
    pipes: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    def taken(*_: object) -> None:
        raise TakenPortError("/dev/odd is in use")

    monkeypatch.setattr(process, "ProcessPorts", taken)

    assert _main(pipes) == 2

    (log,) = take_records(bytearray(os.read(pipes["records_out"], 1000)))
    assert isinstance(log, Log)
    assert (log.level, log.message) == ("error", "/dev/odd is in use")
