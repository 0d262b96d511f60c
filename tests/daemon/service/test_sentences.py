"""Lines of the service's log."""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from armrig_core.process.journal import log_prefix
from armrig_daemon.service import sentences
from armrig_daemon.service.host.systemd import journal_entry, send_to_journal
from armrig_daemon.service.sentences import (
    print_line,
)


def test_a_log_message_with_control_characters_is_one_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    print_line("info", "held by a\x1b[2J\nkernel: all is well\x9b")

    assert capsys.readouterr().err == (
        "armrigd: info: held by a\\x1b[2J\\nkernel: all is well\\x9b\n"
    )


@pytest.mark.parametrize(
    ("level", "prefix"), [("error", "<3>"), ("warning", "<4>"), ("info", "<6>"), ("new", "<5>")]
)
def test_a_line_for_the_journal_begins_with_its_priority(
    level: str, prefix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    stderr = os.fstat(2)
    monkeypatch.setenv("JOURNAL_STREAM", f"{stderr.st_dev}:{stderr.st_ino}")
    assert log_prefix(level) == prefix

    monkeypatch.setenv("JOURNAL_STREAM", f"{stderr.st_dev}:{stderr.st_ino + 1}")
    assert log_prefix(level) is None


def _fields(entry: bytes) -> dict[str, str]:
    """Return the fields of an entry, as the journal reads them."""
    found = {}
    while entry:
        name, _, rest = entry.partition(b"\n")
        (length,) = struct.unpack_from("<Q", rest)
        found[name.decode()] = rest[8 : 8 + length].decode()
        assert rest[8 + length : 9 + length] == b"\n"
        entry = rest[9 + length :]
    return found


def _connect_stderr_to_journal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Say that the journal reads standard error; not in a fixture, after which pytest replaces it.

    The file that replaces it often has the number of the one before, and not always.
    """
    stderr = os.fstat(2)
    monkeypatch.setenv("JOURNAL_STREAM", f"{stderr.st_dev}:{stderr.st_ino}")


@pytest.fixture
def journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[socket.socket, Path]]:
    """Give a socket in the journal's place."""
    path = tmp_path / "socket"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(path))
        listening.settimeout(5)
        monkeypatch.setattr(
            sentences, "send_to_journal", lambda entry: send_to_journal(entry, str(path))
        )
        yield listening, path


def test_a_journal_entry_contains_the_subject_of_its_line(
    capfd: pytest.CaptureFixture[str],
    journal: tuple[socket.socket, Path],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _connect_stderr_to_journal(monkeypatch)
    about = {"rig": "1", "run": "", "owner": "group 3", "command": "stop"}

    print_line("info", "stop: by group 3", about)

    assert _fields(journal[0].recv(1 << 16)) == {
        "PRIORITY": "6",
        "SYSLOG_IDENTIFIER": "armrigd",
        "MESSAGE": "stop: by group 3",
        "ARMRIG_RIG": "1",
        "ARMRIG_OWNER": "group 3",
        "ARMRIG_COMMAND": "stop",
    }
    assert capfd.readouterr().err == ""


def test_a_client_cannot_forge_a_field_of_the_journal(
    journal: tuple[socket.socket, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    _connect_stderr_to_journal(monkeypatch)
    print_line("info", "arm", {"owner": "me\nARMRIG_OWNER=alice\nPRIORITY\n\x1b[2J"})

    fields = _fields(journal[0].recv(1 << 16))
    assert fields["ARMRIG_OWNER"] == "me\\nARMRIG_OWNER=alice\\nPRIORITY\\n\\x1b[2J"
    assert fields["PRIORITY"] == "6"


def test_a_journal_entry_keeps_line_breaks_of_a_message() -> None:
    assert _fields(journal_entry("error", "a\nMESSAGE=b\n", {}))["MESSAGE"] == "a\nMESSAGE=b\n"


def test_a_full_or_missing_journal_does_not_block_the_service(
    capfd: pytest.CaptureFixture[str],
    journal: tuple[socket.socket, Path],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _connect_stderr_to_journal(monkeypatch)
    filled = 0
    while send_to_journal(journal_entry("info", "more", {}), str(journal[1])):
        filled += 1
        assert filled < 100_000
    print_line("warning", "full", {"rig": "1"})
    journal[1].unlink()
    print_line("warning", "gone", {"rig": "1"})

    assert filled > 0
    assert capfd.readouterr().err == "<4>full\n<4>gone\n"
