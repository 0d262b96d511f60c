"""The command record, which records a rig over a connection to its daemon."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from armrig_core.codes import COMPLETE, Ending, OutcomeCode
from armrig_core.errors import InputError, OperationError
from armrig_core.signal_pipe import SignalPipe, until_signal

from armrig.cli.fleet import default_name, record_many
from armrig.cli.next_step import say_next, typed
from armrig.cli.options import Json, echo, inform, print_json, tell

if TYPE_CHECKING:
    from armrig.rig.remote_recording import RemoteRecording

Source = Annotated[
    str | None,
    typer.Option(
        "--from",
        "--connect",
        metavar="ENDPOINT",
        help="zenoh endpoint of the daemon or a router, such as tls/HOST:7447.",
        show_default="[client] connect, or for one rig the daemon on this machine",
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "-o",
        metavar="FILE",
        help="File to write; for several rigs, folder for the files.",
        show_default="RIG-remote-TIME.mcap, here",
    ),
]
Rigs = Annotated[
    list[str] | None, typer.Option("--rig", help="Id of a rig; repeatable.", show_default="1")
]
Every = Annotated[
    bool, typer.Option("--all", help="Record every rig, including rigs that start later.")
]
Seconds = Annotated[
    float | None,
    typer.Option(
        "--seconds", metavar="S", help="Length of the recording, in s.", show_default="until Ctrl-C"
    ),
]


def record(
    source: Source = None,
    rigs: Rigs = None,
    every: Every = False,
    out: Out = None,
    seconds: Seconds = None,
    json: Json = False,
) -> None:
    """Record all that a rig publishes, until Ctrl-C.

    The connection to the rig's daemon may be a socket or a network.

    With --all or several --rig the command records many rigs, each into its own files. Rigs that
    start later are included. A failure of one rig does not affect the other rigs.

    The recording begins with the samples that the daemon keeps: at 1 kHz, the last 24 s. If the
    connection is interrupted for less than this time, no sample is lost. A longer interruption
    leaves a gap in the file.

    A new file begins if the daemon restarts or the sampling time changes. A new file also begins
    after 8 388 608 samples, or if more than 200 000 samples of the current file are missing.
    """
    from armrig_core.topics import check_own_id

    if seconds is not None and not seconds > 0:
        raise InputError(f"--seconds {seconds:g}: must be more than 0")
    for name in rigs or ():
        check_own_id(name)
    if every and rigs:
        raise InputError(f"--all with --rig {rigs[0]}: give only one; --all records every rig")
    with until_signal() as ended:
        if every or len(rigs or ()) > 1:
            record_many(source, rigs, out, seconds, ended, json=json)
        else:
            _record_one(source, (rigs or ["1"])[0], out, seconds, ended, json=json)


def _record_one(
    source: str | None,
    rig: str,
    out: Path | None,
    seconds: float | None,
    ended: SignalPipe,
    *,
    json: bool,
) -> None:
    from armrig.rig.remote_recording import RemoteRecorder, RemoteRecording, recorder_ended
    from armrig.rig.session import no_reply, open_connection

    path = _checked(out or Path(default_name(rig)))
    connection = open_connection(source, rig=rig)
    where = connection.endpoint
    recording = RemoteRecording(path=path, rig=rig, endpoint=where, tell=tell)
    how = COMPLETE
    with connection.session as session:
        if ended.is_set():  # during loading and connecting
            raise KeyboardInterrupt
        recorder = RemoteRecorder(session, recording)
        try:
            if not recorder.begin():
                raise no_reply(rig, where)
            inform(f"recording rig {rig} from {where}; Ctrl-C ends it")
            recorder.record(ended, seconds)
        except (RuntimeError, OSError) as err:
            how = recorder_ended(err)
            raise
        finally:
            _finish(recording, how)
    if not recording.done:
        raise OperationError(f"rig {rig} at {where} published no sample, so there is no recording")
    _say(recording, json=json)


def _finish(recording: RemoteRecording, ended: Ending) -> None:
    try:
        recording.finish(ended)
    except KeyboardInterrupt:
        tell("not complete: the samples are in *.mcap.active; `armrig recover` completes the file")
        raise
    finally:
        if recording.done and ended.code != OutcomeCode.COMPLETE:
            more = f", the last of {len(recording.done)} files" if len(recording.done) > 1 else ""
            tell(f"recorded up to the error: {recording.done[-1].path}{more}")


def _checked(path: Path) -> Path:
    from armrig_core.recording_file.part_names import ACTIVE

    if path.suffix != ".mcap":
        raise InputError(f"-o {path}: the name of a recording ends in .mcap")
    for taken in (path, path.with_name(f"{path.name}{ACTIVE}")):
        if os.path.lexists(taken):
            raise InputError(f"-o {path}: {taken.name} exists; give another name")
    return path


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
