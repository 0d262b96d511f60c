"""Endpoints, and trusted directories of sockets."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path, PurePosixPath

import pytest
from armrig_core.access.endpoint import (
    check_listen,
    endpoint,
    network_address,
    require_trusted,
    resolve_paths,
    socket_directory,
)
from armrig_core.errors import InputError

ME, ROOT, OTHER = 1000, 0, 1001


def _found(mode: int, uid: int = ME) -> os.stat_result:
    return os.stat_result((mode, 0, 0, 1, uid, 0, 0, 0, 0, 0))


@pytest.mark.parametrize(
    ("mode", "uid", "wrong"),
    [
        (stat.S_IFDIR | 0o700, OTHER, "belongs to another user (uid 1001)"),
        (stat.S_IFDIR | 0o700, ROOT, "belongs to another user (uid 0)"),
        (stat.S_IFDIR | 0o770, ME, "can be written by other users (mode 770, not 700)"),
        (stat.S_IFDIR | 0o702, ME, "can be written by other users (mode 702, not 700)"),
        (stat.S_IFDIR | 0o1777, ME, "can be written by other users (mode 1777, not 700)"),
        (stat.S_IFLNK | 0o777, ME, "is a symbolic link, which may lead to another user's"),
        (stat.S_IFREG | 0o600, ME, "is not a directory"),
    ],
)
def test_a_directory_that_others_can_write_to_is_refused(mode: int, uid: int, wrong: str) -> None:
    with pytest.raises(InputError, match=f"^{re.escape(wrong)}"):
        require_trusted(_found(mode, uid), owners={ME})


@pytest.mark.parametrize(
    ("environ", "directory"),
    [
        ({"RUNTIME_DIRECTORY": "/run/armrig/2:/run/b", "XDG_RUNTIME_DIR": "/x"}, "/run/armrig/2"),
        ({"XDG_RUNTIME_DIR": "/run/user/7"}, "/run/user/7/armrig"),
        ({"RUNTIME_DIRECTORY": "", "XDG_RUNTIME_DIR": ""}, "/tmp/armrig-7"),
        ({}, "/tmp/armrig-7"),
    ],
)
def test_a_service_a_login_and_a_script_have_separate_sockets(
    environ: dict[str, str], directory: str
) -> None:
    found = socket_directory(environ, uid=7, temporary="/tmp")

    assert found == PurePosixPath(directory)


@pytest.mark.parametrize(
    ("rig", "folder", "length"),
    [("1", "/" + "a" * 99, 107), ("12", "/" + "a" * 99, 108), ("1", "/" + "ä" * 50, 108)],
)
def test_the_length_of_an_endpoint_is_limited_to_that_of_a_socket_path(
    rig: str, folder: str, length: int
) -> None:
    """The kernel counts bytes, and takes 107."""
    if length <= 107:
        assert endpoint(rig, PurePosixPath(folder)) == f"unixsock-stream/{folder}/{rig}.sock"
        return
    with pytest.raises(InputError, match=f"the path has {length} B; .* at most 107 B; set XDG_"):
        endpoint(rig, PurePosixPath(folder))


@pytest.mark.parametrize(
    ("where", "address"),
    [
        ("tls/lab.example.edu:7447", ("lab.example.edu", 7447)),
        ("tcp/127.0.0.1:1", ("127.0.0.1", 1)),
        ("tls/[2001:db8::1]:65535", ("2001:db8::1", 65_535)),
        ("unixsock-stream//run/armrig/1.sock", None),
        ("tls/lab", None),
        ("tls/lab:0", None),
    ],
)
def test_the_address_of_a_network_endpoint_is_read(
    where: str, address: tuple[str, int] | None
) -> None:
    assert network_address(where) == address
    if address is not None and where.startswith("tls/"):
        check_listen(where)


def test_paths_of_credentials_are_relative_to_the_folder_of_their_file(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("HOME", "/home/ada")
    tables = {
        "access": {"listen": "a", "certificate": "rig.pem", "names": ""},
        "client": {"connect": "b", "certificate": "~/ada.pem"},
        "recording": {"directory": "runs"},
    }

    assert resolve_paths(tables, Path("/etc/armrig")) == {
        "access": {
            "listen": "a",
            "certificate": "/etc/armrig/rig.pem",
            "names": "",
        },
        "client": {
            "connect": "b",
            "certificate": "/home/ada/ada.pem",
        },
        "recording": {"directory": "runs"},
    }
