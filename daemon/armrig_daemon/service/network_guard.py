"""The network is shut before its strangers take the files that everybody else needs.

A connection is an open file as soon as it is made, long before anybody has shown a certificate; a
process that may open no more serves nobody on its Unix socket, and begins no recording.
"""

from __future__ import annotations

from collections.abc import Callable

MANY = 512
"""Open files at which the network is opened anew while nobody has the rig: links cost no run."""
TOO_MANY = 12_288
"""And at which it is, whoever has the rig: of the 16384 that there may be at most."""
SHUT_S = 10.0


class NetworkGuard:
    """Looks once a second."""

    def __init__(
        self, count: Callable[[], int], shut: Callable[[], None], open_anew: Callable[[], str]
    ) -> None:
        """Begin with an open network.

        Parameters
        ----------
        count : callable
            Returns how many files are open.
        shut : callable
            Ends all links of the network, and listens no more.
        open_anew : callable
            Listens again; returns why that cannot be, or nothing.
        """
        self._count, self._shut, self._open_anew = count, shut, open_anew
        self._again_s = 0.0
        self._is_shut = False

    def look(self, now_s: float, *, is_busy: bool) -> tuple[str, str] | None:
        """Shut the network or open it, if it is time; return a level and a line where it did.

        Parameters
        ----------
        now_s : float
            The monotonic time, in s.
        is_busy : bool
            Whether somebody has the rig.
        """
        if self._is_shut:
            return self._open(now_s) if now_s >= self._again_s else None
        found = self._count()
        if found <= (TOO_MANY if is_busy else MANY):
            return None
        self._shut()
        self._is_shut, self._again_s = True, now_s + SHUT_S
        return "error", (
            f"[access] {found} files are open: somebody holds connections that he does not use; "
            f"the network is shut for {SHUT_S:g} s, the Unix socket goes on; "
            "see with `ss -tn` who it is"
        )

    def _open(self, now_s: float) -> tuple[str, str]:
        why = self._open_anew()
        if why:
            self._again_s = now_s + SHUT_S
            return "error", why
        self._is_shut = False
        return "info", "[access] the network is open again"
