"""Ports that are the socket of an emulated rig: their names, their folder, who answers there."""

from __future__ import annotations

import os
import re
import socket
import stat
import struct
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from armrig_core.access.emulator_socket import require_safe_folder, socket_path, stranger
from armrig_core.errors import InputError

LONGEST = "/" + "a" * 106


def test_a_port_with_the_prefix_unix_is_a_socket() -> None:
    assert socket_path("/dev/ttyACM0") is None
    assert socket_path("unix") is None
    assert socket_path("unix:/run/rig.sock") == Path("/run/rig.sock")
    assert socket_path(f"unix:{LONGEST}") == Path(LONGEST)


@pytest.mark.parametrize(
    ("path", "complaint"),
    [
        (
            f"{LONGEST}b",
            r"the path has 108 B; a socket's path has 1 to 107 B; choose a shorter folder",
        ),
        ("/" + "ä" * 54, r"the path has 109 B"),
        ("", r"unix:: the path has 0 B; .*; name a socket in your own folder"),
    ],
)
def test_an_impossible_socket_path_is_refused(path: str, complaint: str) -> None:
    """The kernel counts bytes, not characters."""
    with pytest.raises(ValueError, match=complaint):
        socket_path(f"unix:{path}")


@pytest.mark.parametrize(
    ("mode", "fault"),
    [(0o700, ""), (0o755, ""), (0o770, "can be written by other users (mode 770, not 700)")],
)
def test_a_folder_that_others_can_write_to_is_a_fault(
    tmp_path: Path, mode: int, fault: str
) -> None:
    tmp_path.chmod(mode)

    said = f"^its folder {re.escape(fault)}; choose your own folder$"
    with pytest.raises(InputError, match=said) if fault else nullcontext():
        require_safe_folder(tmp_path / "rig.sock")


@pytest.fixture
def _user_1000(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)


@pytest.mark.usefixtures("_user_1000")
@pytest.mark.parametrize(("uid", "is_trusted"), [(1000, True), (0, True), (1001, False)])
def test_a_folder_is_this_user_s_or_root_s(uid: int, is_trusted: bool) -> None:
    found = os.stat_result((stat.S_IFDIR | 0o755, 0, 0, 1, uid, 0, 0, 0, 0, 0))
    path = SimpleNamespace(parent=SimpleNamespace(lstat=lambda: found))

    said = r"^its folder belongs to another user \(uid 1001\); choose your own folder$"
    with nullcontext() if is_trusted else pytest.raises(InputError, match=said):
        require_safe_folder(cast(Path, path))


class _Connection:
    """A connection to a program of another user."""

    def __init__(self, uid: int) -> None:
        self.uid = uid

    def getsockopt(self, level: int, name: int, size: int) -> bytes:
        assert (level, name, size) == (socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
        return struct.pack("3i", os.getpid(), self.uid, os.getgid())


def test_the_other_end_of_this_process_is_trusted() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        assert stranger(ours) is None


@pytest.mark.usefixtures("_user_1000")
@pytest.mark.parametrize(("uid", "foreign"), [(1000, None), (0, None), (4711, 4711)])
def test_only_this_user_and_root_are_trusted_at_the_other_end(
    uid: int, foreign: int | None
) -> None:
    assert stranger(cast(socket.socket, _Connection(uid))) == foreign
