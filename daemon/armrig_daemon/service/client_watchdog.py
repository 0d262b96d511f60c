"""The client of a run shows that it is there, or its run is stopped.

Each sign is a command of its own, made by what waits for the run: a process that is killed, frozen
or cut off gives none, and neither does one that hangs while its threads live on.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from armrig_core.codes import RefusalCode
from armrig_core.commands import CommandRefusedError, Renew, Run, refused

from armrig_daemon.decisions import orders


class ClientWatchdog(NamedTuple):
    """Whose run it is, and when it was last heard of."""

    lease: str
    n: int
    """Number of its newest command."""
    period_s: float
    """Longest silence, in s; infinite where the run asked for no dead-man."""
    heard_s: float
    """When the newest sign came, on the monotonic clock."""

    @property
    def gone_s(self) -> float:
        """When it counts as gone, on the same clock."""
        return self.heard_s + self.period_s


def begun(run: Run, now_s: float) -> ClientWatchdog:
    """Return the presence at the start of a run, which counts as a sign."""
    return ClientWatchdog(run.lease, run.n, run.dead_man or inf, now_s)


def not_newer(n: int, last: int) -> CommandRefusedError:
    """Return the refusal of a command whose number does not exceed the last."""
    text = orders.not_newer(n, last)
    return CommandRefusedError(refused(RefusalCode.NOT_NEWER, text, n=n, last=last))


def renewed(presence: ClientWatchdog | None, sign: Renew, now_s: float) -> ClientWatchdog:
    """Return the presence after a sign.

    Raises
    ------
    CommandRefusedError
        There is no run in hand, it is somebody else's, or the sign is an old one.
    """
    if presence is None or sign.lease != presence.lease:
        text = "no run of this lease is in hand"
        raise CommandRefusedError(refused(RefusalCode.NOT_HELD, text))
    if sign.n <= presence.n:
        raise not_newer(sign.n, presence.n)
    return presence._replace(n=sign.n, heard_s=now_s)
