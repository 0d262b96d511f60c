"""Preparation of a program before its imports; this module is imported first, with few imports.

At Ctrl-C during its imports, the program prints a line and ends at once. Otherwise, a
KeyboardInterrupt passes through third-party modules, which may turn it into another error.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable


def end_at_ctrl_c(program: str) -> Callable[[], object]:
    """End this process at Ctrl-C from now on; return a function that restores the previous handler.

    The process has nothing to clean up yet. If Ctrl-C is ignored, it stays ignored.
    """

    def end(*_: object) -> None:
        os.write(2, f"{program}: interrupted\n".encode())
        os._exit(130)

    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, end)
    return lambda: signal.signal(signal.SIGINT, before)


def is_interrupt(err: BaseException) -> bool:
    """Return whether an error, or the cause of the error (in Python 3.11), is a Ctrl-C."""
    return isinstance(err, KeyboardInterrupt) or isinstance(err.__cause__, KeyboardInterrupt)


def use_one_thread() -> None:
    """Limit linear algebra to one thread, unless the environment has another limit.

    Must be called before numpy is imported. The threads of OpenBLAS wait by spinning and cost more
    time than they save: the matrices are small, and the machine also runs daemon and emulator.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
