"""A line of the log that comes again and again, once a second and counted."""

from __future__ import annotations

import re
from typing import NamedTuple

from msgspec.structs import replace

from armrig_daemon.pipe import Log

AGAIN_NS = 1_000_000_000
"""How long lines that differ in their numbers only are held back, in ns."""
MOST_KINDS = 100
"""Kinds of lines that are told apart; beyond, all are said."""
_NUMBER = re.compile(r"\d+(?:\.\d+)?")


class _Repeated(NamedTuple):
    """A kind of line."""

    ns: int
    """When one was said last."""
    held: int = 0
    """How many were held back since."""
    newest: Log | None = None
    """The last of them."""


class Thinning:
    """Lines of a log, of which those that repeat each other are held back; an error never is."""

    def __init__(self) -> None:
        """Begin with nothing said."""
        self._kinds: dict[str, _Repeated] = {}

    def lets_through(self, log: Log) -> bool:
        """Return whether a line is to be said now; else it is counted."""
        # Who commanded what is told of each by himself: "group 3" is not "group 4".
        kind = log.message if "command" in log.fields else _NUMBER.sub("#", log.message)
        before = self._kinds.get(kind)
        if log.level == "error" or (before is None and len(self._kinds) >= MOST_KINDS):
            return True
        if before is None:
            self._kinds[kind] = _Repeated(log.t_host_ns)
            return True
        self._kinds[kind] = before._replace(held=before.held + 1, newest=log)
        return False

    def due(self, now_ns: int, *, end: bool = False) -> list[Log]:
        """Return a line for each kind that was held back a second ago, or at all at the end."""
        lines: list[Log] = []
        for kind, (ns, held, newest) in list(self._kinds.items()):
            if now_ns - ns < AGAIN_NS and not end:
                continue
            if newest is None:
                del self._kinds[kind]
                continue
            more = f" ({held} like it since the last)" if held > 1 else ""
            lines.append(replace(newest, message=newest.message + more))
            self._kinds[kind] = _Repeated(newest.t_host_ns)
        return lines
