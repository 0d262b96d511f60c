"""The command record: a rig recorded from afar."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

import typer

from armrig.cli.chosen_recording import COMPLETE
from armrig.cli.next_step import say_next, typed
from armrig.cli.options import Json, RigId, echo, print_json, tell

if TYPE_CHECKING:
    from armrig.rig.remote_recording import RemoteRecording
    from armrig.rig.remote_source import RemoteSource

Source = Annotated[
    str | None,
    typer.Option(
        "--from",
        "--connect",
        metavar="ENDPOINT",
        help="zenoh endpoint of the daemon.",
        show_default="this user's daemon",
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "-o", metavar="FILE", help="File to write.", show_default="RIG-remote-TIME.mcap, here"
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option("--seconds", metavar="S", help="End after so long.", show_default="Ctrl-C"),
]
_ASK_S = 0.2
_SILENCE_S = 2.0
_MOST_PIECES = 64


def record(
    source: Source = None,
    rig: RigId = "1",
    out: Out = None,
    seconds: Seconds = None,
    json: Json = False,
) -> None:
    """Record all that a rig publishes, from anywhere that reaches its daemon, until Ctrl-C.

    It begins with what the daemon keeps, the last 24 s at 1 kHz, and loses nothing while the way
    is interrupted for less than that; what is lost beyond is a gap in the file. A daemon that is
    started anew, another sampling time, or a break of more than 200 000 samples begins a file of
    its own.
    """
    from armrig_core.topics import check_own_id

    from armrig.rig.remote_recording import RemoteRecording
    from armrig.rig.remote_source import RemoteSource
    from armrig.rig.session import configured_endpoint, no_reply, open_session

    check_own_id(rig)
    if seconds is not None and not seconds > 0:
        msg = f"--seconds {seconds:g}: a number above 0 is needed"
        raise ValueError(msg)
    where = source or configured_endpoint(rig)
    path = _checked(out or Path(f"{rig}-remote-{time.strftime('%Y%m%dT%H%M%S')}.mcap"))
    recording = RemoteRecording(path=path, rig=rig, endpoint=where, tell=tell)
    outcome = COMPLETE
    with open_session(source, rig=rig) as session:
        row = RemoteSource(session, rig)
        if (piece := row.next_piece()) is None:
            raise no_reply(rig, where)
        with _ended() as ended:
            try:
                recording.add(piece)
                tell(f"recording rig {rig} from {where}; Ctrl-C ends it")
                _record(row, recording, rig, seconds, ended)
                _catch_up(row, recording)
            except (RuntimeError, OSError) as err:
                outcome = f"the recorder ended: {err}"
                raise
            finally:
                _finish(recording, outcome)
    if not recording.done:
        msg = f"rig {rig} at {where} published no sample: there is nothing to record"
        raise RuntimeError(msg)
    _say(recording, json=json)


def _finish(recording: RemoteRecording, outcome: str) -> None:
    try:
        recording.finish(outcome)
    except KeyboardInterrupt:
        tell("not complete: what was recorded is in *.mcap.active; `armrig recover` completes it")
        raise
    finally:
        if recording.done and outcome != COMPLETE:
            more = f", the last of {len(recording.done)} files" if len(recording.done) > 1 else ""
            tell(f"recorded until then: {recording.done[-1].path}{more}")


def _checked(path: Path) -> Path:
    from armrig_core.recording_file.part_names import ACTIVE

    if path.suffix != ".mcap":
        msg = f"-o {path}: a recording's name ends in .mcap"
        raise ValueError(msg)
    for taken in (path, path.with_name(f"{path.name}{ACTIVE}")):
        if os.path.lexists(taken):
            msg = f"-o {path}: {taken.name} is there already; give another name"
            raise ValueError(msg)
    return path


@contextmanager
def _ended() -> Iterator[Event]:
    """Give what Ctrl-C sets, or another signal that ends us; a second one interrupts.

    The first does not, as it may come between a message that was received and its file.
    """
    ended, received = Event(), []

    def note(number: int, _: object) -> None:
        if ended.is_set():
            raise KeyboardInterrupt
        received.append(number)
        ended.set()

    # Not every system has SIGHUP; and what nohup ignores stays ignored.
    numbers = [getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP")]
    before = {
        number: handler
        for number in numbers
        if number is not None and callable(handler := signal.getsignal(number))
    }
    for number in before:
        signal.signal(number, note)
    try:
        yield ended
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in received:
            if number != signal.SIGINT:  # the way to end it; of the others the exit code tells
                with suppress(KeyboardInterrupt):
                    before[number](number, None)


def _record(
    row: RemoteSource,
    recording: RemoteRecording,
    rig: str,
    seconds: float | None,
    ended: Event,
) -> None:
    """Ask and write, until the time is over."""
    begun = heard = time.monotonic()
    silent = False
    while not ended.is_set() and (seconds is None or time.monotonic() - begun < seconds):
        piece = row.next_piece()
        now = time.monotonic()
        if piece is None:
            if now - heard > _SILENCE_S and not silent:
                tell(f"rig {rig} does not answer; waiting for it")
                silent = True
            ended.wait(_ASK_S)
            continue
        if silent:
            tell(f"rig {rig} answers again, after {now - heard:.1f} s")
        heard, silent = now, False
        recording.add(piece)
        if not piece.is_full:  # else there is more
            ended.wait(_ASK_S)


def _catch_up(row: RemoteSource, recording: RemoteRecording) -> None:
    """Record what has been published up to now; no more than a daemon keeps."""
    for _ in range(_MOST_PIECES):
        piece = row.next_piece()
        if piece is None:
            break
        recording.add(piece)
        if not piece.is_full:
            break


def _say(recording: RemoteRecording, *, json: bool) -> None:
    files = recording.done
    if json:
        facts = [
            {
                "recording": str(file.path),
                "samples": file.samples,
                "missing": file.missing,
                "outcome": file.outcome,
            }
            for file in files
        ]
        print_json({"recordings": facts})
        return
    for file in files:
        echo(f"{file.path}: {file.samples} samples, {file.missing} missing, {file.outcome}")
    say_next("record", file=typed(files[-1].path))
