"""The command record: a rig recorded from afar."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armrig.cli.next_step import say_next, typed
from armrig.cli.options import Json, RigId, echo, print_json, tell

if TYPE_CHECKING:
    from armrig.rig.remote_recording import RemoteRecording
    from armrig.rig.remote_source import RemoteSource

Source = Annotated[
    str | None,
    typer.Option(
        "--from",
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
    started anew, or another sampling time, begins a file of its own.
    """
    from contextlib import suppress

    from armrig.rig.remote_recording import RemoteRecording
    from armrig.rig.remote_source import RemoteSource
    from armrig.rig.session import configured_endpoint, no_reply, open_session

    path = _checked(out or Path(f"{rig}-remote-{time.strftime('%Y%m%dT%H%M%S')}.mcap"))
    where = source or configured_endpoint(rig)
    recording = RemoteRecording(path=path, rig=rig, endpoint=where, tell=tell)
    with open_session(source, rig=rig) as session:
        row = RemoteSource(session, rig)
        if (piece := row.next_piece()) is None:
            raise no_reply(rig, where)
        try:
            with suppress(KeyboardInterrupt):  # Ctrl-C is the way to end it
                recording.add(piece)
                tell(f"recording rig {rig} from {where}; Ctrl-C ends it")
                _record(row, recording, rig, seconds)
            _catch_up(row, recording)
        finally:
            recording.finish("complete")
    if not recording.done:
        msg = f"rig {rig} at {where} published no sample: there is nothing to record"
        raise RuntimeError(msg)
    _say(recording, json=json)


def _checked(path: Path) -> Path:
    if path.suffix != ".mcap":
        msg = f"-o {path}: a recording's name ends in .mcap"
        raise ValueError(msg)
    for taken in (path, path.with_name(f"{path.name}.active")):
        if taken.exists():
            msg = f"-o {path}: {taken.name} is there already; give another name"
            raise ValueError(msg)
    return path


def _record(row: RemoteSource, recording: RemoteRecording, rig: str, seconds: float | None) -> None:
    """Ask and write, until the time is over."""
    begun = heard = time.monotonic()
    silent = False
    while seconds is None or time.monotonic() - begun < seconds:
        piece = row.next_piece()
        now = time.monotonic()
        if piece is None:
            if now - heard > _SILENCE_S and not silent:
                tell(f"rig {rig} does not answer; waiting for it")
                silent = True
            time.sleep(_ASK_S)
            continue
        if silent:
            tell(f"rig {rig} answers again, after {now - heard:.1f} s")
        heard, silent = now, False
        recording.add(piece)
        if not piece.is_full:  # else there is more
            time.sleep(_ASK_S)


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
