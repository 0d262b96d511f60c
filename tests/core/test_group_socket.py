"""The mask of a process while threads of it make sockets."""

from __future__ import annotations

import os
import threading

from armrig_core.access.owned_session import group_may_open


def _mask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_the_file_mask_is_restored_after_two_simultaneous_threads() -> None:
    before, entered, ended = _mask(), threading.Event(), threading.Event()

    def other() -> None:
        with group_may_open():
            entered.set()
            ended.wait(30)

    thread = threading.Thread(target=other)
    with group_may_open():
        inside = _mask()
        thread.start()
        entered.wait(0.1)  # in vain, unless both may be inside
    ended.set()
    thread.join()

    assert inside == 0o007
    assert _mask() == before
