"""Ctrl-C while a program loads: it ends at once, by a line.

A KeyboardInterrupt there passes through other people's modules, which may make another error of it.
This module is loaded first, and itself imports next to nothing.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable


def end_at_ctrl_c(program: str) -> Callable[[], object]:
    """End this process at Ctrl-C from here on; return what gives the handler before back.

    The process owns nothing yet: nothing is cleaned up. An ignored Ctrl-C stays ignored.
    """

    def end(*_: object) -> None:
        os.write(2, f"{program}: interrupted\n".encode())
        os._exit(130)

    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, end)
    return lambda: signal.signal(signal.SIGINT, before)


def is_interrupt(err: BaseException) -> bool:
    """Return whether Ctrl-C is the cause: Python 3.11 makes a RuntimeError of it in a class."""
    return isinstance(err, KeyboardInterrupt) or isinstance(err.__cause__, KeyboardInterrupt)
