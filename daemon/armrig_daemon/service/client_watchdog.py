"""Dead-man switch of a run: if the run's client gives no sign of life, the run is stopped.

Each sign of life is a separate command, sent by the code that waits for the run. A process that is
killed, frozen or cut off sends no sign. A process whose main code hangs also sends no sign, even if
its other threads continue.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import CommandRefusedError, Renew, RunOptions, build_refusal

from armrig_daemon.decisions import orders


class ClientWatchdog(NamedTuple):
    """Client of a run, and the time of its last sign of life."""

    lease: str
    n: int
    """Number of the client's newest command."""
    period_s: float
    """Longest silence, in s; infinite if the run has no dead-man switch."""
    heard_s: float
    """Time of the newest sign of life, on the monotonic clock."""

    @property
    def gone_s(self) -> float:
        """Monotonic time, in s, after which the client is regarded as gone."""
        return self.heard_s + self.period_s


def begin_watch(run: RunOptions, now_s: float) -> ClientWatchdog:
    """Return the watchdog at the start of a run; the start is the first sign of life."""
    return ClientWatchdog(run.lease, run.n, run.dead_man or inf, now_s)


def not_newer(n: int, last: int) -> CommandRefusedError:
    """Return the refusal of a command whose number does not exceed the last number."""
    text = orders.not_newer(n, last)
    return CommandRefusedError(build_refusal(RefusalCode.NOT_NEWER, text, n=n, last=last))


def renew_watch(presence: ClientWatchdog | None, sign: Renew, now_s: float) -> ClientWatchdog:
    """Return the watchdog after a sign of life.

    Raises CommandRefusedError if there is no run, the run belongs to another client, or the sign of
    life is old.
    """
    if presence is None or sign.lease != presence.lease:
        text = "no run of this lease is planned or running"
        raise CommandRefusedError(build_refusal(RefusalCode.NOT_HELD, text))
    if sign.n <= presence.n:
        raise not_newer(sign.n, presence.n)
    return presence._replace(n=sign.n, heard_s=now_s)
