"""The commands that record from a network, and that publish a recording: record, play."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.commands.codes import COMPLETE, Ending, OutcomeCode
from armrig_core.errors import InputError, OperationError
from armrig_core.process.signal_pipe import SignalPipe, until_signal

from armrig.cli.next_step import naming, say_next, typed
from armrig.cli.options import From, Json, To, chosen, option
from armrig.cli.printing import echo, fields_of, inform, print_json, tell, tell_error
from armrig.cli.reading_options import File

if TYPE_CHECKING:
    from armrig.rig.playback import PublishedRun
    from armrig.rig.remote_recording import RemoteRecording

Rigs = Annotated[list[str] | None, option("--rig", "Id of a rig; repeatable.", "1")]


def record(
    source: str | None = chosen(
        None,
        "--from --connect ENDPOINT",
        "zenoh endpoint of the daemon or a router, such as tls/HOST:7447.",
        "[client] connect, or for one rig the daemon on this machine",
    ),
    rigs: Rigs = None,
    every: bool = chosen(False, "--all", "Record every rig, including rigs that start later."),
    out: Path | None = chosen(
        None,
        "-o FILE",
        "File to write; for several rigs, folder for the files.",
        "RIG-remote-TIME.mcap, here",
    ),
    seconds: float | None = chosen(
        None, "--seconds S", "Length of the recording, in s.", "until Ctrl-C"
    ),
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
    from armrig_core.telemetry.topics import check_own_id

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
    if json:
        print_json({"recordings": [*map(_facts, recording.done)]})
        return
    _list(recording.done)
    say_next("record", file=typed(recording.done[-1].path))


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


def _facts(file: Any) -> dict[str, Any]:
    return {"recording": str(file.path)} | fields_of(file, "samples missing outcome")


def _list(files: Iterable[Any]) -> None:
    for file in files:
        echo(f"{file.path}: {file.samples} samples, {file.missing} missing, {file.outcome}")


def default_name(rig: str) -> str:
    """Return the name of a new file of a rig."""
    return f"{rig}-remote-{time.strftime('%Y%m%dT%H%M%S')}.mcap"


def record_many(
    source: str | None,
    rigs: list[str] | None,
    out: Path | None,
    seconds: float | None,
    ended: SignalPipe,
    *,
    json: bool,
) -> None:
    """Record rigs at an endpoint into files in the folder `out`; `rigs` is None for all rigs."""
    from armrig.lab.fleet_recorder import FleetRecorder
    from armrig.rig.session import configured_connect, open_endpoint

    where = source or configured_connect()
    if not where:
        raise InputError(
            "--from is missing: give the endpoint of a router, such as tls/lab.local:7447"
        )
    folder = out or Path()
    folder.mkdir(parents=True, exist_ok=True)
    with open_endpoint(where).session as session:
        if ended.is_set():  # during loading and connecting
            raise KeyboardInterrupt
        recorder = FleetRecorder(
            session, where, lambda rig: folder / default_name(rig), tell, tell_error
        )
        named = "all rigs" if rigs is None else f"rigs {', '.join(rigs)}"
        inform(f"recording {named} from {where}; Ctrl-C ends it")
        recorded = recorder.record(ended, seconds, rigs)
    files = [(one.rig, file) for one in recorded for file in one.files]
    failed = [one for one in recorded if one.why]
    if json:
        facts = {"recordings": [{"rig": rig} | _facts(file) for rig, file in files]}
        print_json(facts | {"failed": [fields_of(one, "rig why") for one in failed]})
    else:
        _list(file for _, file in files)
    if failed:
        names = ", ".join(one.rig for one in failed)
        raise OperationError(
            f"the recording ended early for rig {names}, of {len(recorded)} rigs; see above"
        )
    if not files:
        msg = f"no rig at {where} published a sample: there is nothing to record; "
        raise OperationError(msg + "`armrig ls --live` lists the rigs")
    silent = [one.rig for one in recorded if not one.files]
    for rig in silent:
        tell(f"rig {rig}: no sample arrived, so it has no recording")
    if rigs is not None and silent:
        raise typer.Exit(1)


def play(
    file: File,
    speed: float = chosen(1.0, "--speed X", "Speed of the playback, relative to the recording."),
    start: From = None,
    stop: To = None,
    loop: bool = chosen(False, "--loop", "Repeat the recording until Ctrl-C."),
    wait: bool = chosen(False, "--wait", "Begin when the first listener connects."),
    listen: str | None = chosen(
        None, "--listen ENDPOINT", "zenoh endpoint to publish at.", "a socket of this user's"
    ),
    json: Json = False,
) -> None:
    """Publish the messages of a recording again.

    The command ends with the recording, or by Ctrl-C. The messages have keys such as
    rig/played-1/sample for a recording of rig 1. No rig has the id played-1, so commands get no
    answer.

    With --json the first line contains the endpoint, and the last line contains the number of
    messages.
    """
    from math import inf

    from armrig_core.telemetry.topics import check_rig_id, played_id

    from armrig.rig.playback import play as played
    from armrig.rig.playback import published, rest, staged
    from armrig.rig.session import own_endpoint

    if not 0 < speed < inf:
        raise InputError(f"--speed {speed:g}: must be more than 0, such as 1 or 10")
    run = published(file, start, stop)
    rig = played_id(check_rig_id(run.manifest.rig))
    if run.damage:
        tell(f"{file}: {run.damage}; the undamaged part is played")
    where = listen or own_endpoint(rig)
    count = 0
    with staged(where, rig) as stage, suppress(KeyboardInterrupt):  # Ctrl-C is a normal end
        _announce(run, rig, where, speed, named=listen, json=json)
        while True:
            if wait:
                stage.wait_for_listener()
            for _ in played(run, stage.publish, speed=speed):
                count += 1
            if not loop:
                break
            rest(run, speed=speed)
    if json:
        print_json({"rig": rig, "published": count})
        return
    echo(f"published {count} messages")
    say_next("play", file=typed(file))


def _announce(
    run: PublishedRun, rig: str, where: str, speed: float, *, named: str | None, json: bool
) -> None:
    if json:
        facts = {"rig": rig, "endpoint": where, "messages": len(run), "samples": run.samples.size}
        print_json({**facts, "seconds": run.seconds / speed})
        return
    echo(f"{rig} at {where}: {len(run)} messages in {run.seconds / speed:.3g} s; Ctrl-C ends it")
    echo(f"in a second terminal: armrig watch{naming(rig, named)}")
