"""Ports that are the socket of an emulated rig: their names, their folder, who answers there."""

from __future__ import annotations

import os
import socket
import struct
from pathlib import Path
from typing import cast

import pytest
from armrig_core.emulator_socket import folder_fault, peer_fault, socket_path

LONGEST = "/" + "a" * 106


def test_a_port_names_a_socket_by_its_prefix() -> None:
    """All other names are those of serial ports."""
    assert socket_path("/dev/ttyACM0") is None
    assert socket_path("unix") is None
    assert socket_path("unix:/run/rig.sock") == Path("/run/rig.sock")
    assert socket_path(f"unix:{LONGEST}") == Path(LONGEST)


@pytest.mark.parametrize(
    ("path", "complaint"),
    [
        (f"{LONGEST}b", r"a path of 108 B, a socket's has 1 to 107; choose a shorter folder"),
        ("/" + "ä" * 54, r"a path of 109 B"),
        ("", r"unix:: a path of 0 B, .*; name a socket in a folder of yours"),
    ],
)
def test_a_path_that_no_socket_can_have_is_refused(path: str, complaint: str) -> None:
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
    """They could put a socket of their own in place of the emulator's."""
    tmp_path.chmod(mode)

    said = folder_fault(tmp_path / "rig.sock")

    assert said == (f"its folder {fault}; choose a folder of yours" if fault else "")


class _Connection:
    """A connection to a program of another user."""

    def __init__(self, uid: int) -> None:
        self.uid = uid

    def getsockopt(self, level: int, name: int, size: int) -> bytes:
        assert (level, name, size) == (socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
        return struct.pack("3i", os.getpid(), self.uid, os.getgid())


@pytest.mark.parametrize(
    ("uid", "fault"),
    [
        (1000, ""),
        (0, ""),
        (
            4711,
            "a program of another user (uid 4711) answers; start the emulator as this user",
        ),
    ],
)
def test_only_this_user_and_root_are_trusted_at_the_other_end(
    monkeypatch: pytest.MonkeyPatch, uid: int, fault: str
) -> None:
    """As the kernel says, not as the program does."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        assert peer_fault(ours) == ""
    monkeypatch.setattr(os, "geteuid", lambda: 1000)

    assert peer_fault(cast(socket.socket, _Connection(uid))) == fault
