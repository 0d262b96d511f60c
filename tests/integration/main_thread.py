"""The service's main thread makes no call that may wait: each such call ends the daemon.

`guard` is called in the process of a daemon before it starts. From `ready` until the loop has
ended, a call of the file system, of a terminal or of DNS, and an import, raises in this thread.
"""

from __future__ import annotations

import builtins
import functools
import os
import sys
import threading
from collections.abc import Callable
from typing import Any

from armrig_daemon.service.service import Service

_EVENTS = (
    "open", "import", "os.listdir", "os.scandir", "os.mkdir", "os.rename", "os.remove", "os.rmdir",
    "os.chmod", "os.chown", "os.link", "os.symlink", "os.truncate", "os.utime", "os.walk",
    "os.lockf", "fcntl.flock", "fcntl.lockf", "shutil.", "glob.", "tempfile.", "pathlib.",
    "socket.getaddrinfo", "socket.gethostby", "socket.getnameinfo", "subprocess.Popen", "os.fork",
    "os.posix_spawn", "os.system",
)  # fmt: skip
_CALLS = ("stat", "lstat", "statvfs", "access", "fstat", "fsync", "fdatasync", "readlink")


class WaitingCallError(BaseException):
    """The main thread made a call that may wait."""


def guard() -> None:
    """Watch the main thread of this process while its service serves."""
    serving = threading.Event()

    def check(what: str) -> None:
        if serving.is_set() and threading.current_thread() is threading.main_thread():
            serving.clear()  # the report itself imports and prints
            raise WaitingCallError(f"the service's main thread called {what}")

    def on_event(event: str, arguments: tuple[Any, ...]) -> None:
        if event.startswith(_EVENTS):
            check(f"{event} {arguments[:1]}")

    for name in _CALLS:
        setattr(os, name, _checked(getattr(os, name), check))
    builtins.print = _checked(print, check)
    sys.addaudithook(on_event)
    serve = Service._serve

    def watched(self: Service) -> None:
        serving.set()
        try:
            serve(self)
        finally:
            serving.clear()

    Service._serve = watched  # type: ignore[method-assign]


def _checked(call: Callable[..., Any], check: Callable[[str], None]) -> Callable[..., Any]:
    @functools.wraps(call)
    def watched(*given: Any, **options: Any) -> Any:
        check(f"{call.__name__} {given[:1]}")
        return call(*given, **options)

    return watched
