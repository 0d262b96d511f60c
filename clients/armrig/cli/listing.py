"""The command that lists the recordings: ls."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armrig.cli.chosen_recording import (
    Answering,
    answering_among,
    matching,
    recording_folder,
    short_name,
)
from armrig.cli.next_step import say_next
from armrig.cli.options import Json, echo, print_json, tell

if TYPE_CHECKING:
    from armrig.recordings.folder import RecordingSummary

Count = Annotated[int, typer.Option("--count", min=1, help="How many of the newest.")]
All = Annotated[bool, typer.Option("--all", help="All of them.")]
_COUNT = 20
_HEADINGS = ("recording", "kind", "length", "Ts", "missing", "started", "validates")


def ls(count: Count = _COUNT, every: All = False, json: Json = False) -> None:
    """List the recordings, newest first.

    With the names that other commands take for files, such as @last.
    """
    from itertools import islice

    from armrig.recordings.folder import facts_of, newest_first, summaries

    folder = recording_folder()
    paths = newest_first(folder)
    found = list(islice(summaries(paths), None if every else count))
    if json:
        print_json({"folder": str(folder), "recordings": [facts_of(s) for s in found]})
        return
    # Of all each file is read once, and names are looked up; of a few only what may answer is read.
    answering = answering_among(found) if every else lambda name: matching(name, paths)
    if found:
        echo(_table([_HEADINGS, *(_row(s, answering) for s in found)]))
    _tell_of_the_rest(folder, paths, found, whole_were_sought=every or len(found) < count)
    if found:
        say_next("ls", file=short_name(found[0], answering))


def _row(summary: RecordingSummary, answering: Answering) -> tuple[str, ...]:
    manifest = summary.manifest
    ended = summary.outcome.outcome
    how = "" if ended == "complete" else f"({ended.split(':')[0]})"
    return (
        short_name(summary, answering),
        summary.kind,
        f"{summary.seconds:g} s",
        f"{manifest.Ts:g} s",
        str(summary.outcome.missing),
        manifest.started[5:16].replace("T", " "),
        f"{_validated_by(summary, answering)} {how}".strip(),
    )


def _validated_by(summary: RecordingSummary, answering: Answering) -> str:
    """Return which recording one validates, by its short name; "" where none."""
    if not summary.is_validation:
        return ""
    estimations = answering(f"@{summary.validation_of}") if summary.validation_of else []
    return short_name(estimations[0], answering) if estimations else "not said"


def _table(rows: list[tuple[str, ...]]) -> str:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


def _tell_of_the_rest(
    folder: Path, paths: list[Path], found: list[RecordingSummary], *, whole_were_sought: bool
) -> None:
    """Tell what is not in the table: the older ones, and what is not whole."""
    unfinished = sum(1 for _ in folder.glob("*.mcap.active"))
    if not paths and not unfinished:
        tell(f"there are no recordings in {folder}; make one with `armrig collect`")
        return
    told = [f"in {folder}"]
    if not whole_were_sought:
        told.append(f"{len(paths) - len(found)} older ones: --all")
    elif damaged := len(paths) - len(found):
        told.append(f"{damaged} that are not whole: `armrig info FILE` says why")
    if unfinished:
        told.append(f"{unfinished} being written, or left by a daemon that died: `armrig recover`")
    tell("; ".join(told))
