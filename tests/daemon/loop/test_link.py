"""The serial port, by a real pseudo-terminal."""

from __future__ import annotations

import errno
import os
import select
from collections.abc import Callable
from pathlib import Path

import pytest
import serial
from armrig_daemon.loop.link import Link, LinkError, TakenPortError


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
