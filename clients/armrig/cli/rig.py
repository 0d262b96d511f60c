"""The commands about a rig: status, watch, stop, reset, note."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Annotated, Any

from armrig.cli.options import Connect, Json, RigId, argument, chosen
from armrig.cli.printing import echo, print_json, print_table, say

if TYPE_CHECKING:
    from armrig.rig.client import Rig
    from armrig.rig.session import NoReplyError

_DRIVEN = frozenset({"armed", "active"})
"""Phases in which an input may drive the motor."""
_STOP_REPORT_S = 1.0
"""Longest wait, in s, for the status that follows a stop."""
_STATUS_INTERVAL_S = 0.02


def status(rig: RigId = "1", connect: Connect = None, json: Json = False) -> None:
    """Show the state of the daemon and the rig."""
    from armrig.rig.status import status_rows

    with _opened(rig, connect) as opened:
        report = opened.status()
    if json:
        print_json(report)
        return
    print_table(*status_rows(report))
    if report.phase == "safe" and not report.line:
        _say_next("status chassis" if report.arm_removed else "status", rig, connect)


def watch(
    rig: RigId = "1",
    connect: Connect = None,
    count: int | None = chosen(
        None,
        "--count",
        "Number of samples and gaps after which the command ends.",
        "until Ctrl-C",
        min=1,
    ),
    json: Json = False,
) -> None:
    """Show the live samples and the gaps until Ctrl-C.

    With --json each line has the fields of a sample, or of a gap: k_first, count, reason and more.
    """
    from itertools import islice

    from armrig.rig.telemetry_stream import LiveGap

    with _opened(rig, connect) as opened:
        samples = islice(opened.stream("sample"), count)
        with suppress(KeyboardInterrupt):  # Ctrl-C is the normal end
            if json:
                for sample in samples:
                    print_json(sample if isinstance(sample, LiveGap) else sample._asdict())
            elif sys.stdout.isatty():
                _watch(samples)
            else:
                _watch_in_lines(samples)


def stop(
    rig: RigId = "1",
    connect: Connect = None,
    by: str = chosen(
        "", "--owner", "Name of the person who stops the rig, for the recording.", "this user"
    ),
    json: Json = False,
) -> None:
    """Stop the rig at 0 V, even if another person is the owner.

    The command prints the state of the motor after the stop, as the device reports it.

    With --json the command prints {"rig": "1", "stopped": true}. If the daemon of this machine is
    dead, the command runs `armrigd estop` instead, which stops the device itself. If nobody answers
    or the device does not confirm the stop, the exit code is 1.
    """
    from armrig.rig.session import NoReplyError

    try:
        with _opened(rig, connect) as opened:
            opened.stop(by)
            motor = "" if json else _motor_after_stop(opened)
    except NoReplyError as err:
        motor = _stop_without_daemon(rig, err)
    if json:
        print_json({"rig": rig, "stopped": True})
    else:
        say(f"rig {rig}, motor: {motor}", bold=True)


def _motor_after_stop(rig: Rig) -> str:
    """Return the state of the motor, once a status reports that the input has ended."""
    from armrig.rig.session import RigError

    status, end_s = None, time.monotonic() + _STOP_REPORT_S
    with suppress(RigError):  # the stop is confirmed: a missing status is no failed stop
        status = rig.status()
        while status.phase in _DRIVEN and time.monotonic() < end_s:
            time.sleep(_STATUS_INTERVAL_S)
            status = rig.status()
    return (status and status.motor) or "stop sent"


def _stop_without_daemon(rig: str, err: NoReplyError) -> str:
    """Stop the device of a dead daemon, and return the state of the motor; raise if that fails."""
    from armrig_core.access.daemon_lock import daemon_at

    from armrig.rig.session import NoReplyError

    facts = daemon_at(err.endpoint)
    if facts is None:
        way_out = "whether the motor turns is unknown here; if it does, use the emergency switch"
        raise NoReplyError(f"{err}; {way_out}") from err
    if facts.is_alive:
        raise err
    dead = f"its daemon (process {facts.pid}) is dead"
    device = ("--port", facts.port, "--baud", str(facts.baud))
    done = subprocess.run(
        [sys.executable, "-m", "armrig_daemon", "estop", "--rig", rig, *device],
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise NoReplyError(f"rig {rig}: {dead}; {done.stderr.strip()}") from err
    return f"at 0 V by `armrigd estop`; {dead}; start it again, then `armrig reset`"


def reset(rig: RigId = "1", connect: Connect = None, json: Json = False) -> None:
    """Clear a latched fault. The rig is then at 0 V and has no owner.

    The fault remains if its cause remains; `armrig status` shows fault and cause.

    With --json the command prints {"rig": "1", "was_latched": true}, or false if no fault was
    latched.
    """
    with _opened(rig, connect) as opened:
        was_latched = opened.reset()
    if json:
        print_json({"rig": rig, "was_latched": was_latched})
        return
    echo(f"rig {rig} was reset" if was_latched else f"rig {rig}: no fault is latched")
    _say_next("reset", rig, connect)


def note(
    text: Annotated[str, argument("TEXT", "Text of the note, 1 to 500 characters.", False)],
    rig: RigId = "1",
    connect: Connect = None,
    owner: str = chosen("", "--owner", "Author of the note.", "this user"),
    json: Json = False,
) -> None:
    """Write a note into the current recording.

    `armrig info`, the report and the dashboard show the note.

    With --json the command prints {"rig": "1", "recorded": true}, or false if no run is being
    recorded.
    """
    with _opened(rig, connect) as opened:
        is_recorded = opened.note(text, owner)
    if json:
        print_json({"rig": rig, "recorded": is_recorded})
        return
    missing = "no run is being recorded, so the note is not in a recording"
    echo(f"rig {rig}: {'the note is in the recording' if is_recorded else missing}")


def _say_next(after: str, rig: str, connect: str | None) -> None:
    from armrig.cli.next_step import naming, say_next

    say_next(after, rig=naming(rig, connect))


@contextmanager
def _opened(rig: str, connect: str | None) -> Iterator[Any]:
    """Yield the rig; if the daemon refuses a request, the error names the command to type next."""
    from armrig.rig.client import Rig
    from armrig.rig.replies import RefusedError, refusal_sentence, reset_command

    with Rig(rig, connect=connect) as opened:
        try:
            yield opened
        except RefusedError as err:
            raise RefusedError(refusal_sentence(err, reset_command(rig, connect))) from err


_WATCH_HEADING = f"{'k':>10} {'u [V]':>8} {'theta_1 [°]':>12} {'alpha [°]':>10} {'late [µs]':>10}"


def _watch(samples: Any) -> None:
    from rich.console import Console
    from rich.live import Live

    with Live(console=Console(), refresh_per_second=10) as live:
        for sample in samples:
            live.update(f"{_WATCH_HEADING}\n{_sample_line(sample)}")


def _watch_in_lines(samples: Any) -> None:
    """Print a line for each sample, so that a program can read the samples."""
    echo(_WATCH_HEADING)
    for sample in samples:
        echo(_sample_line(sample))


def _sample_line(sample: Any) -> str:
    from math import degrees

    from armrig.rig.telemetry_stream import LiveGap

    if isinstance(sample, LiveGap):
        return f"{sample.k_first:>10} {sample.count} missing: {sample.reason}"
    late = (sample.t_host_ns - sample.t_sched_ns) / 1e3
    return (
        f"{sample.k:>10} {sample.u_applied_v:>8.3f} {degrees(sample.theta_1_rad):>12.2f} "
        f"{degrees(sample.alpha_rad):>10.2f} {late:>10.1f}"
    )
