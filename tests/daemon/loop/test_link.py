"""The serial port, by a real pseudo-terminal."""

from __future__ import annotations

import errno
import os
import select
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial
from armrig_daemon.loop.link import READ, Link, LinkError, TakenPortError


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    """Give the device's end of a line, and the name of the other end."""
    master, slave = os.openpty()
    yield master, os.ttyname(slave)
    os.close(master)
    os.close(slave)


def _all_of(read: Callable[[], bytes], fd: int, size: int) -> bytes:
    """Return so many bytes; a terminal gives them in pieces."""
    data = b""
    while len(data) < size:
        assert select.select([fd], [], [], 1)[0], data
        piece = read()
        assert piece, data
        data += piece
    return data


def test_bytes_pass_unchanged_both_ways(terminal: tuple[int, str]) -> None:
    master, port = terminal
    link = Link(port, 115_200)
    data = bytes(range(256))

    link.write(data)
    assert _all_of(lambda: os.read(master, 1000), master, len(data)) == data
    os.write(master, data)
    assert _all_of(link.read, link.fd, len(data)) == data
    link.close()


def test_a_partial_write_is_a_loss_of_the_line(
    terminal: tuple[int, str],
) -> None:
    master, port = terminal
    link = Link(port, 115_200)
    data = bytes(100_000)

    with pytest.raises(LinkError, match="accepts no more bytes, because the device does not"):
        link.write(data)

    assert select.select([master], [], [], 1)[0], "nothing was sent: that would be no part"
    link.close()


def test_a_silent_line_is_not_lost_until_it_is_closed(terminal: tuple[int, str]) -> None:
    master, port = terminal
    link = Link(port, 115_200)

    assert link.read() == b""

    os.dup2(os.open(os.devnull, os.O_RDWR), master)  # the other end is closed
    with pytest.raises(LinkError, match="is gone"):
        link.read()
    link.close()


def test_one_read_returns_at_most_one_record_of_bytes(terminal: tuple[int, str]) -> None:
    master, port = terminal
    link = Link(port, 115_200)
    data = bytes(range(250)) * 10
    assert len(data) > READ
    os.write(master, data)

    pieces: list[bytes] = []
    while sum(map(len, pieces)) < len(data):
        assert link.has_rest or select.select([link.fd], [], [], 1)[0], pieces
        pieces.append(link.read())
        assert pieces[-1]

    assert b"".join(pieces) == data
    assert max(map(len, pieces)) <= READ
    link.close()


def test_port_is_opened_exclusively(terminal: tuple[int, str]) -> None:
    _, port = terminal
    link = Link(port, 115_200)

    with pytest.raises(
        LinkError, match="in use by another program, maybe another rig's daemon; end that"
    ):
        Link(port, 115_200)

    link.close()
    Link(port, 115_200).close()


@pytest.mark.parametrize("what", ["a file", "a folder", "/dev/null"])
def test_a_file_that_is_not_a_serial_port_is_refused(what: str, tmp_path: Path) -> None:
    port = what if what.startswith("/") else str(tmp_path / what)
    if what == "a file":
        Path(port).touch()
    elif what == "a folder":
        Path(port).mkdir()

    with pytest.raises(LinkError, match=r" cannot be opened: it is no serial port; give the rig"):
        Link(port, 9600)


@pytest.mark.parametrize(
    ("number", "kind", "words"),
    [
        (errno.EACCES, LinkError, "not permitted; add this user"),
        (errno.EPERM, LinkError, "not permitted; add this user"),
        (errno.EAGAIN, TakenPortError, "in use by another program"),
        (errno.EBUSY, TakenPortError, "in use by another program"),
        (errno.ENOTTY, LinkError, "it is no serial port"),
        (errno.EIO, LinkError, "busy with permission"),
    ],
)
def test_an_error_number_determines_why_a_port_cannot_be_opened(
    number: int, kind: type[LinkError], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not by what the library or the kernel says of it."""

    def fail(*_: object, **__: object) -> None:
        raise serial.SerialException(number, "busy with permission")

    monkeypatch.setattr(serial, "Serial", fail)

    with pytest.raises(LinkError, match=words) as caught:
        Link("/dev/null", 9600)

    assert type(caught.value) is kind
