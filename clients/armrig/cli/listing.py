"""The command ls, which lists recordings and rigs."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from armrig_core.commands.codes import COMPLETE
from armrig_core.errors import InputError
from armrig_core.process.printable import printable

from armrig.cli.next_step import say_next, typed
from armrig.cli.options import Json, argument, chosen, option
from armrig.cli.printing import echo, fields_of, inform, print_json, some, tell

if TYPE_CHECKING:
    from armrig.recordings.catalogue import Catalogue, LeftOut
    from armrig.recordings.recording_names import Answering
    from armrig.recordings.recording_summary import RecordingSummary

Live = Annotated[bool, option("--live", "List the rigs that are alive.")]
Folder = Annotated[
    Path | None,
    argument("FOLDER", "Folder of the recordings.", "the folder that the daemon records into"),
]
Connect = Annotated[
    str | None,
    option(
        "--connect ENDPOINT",
        "Only with --live: zenoh endpoint of a router or daemon.",
        "[client] connect, or all rigs of this machine",
    ),
]
Naming = Callable[["RecordingSummary"], str]
_DEFAULT_COUNT = 20
_MAX_NAMES = 3
_MAX_WIDTH = 60  # characters of a column
_HEADINGS = ("recording", "kind", "length", "Ts", "missing", "started", "outcome", "validates")
_OPTIONAL = 2  # number of optional columns, which are the last columns


def ls(
    where: Folder = None,
    count: int = chosen(
        _DEFAULT_COUNT, "--count", "Number of the newest recordings to list.", min=1
    ),
    every: bool = chosen(False, "--all", "List all recordings."),
    live: Live = False,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """List the recordings, newest first, or with --live the rigs.

    Other commands accept the listed names, and @last, in place of a file. If you give a FOLDER,
    the list contains file names instead. With --connect, --live lists the rigs at the given
    endpoint.
    """
    if live and (where is not None or every):
        raise InputError(
            "--live lists rigs: leave out the folder and --all, which are for recordings"
        )
    if connect and not live:
        raise InputError(f"--connect {connect} needs --live: without --live, ls lists files")
    if live:
        _list_rigs(connect, json=json)
        return
    from armrig.recordings.catalogue import catalogue, facts_of
    from armrig.recordings.recording_names import answering_among, recording_folder, short_name
    from armrig.recordings.recording_summary import shown_path

    folder = where or recording_folder()
    try:
        found = catalogue(folder)
    except (FileNotFoundError, NotADirectoryError):
        if where is not None:
            raise
        found = None
    whole = found.recordings if found else ()
    shown = whole if every else whole[:count]
    if json:
        # `found` is false without a recording, even if it contains other files.
        left_out, unfinished = (found.left_out, found.unfinished) if found is not None else ((), ())
        print_json(
            {
                "folder": str(folder),
                "recordings": [facts_of(s) for s in shown],
                "left_out": [
                    {"recording": shown_path(path), "why": why, "foreign": is_foreign}
                    for path, why, is_foreign in left_out
                ],
                "unfinished": [shown_path(p) for p in unfinished],
            }
        )
        return
    answering = answering_among(whole)

    def name_of(summary: RecordingSummary) -> str:
        # A name such as @last means a recording in the default folder.
        return str(summary.path) if where else short_name(summary, answering)

    if shown:
        rows = [_row(s, name_of, answering) for s in shown]
        # An optional column is left out if it is empty, or if all its outcomes are complete.
        kept = [True] * (len(_HEADINGS) - _OPTIONAL)
        kept += [not {row[i] for row in rows} <= {"", COMPLETE.text} for i in range(-_OPTIONAL, 0)]
        echo(_table([tuple(compress(row, kept)) for row in (_HEADINGS, *rows)]))
    inform(_the_rest(folder, found, len(shown)), dim=True)
    if shown:
        newest = shown[0]
        say_next("ls", file=typed(newest.path) if where else short_name(newest, answering))


def _list_rigs(connect: str | None, *, json: bool) -> None:
    from armrig.rig.status import live_rigs

    where, found = live_rigs(connect)
    if json:
        rigs = [fields_of(r, "rig endpoint status why") for r in found]
        print_json({"where": where, "rigs": rigs})
        return
    if not found:
        tell(
            f"no rig is alive at {where}: start one with `armrig lab` or `armrigd run`; for a rig "
            "of another machine give its router, --connect tls/HOST:PORT"
        )
        return
    rows = [
        (r.rig, s.phase, f"{s.Ts:g} s", s.owner or "nobody", s.reason or s.line)
        if (s := r.status) is not None
        else (r.rig, "", "", "", r.why)
        for r in found
    ]
    echo(_table([("rig", "phase", "Ts", "owner", ""), *(tuple(map(printable, r)) for r in rows)]))


def _row(summary: RecordingSummary, name_of: Naming, answering: Answering) -> tuple[str, ...]:
    why = re.split("[:(]", summary.outcome)[0].strip()
    cells = (
        name_of(summary),
        _clipped(summary.kind),
        f"{summary.seconds:g} s",
        f"{summary.Ts:g} s",
        str(summary.missing),
        summary.started[:16].replace("T", " "),
        _clipped(why),
        _validated_by(summary, name_of, answering),
    )
    return tuple(map(printable, cells))  # a name may have a line break in it


def _clipped(text: str) -> str:
    return text if len(text) <= _MAX_WIDTH else f"{text[: _MAX_WIDTH - 1]}…"


def _validated_by(summary: RecordingSummary, name_of: Naming, answering: Answering) -> str:
    """Return the estimation recording's name; "" if the validation recording's name contains it."""
    from armrig.recordings.recording_names import VALIDATION, short_name

    if not summary.is_validation or short_name(summary, answering).endswith(VALIDATION):
        return ""
    estimations = answering(f"@{summary.validation_of}") if summary.validation_of else []
    return name_of(estimations[0]) if estimations else "not known"


def _table(rows: list[tuple[str, ...]]) -> str:
    # A name is never cut, because a person types it; a longer name does not widen the other rows.
    widths = [min(max(map(len, column)), _MAX_WIDTH) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


def _the_rest(folder: Path, found: Catalogue | None, shown: int) -> str:
    """Return a line about the files that are not in the table."""
    if found is None or not (found.recordings or found.left_out or found.unfinished):
        return f"there are no recordings in {folder}; make one with `armrig collect`"
    parts = [f"in {folder}"]
    if older := len(found) - shown:
        parts.append(f"{older} older recordings: --all")
    if damaged := [left for left in found.left_out if not left.is_foreign]:
        parts.append(f"damaged: {_names(damaged)}; `armrig info FILE` shows the damage")
    if foreign := [left for left in found.left_out if left.is_foreign]:
        parts.append(f"not made by armrig: {_names(foreign)}; `armrig hints FILE` lists the topics")
    if unfinished := len(found.unfinished):
        parts.append(f"{unfinished} being written, or left by a dead daemon: `armrig recover`")
    return "; ".join(parts)


def _names(left_out: Sequence[LeftOut]) -> str:
    from armrig.recordings.recording_summary import shown_path

    return some([shown_path(Path(left.path.name)) for left in left_out], _MAX_NAMES)
