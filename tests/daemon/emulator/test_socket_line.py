"""The Unix socket between the loop's link and the emulator's line, both ends in one process."""

from __future__ import annotations

import gc
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from armrig_core.access.emulator_socket import lock_path
from armrig_core.errors import OperationError
from armrig_core.process.waiting import Waiter
from armrig_daemon.emulator import socket_line
from armrig_daemon.emulator.real_time import emulate
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.socket_line import SocketLine
from armrig_daemon.loop import link as link_module
from armrig_daemon.loop.link import Link, LinkError, NoPortError, TakenPortError, open_link

FRAME = bytes(range(1, 27))  # an EXCHANGE has 26 bytes


class Emulator:
    """The device's end, turned by hand as the emulator's loop turns it."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        self.path = path
        self.line = SocketLine(path, stack)
        self.waiter = stack.enter_context(closing(Waiter()))
        self.line.offer(Path(f"unix:{path}"), stack)
        self.line.watch(self.waiter)

    def was_opened(self) -> bool:
        """Read the kernel's reports; return whether the device must be reset."""
        self.line.watch_room()
        ready = dict(self.waiter.ready())
        if self.line.opened_fd in ready and self.line.was_opened():
            self.line.flush()
            return True
        if self.line.fd in ready:
            self.line.note_ready(ready[self.line.fd])
        return False

    def read(self) -> bytes:
        """Return all received bytes."""
        assert not self.was_opened()
        data = b""
        while self.line.connected and self.line.has_input:
            data += self.line.read()
        return data

    def host(self) -> Link:
        """Open the port as the daemon's loop does."""
        return open_link(f"unix:{self.path}", 115_200)


@pytest.fixture
def emulator(tmp_path: Path) -> Iterator[Emulator]:
    """Give the device's end of a line, at rest."""
    with ExitStack() as stack:
        yield Emulator(tmp_path / "rig.sock", stack)


@pytest.fixture
def host(emulator: Emulator) -> Iterator[Link]:
    """Give the host's end, opened."""
    link = emulator.host()
    assert emulator.was_opened()
    yield link
    link.close()


def _stranger(path: Path) -> socket.socket:
    """Connect to a socket without its lock."""
    with ExitStack() as stack:
        kind = socket.SOCK_STREAM | socket.SOCK_NONBLOCK
        stranger = stack.enter_context(socket.socket(socket.AF_UNIX, kind))
        stranger.connect(os.fspath(path))
        stack.pop_all()
    return stranger


def test_each_opening_resets_the_device_once(emulator: Emulator) -> None:
    gc.collect()  # or it closes a file of a test before in the meantime
    descriptors = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(3):
        host = emulator.host()
        assert emulator.was_opened()
        assert not emulator.was_opened()
        host.write(b"old frames")
        host.close()

    again = emulator.host()

    assert emulator.was_opened()
    assert emulator.read() == b""
    again.close()
    emulator.read()
    assert len(list(Path("/proc/self/fd").iterdir())) == descriptors


def test_bytes_sent_before_the_host_closes_are_read(emulator: Emulator, host: Link) -> None:
    """The last word of a host is often a STOP."""
    host.write(b"last words")
    host.close()

    assert emulator.read() == b"last words"
    assert not emulator.line.connected
    emulator.line.write(b"said to nobody")
    assert not emulator.was_opened()


def test_a_host_that_dies_with_unread_bytes_counts_as_closed(
    emulator: Emulator, host: Link
) -> None:
    """The kernel reports it by another error."""
    emulator.line.write(b"never read")
    host.write(b"last words")
    host.close()
    emulator.line.write(b"an answer")

    assert emulator.read() == b"last words"
    assert not emulator.line.connected
    again = emulator.host()
    assert emulator.was_opened()
    again.close()


def test_a_second_daemon_does_not_open_the_port(emulator: Emulator, host: Link) -> None:
    with pytest.raises(TakenPortError, match=r"rig\.sock cannot be opened: it is in use by"):
        emulator.host()

    assert not emulator.was_opened()
    host.close()
    emulator.host().close()


def test_a_program_that_ignores_the_lock_does_not_reach_the_rig(
    emulator: Emulator, host: Link
) -> None:
    with _stranger(emulator.path) as stranger:
        stranger.send(b"bytes of a stranger")
        assert not emulator.was_opened()
        emulator.line.write(b"for the host")
        host.write(b"from the host")

        assert emulator.read() == b"from the host"
        assert host.read() == b"for the host"
        with pytest.raises(ConnectionResetError):  # it was closed with bytes unread
            stranger.recv(1)
        assert stranger.recv(1) == b""


@pytest.mark.parametrize("opener", ["host", "emulator"])
def test_a_program_of_another_user_is_refused(
    emulator: Emulator, monkeypatch: pytest.MonkeyPatch, opener: str
) -> None:
    module = link_module if opener == "host" else socket_line
    monkeypatch.setattr(module, "stranger", lambda _: 4711)

    if opener == "host":
        with pytest.raises(LinkError, match=r"cannot be opened: a program of another user .uid"):
            emulator.host()
        return
    host = emulator.host()
    assert not emulator.was_opened()
    with pytest.raises(LinkError, match="is gone: end of file"):
        host.read()
    host.close()


def test_a_device_that_stops_reading_is_a_loss_of_the_line(emulator: Emulator, host: Link) -> None:
    """S4 alone ends an exchange of 0.5 ms."""

    def write(frames: int) -> None:
        for _ in range(frames):
            host.write(FRAME)

    write(100)
    with pytest.raises(LinkError, match="accepts no more bytes, because the device does not"):
        write(100)

    assert len(emulator.read()) >= 100 * len(FRAME)
    host.write(FRAME)


@pytest.mark.parametrize("use", [Link.read, lambda link: link.write(b"a frame")])
def test_the_end_of_the_emulator_is_a_loss_of_the_line(
    tmp_path: Path, use: Callable[[Link], object]
) -> None:
    with ExitStack() as stack:
        emulator = Emulator(tmp_path / "rig.sock", stack)
        host = emulator.host()
        assert emulator.was_opened()

    with pytest.raises(LinkError, match=r"unix:.*rig\.sock is gone: "):
        use(host)
    host.close()
    with pytest.raises(NoPortError, match=r"it is not there; start `armrigd emulate --port unix:/"):
        emulator.host()


def test_only_the_user_of_the_emulator_can_open_its_socket(emulator: Emulator) -> None:
    lock = lock_path(emulator.path)

    assert sorted(emulator.path.parent.iterdir()) == [emulator.path, lock]
    assert [path.stat().st_mode & 0o777 for path in (emulator.path, lock)] == [0o600, 0o600]


def test_an_emulator_removes_its_port_when_it_ends(tmp_path: Path) -> None:
    path = tmp_path / "rig.sock"
    with ExitStack() as stack:
        Emulator(path, stack)
    assert list(tmp_path.iterdir()) == []

    with ExitStack() as first, ExitStack() as second:
        Emulator(path, first)
        path.unlink()
        successor = Emulator(path, second)
        first.close()
        host = successor.host()
        assert successor.was_opened()
        host.close()


def test_an_abandoned_socket_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "rig.sock"
    with socket.socket(socket.AF_UNIX) as stale:
        stale.bind(os.fspath(path))
    lock_path(path).touch(0o600)
    with pytest.raises(NoPortError, match=r"no emulator answers; start `armrigd emulate --port"):
        open_link(f"unix:{path}", 115_200)

    with ExitStack() as stack:
        emulator = Emulator(path, stack)
        host = emulator.host()
        assert emulator.was_opened()
        host.close()


def test_the_socket_of_a_running_emulator_is_not_replaced(emulator: Emulator, host: Link) -> None:
    with (
        ExitStack() as stack,
        pytest.raises(
            OperationError, match=r"rig\.sock: another emulator answers there; choose anoth"
        ),
    ):
        Emulator(emulator.path, stack)

    assert not emulator.was_opened()
    host.write(b"from the host")
    assert emulator.read() == b"from the host"


def test_a_folder_that_others_can_write_to_is_refused(emulator: Emulator) -> None:
    folder, complaint = emulator.path.parent, "its folder can be written by other users"
    folder.chmod(0o777)
    with ExitStack() as stack, pytest.raises(OperationError, match=complaint):
        Emulator(folder / "another", stack)
    with pytest.raises(LinkError, match=complaint):
        emulator.host()
    folder.chmod(0o700)
    (folder / "link").symlink_to(folder)

    with pytest.raises(LinkError, match="its folder is a symbolic link"):
        open_link(f"unix:{folder}/link/rig.sock", 115_200)


def test_other_files_are_not_replaced_by_the_socket(tmp_path: Path) -> None:
    path = tmp_path / "notes"
    path.write_text("mine")

    with pytest.raises(LinkError, match="it is no socket; give the socket of an emulator"):
        open_link(f"unix:{path}", 115_200)
    with pytest.raises(
        OperationError, match=r"notes: exists and is not a socket; choose another --port"
    ):
        emulate(Path(f"unix:{path}"), EmulatorSettings())

    assert path.read_text() == "mine"


def test_a_path_that_is_too_long_is_refused_by_either_end(tmp_path: Path) -> None:
    port = f"unix:{tmp_path}/{'a' * 107}"

    with pytest.raises(LinkError, match="1 to 107 B; choose a shorter folder"):
        open_link(port, 115_200)
    with pytest.raises(OperationError, match="1 to 107 B; choose a shorter folder"):
        emulate(Path(port), EmulatorSettings())


def test_a_socket_with_the_longest_path_can_be_created(tmp_path: Path) -> None:
    """The socket is made under another name, which is longer if its own is short."""
    folder = tmp_path / ("a" * (104 - len(os.fspath(tmp_path))))
    folder.mkdir(mode=0o700)
    path = folder / "s"
    assert len(os.fsencode(path)) == 107

    with ExitStack() as stack:
        emulator = Emulator(path, stack)
        host = emulator.host()
        assert emulator.was_opened()
        host.close()
