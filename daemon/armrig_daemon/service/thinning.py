"""Thinning of the log: a repeated line is logged once a second, with the number of repetitions."""

from __future__ import annotations

import re
from typing import NamedTuple

from msgspec.structs import replace

from armrig_daemon.pipe import Log

HOLD_NS = 1_000_000_000
"""Time for which repeated lines are held back, in ns; repeated lines differ only in numbers."""
MAX_KINDS = 100
"""Largest number of kinds of lines to remember; a line of a further kind is always logged."""
_NUMBER = re.compile(r"\d+(?:\.\d+)?")


class _Repeated(NamedTuple):
    ns: int
    """Time of the last logged line of this kind."""
    held: int = 0
    """Number of lines that were held back since the last logged line."""
    newest: Log | None = None
    """Last line that was held back."""


class Thinning:
    """Filter of a log; it holds back repeated lines, but never an error."""

    def __init__(self) -> None:
        """Create a filter that has seen no line."""
        self._kinds: dict[str, _Repeated] = {}

    def lets_through(self, log: Log) -> bool:
        """Return whether a line must be logged now; if not, count the line."""
        # Two lines about commands are different even if only a number differs: "group 3" and
        # "group 4" are two owners.
        kind = log.message if "command" in log.fields else _NUMBER.sub("#", log.message)
        before = self._kinds.get(kind)
        if log.level == "error" or (before is None and len(self._kinds) >= MAX_KINDS):
            return True
        if before is None:
            self._kinds[kind] = _Repeated(log.t_host_ns)
            return True
        self._kinds[kind] = before._replace(held=before.held + 1, newest=log)
        return False

    def due(self, now_ns: int, *, end: bool = False) -> list[Log]:
        """Return the newest line of each kind held back for 1 s; for any time if `end` is True."""
        lines: list[Log] = []
        for kind, (ns, held, newest) in list(self._kinds.items()):
            if now_ns - ns < HOLD_NS and not end:
                continue
            if newest is None:
                del self._kinds[kind]
                continue
            more = f" ({held} similar lines since the last)" if held > 1 else ""
            lines.append(replace(newest, message=newest.message + more))
            self._kinds[kind] = _Repeated(newest.t_host_ns)
        return lines
