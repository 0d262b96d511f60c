"""Remote recording of many rigs: `record --all`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from armrig_core.errors import InputError, OperationError
from armrig_core.signal_pipe import SignalPipe

from armrig.cli.options import echo, inform, print_json, tell, tell_error

if TYPE_CHECKING:
    from armrig.lab.fleet_recorder import RigRecorded


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
    _say(recorded, where, json=json)
    silent = [one.rig for one in recorded if not one.files]
    for rig in silent:
        tell(f"rig {rig}: no sample arrived, so it has no recording")
    if rigs is not None and silent:
        raise typer.Exit(1)


def _say(recorded: list[RigRecorded], where: str, *, json: bool) -> None:
    files = [(one.rig, file) for one in recorded for file in one.files]
    failed = [one for one in recorded if one.why]
    if json:
        print_json(
            {
                "recordings": [
                    {
                        "rig": rig,
                        "recording": str(file.path),
                        "samples": file.samples,
                        "missing": file.missing,
                        "outcome": file.outcome,
                    }
                    for rig, file in files
                ],
                "failed": [{"rig": one.rig, "why": one.why} for one in failed],
            }
        )
    else:
        for _, file in files:
            echo(f"{file.path}: {file.samples} samples, {file.missing} missing, {file.outcome}")
    if failed:
        names = ", ".join(one.rig for one in failed)
        raise OperationError(
            f"the recording ended early for rig {names}, of {len(recorded)} rigs; see above"
        )
    if not files:
        msg = f"no rig at {where} published a sample: there is nothing to record; "
        raise OperationError(msg + "`armrig ls --live` lists the rigs")
