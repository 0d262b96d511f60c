"""What the service says to whoever reads its log."""

from __future__ import annotations

import os

import msgspec
import pytest
from armrig_daemon.pipe import State
from armrig_daemon.service.sentences import print_line, state_sentence
from armrig_daemon.service.systemd import journal_prefix


def test_a_line_of_the_log_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """What a client, a device or a file has put into it does nothing to a terminal."""
    print_line("info", "held by a\x1b[2J\nkernel: all is well\x9b")

    assert capsys.readouterr().err == (
        "armrigd: info: held by a\\x1b[2J\\nkernel: all is well\\x9b\n"
    )


@pytest.mark.parametrize(
    ("level", "prefix"), [("error", "<3>"), ("warning", "<4>"), ("info", "<6>"), ("new", "<5>")]
)
def test_a_line_for_the_journal_begins_with_its_priority(level: str, prefix: str) -> None:
    """So that `journalctl -p warning` finds it."""
    stderr = os.fstat(2)

    assert journal_prefix(level, stderr, f"{stderr.st_dev}:{stderr.st_ino}") == prefix


def test_a_line_that_the_journal_does_not_read_has_no_priority() -> None:
    """Standard error was sent elsewhere, into a file: the variable still stands."""
    stderr = os.fstat(2)

    assert journal_prefix("error", stderr, f"{stderr.st_dev}:{stderr.st_ino + 1}") is None


def test_to_the_journal_a_line_does_not_say_who_says_it(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The journal knows the unit."""
    stderr = os.fstat(2)
    monkeypatch.setenv("JOURNAL_STREAM", f"{stderr.st_dev}:{stderr.st_ino}")

    print_line("warning", "no link")

    assert capfd.readouterr().err == "<4>no link\n"


@pytest.mark.parametrize(
    ("phase", "reason", "owner", "line", "sentence"),
    [
        ("safe", "", "", "", "safe, nobody has it"),
        ("active", "", "group 3", "", "active, group 3 has it"),
        ("init", "", "", "/dev/a: no rig", "not ready: /dev/a: no rig"),
        ("fault", "no\nlink", "", "", "fault: no\\nlink; mend, then `armrig reset`"),
    ],
)
def test_a_state_is_one_line_for_systemctl(
    phase: str, reason: str, owner: str, line: str, sentence: str
) -> None:
    """A line break in a reason would be read as another field."""
    told = State(t_host_ns=0, phase=phase, reason=reason, owner=owner, ts_us=0, device={})

    assert state_sentence(msgspec.structs.replace(told, remedy="mend"), line) == sentence
