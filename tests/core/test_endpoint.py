"""Trusted directories of sockets."""

from __future__ import annotations

import os
import re
import stat

import pytest
from armrig_core.endpoint import require_trusted
from armrig_core.errors import InputError

ME, ROOT, OTHER = 1000, 0, 1001


def _found(mode: int, uid: int = ME) -> os.stat_result:
    return os.stat_result((mode, 0, 0, 1, uid, 0, 0, 0, 0, 0))


@pytest.mark.parametrize("mode", [0o700, 0o750, 0o755])
def test_a_directory_that_only_its_user_writes_to_is_trusted(mode: int) -> None:
    require_trusted(_found(stat.S_IFDIR | mode), owners={ME})


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
def test_a_directory_that_others_can_put_a_socket_into_is_not(
    mode: int, uid: int, wrong: str
) -> None:
    with pytest.raises(InputError, match=f"^{re.escape(wrong)}"):
        require_trusted(_found(mode, uid), owners={ME})


def test_a_directory_may_have_one_of_several_owners() -> None:
    require_trusted(_found(stat.S_IFDIR | 0o755, ROOT), owners={ME, ROOT})
