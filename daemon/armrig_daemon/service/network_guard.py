"""Guard of the network: shuts the network before strangers exhaust the limit on open files.

Each connection is an open file from its beginning, long before its client shows a certificate. A
process at its limit of open files accepts no client on its Unix socket and begins no recording.
"""

from __future__ import annotations

from collections.abc import Callable

MAX_IDLE_FILES = 512
"""Number of open files above which the network is shut while no client holds the rig."""
MAX_FILES = 12_288
"""Number of open files above which the network is always shut; a process may have 16384."""
SHUT_S = 10.0


class NetworkGuard:
    """Guard that shuts the network while too many files are open; call `look` once a second."""

    def __init__(
        self, count: Callable[[], int], shut: Callable[[], None], open_again: Callable[[], str]
    ) -> None:
        """Start with an open network.

        `count` returns the number of open files. `shut` ends all links of the network, and stops
        listening. `open_again` listens again, and returns the reason of a failure, or an empty
        text.
        """
        self._count, self._shut, self._open_again = count, shut, open_again
        self._again_s = 0.0
        self._is_shut = False

    def look(self, now_s: float, *, is_busy: bool) -> tuple[str, str] | None:
        """Shut or open the network if necessary; after a change, return a log line and its level.

        `now_s` is the monotonic time, in s. `is_busy` is True if a client holds the rig.
        """
        if self._is_shut:
            return self._open(now_s) if now_s >= self._again_s else None
        found = self._count()
        if found <= (MAX_FILES if is_busy else MAX_IDLE_FILES):
            return None
        self._shut()
        self._is_shut, self._again_s = True, now_s + SHUT_S
        return "error", (
            f"[access] {found} files are open: a client holds unused connections; the network is "
            f"shut for {SHUT_S:g} s, the Unix socket stays open; `ss -tn` shows the client"
        )

    def _open(self, now_s: float) -> tuple[str, str]:
        why = self._open_again()
        if why:
            self._again_s = now_s + SHUT_S
            return "error", why
        self._is_shut = False
        return "info", "[access] the network is open again"
