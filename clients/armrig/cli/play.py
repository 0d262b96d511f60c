"""The command play, which publishes a recording again for subscribers and dashboards."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Annotated

import typer
from armrig_core.errors import InputError

from armrig.cli.chosen_recording import File
from armrig.cli.next_step import say_next, typed
from armrig.cli.options import From, Json, To, echo, print_json, tell

if TYPE_CHECKING:
    from armrig.rig.playback import PublishedRun

Speed = Annotated[
    float,
    typer.Option("--speed", metavar="X", help="Speed of the playback, relative to the recording."),
]
Loop = Annotated[bool, typer.Option("--loop", help="Repeat the recording until Ctrl-C.")]
Wait = Annotated[bool, typer.Option("--wait", help="Begin when the first listener connects.")]
Listen = Annotated[
    str | None,
    typer.Option(
        "--listen",
        metavar="ENDPOINT",
        help="zenoh endpoint to publish at.",
        show_default="a socket of this user's",
    ),
]


def play(
    file: File,
    speed: Speed = 1.0,
    start: From = None,
    stop: To = None,
    loop: Loop = False,
    wait: Wait = False,
    listen: Listen = None,
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

    from armrig_core.topics import check_rig_id, played_id

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
    """Print the recording and its endpoint."""
    from armrig.cli.next_step import naming

    if json:
        facts = {"rig": rig, "endpoint": where, "messages": len(run), "samples": run.samples.size}
        print_json({**facts, "seconds": run.seconds / speed})
        return
    echo(f"{rig} at {where}: {len(run)} messages in {run.seconds / speed:.3g} s; Ctrl-C ends it")
    echo(f"in a second terminal: armrig watch{naming(rig, named)}")
