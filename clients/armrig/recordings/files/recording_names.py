"""Names of recordings: `@last`, `@NAME` and `@NAME/validation`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from itertools import islice
from pathlib import Path

from armrig_core.errors import FileError, OperationError
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.recording_directory import configuration_files, directory_to_look_in

from armrig.recordings.files.catalogue import may_answer_to, newest_first, summaries
from armrig.recordings.files.recording_summary import RecordingSummary, summary_of

LAST = "last"
VALIDATION = "/validation"
_MAX_SEARCHED = 100
"""Number of recordings, newest first, whose names are compared with an unknown name."""
_MAX_LISTED = 4
"""Largest number of recordings in the message about an ambiguous name."""


class NoSuchRecordingError(OperationError):
    """A name is unknown or ambiguous; for an ambiguous name, the message lists the recordings."""


def recording_folder() -> Path:
    """Return the recording folder of this user's daemon or of this machine's service."""
    try:
        return directory_to_look_in(configuration_files(), os.environ)
    except ValueError as err:  # typer would replace the message of a ValueError
        raise NoSuchRecordingError(str(err)) from err


def path_of_name(name: str | Path) -> Path:
    """Return the path of a recording from its @NAME in the recording folder, or from its path.

    Raises FileError if no recording has the name, or several recordings have the name.
    """
    if not str(name).startswith("@") or Path(name).exists():
        return Path(name)
    try:
        return find_recording(str(name), recording_folder()).path
    except NoSuchRecordingError as err:
        raise FileError(str(err)) from err


def find_recording(text: str, folder: Path) -> RecordingSummary:
    """Return the finished recording that a name means: `@last`, `@NAME` or `@NAME/validation`.

    The function reads the names of all files, and the metadata of matching files only.

    Raises NoSuchRecordingError if no recording has the name, or several recordings have the name.
    """
    paths = newest_first(folder)
    if text == f"@{LAST}":
        for newest in summaries(paths):
            return newest
    matches = matching(text, paths)
    if not matches:
        raise NoSuchRecordingError(_none(text, folder))
    if len(matches) > 1:
        listed = "; ".join(describe(s) for s in matches[:_MAX_LISTED])
        end = f"; and {len(matches) - _MAX_LISTED} older ones" if len(matches) > _MAX_LISTED else ""
        raise NoSuchRecordingError(
            f"{text} may be any of {len(matches)} recordings, newest first: "
            f"{listed}{end}; use "
            "one of these, and give the next recording its own --name"
        )
    return matches[0]


def pick_complete(recordings: Sequence[RecordingSummary]) -> Sequence[RecordingSummary]:
    """Return the complete recordings of a name; if no recording is complete, return all.

    A run that ended early is usually repeated with the same command, and thus has the same name.
    """
    complete = [s for s in recordings if s.is_complete]
    return complete or recordings


def matching(text: str, paths: Sequence[Path]) -> Sequence[RecordingSummary]:
    """Return the finished recordings among `paths` that `@NAME` or `@NAME/validation` may mean."""
    validation = text.endswith(VALIDATION)
    name = text.removeprefix("@").removesuffix(VALIDATION)
    possible = [path for path in paths if may_answer_to(path, name, validation=validation)]
    return pick_complete([s for s in summaries(possible) if name in s.names(validation=validation)])


Answering = Callable[[str], Sequence[RecordingSummary]]
"""Function of `@NAME` or `@NAME/validation` that returns the recordings that the name may mean."""


def answering_among(index: Iterable[RecordingSummary]) -> Answering:
    """Return a function that looks up a name in an index and returns the possible recordings."""
    by_name: dict[str, list[RecordingSummary]] = {}
    for summary in index:
        for validation, behind in ((False, ""), (True, VALIDATION)):
            for name in summary.names(validation=validation):
                by_name.setdefault(f"@{name}{behind}", []).append(summary)
    meant = {name: pick_complete(namesakes) for name, namesakes in by_name.items()}
    return lambda name: meant.get(name, [])


def short_name(summary: RecordingSummary, answering: Answering) -> str:
    """Return the shortest unambiguous name of a recording: `@NAME`, its id or its path."""
    names = [f"@{summary.run_id}", f"@{Path(summary.file).stem}"]
    if summary.is_validation and (validated := summary.name or summary.validation_of):
        names.insert(0, f"@{validated}{VALIDATION}")
    elif summary.name:
        names.insert(0, f"@{summary.name}")
    for name in names:
        matches = answering(name)
        if len(matches) == 1 and matches[0].path == summary.path:
            return name
    return str(summary.path)


def name_of(path: Path) -> str:
    """Return the shortest name of a recording in the recording folder; "" for another file."""
    try:
        folder = recording_folder()
        if path.absolute().parent == folder.absolute():
            paths = newest_first(folder)
            return short_name(summary_of(path), lambda name: matching(name, paths))
    except (NoSuchRecordingError, DamageError, OSError):
        pass
    return ""


def describe(summary: RecordingSummary) -> str:
    """Return id, kind, name, length and start of a recording as text."""
    name = f" {summary.name}" if summary.name else ""
    return f"@{summary.run_id}, {summary.kind}{name}{contents(summary).removeprefix(summary.kind)}"


def contents(summary: RecordingSummary) -> str:
    """Return kind, length and start of a recording as text."""
    kind = f"{summary.kind}{' (validation)' if summary.is_validation else ''}"
    when = summary.started[:19].replace("T", " ")
    return f"{kind}, {summary.seconds:g} s, {when}"


def _none(text: str, folder: Path) -> str:
    unfinished = sum(1 for _ in folder.glob("*.mcap.active"))
    going = f" ({unfinished} still being written)" if unfinished else ""
    if text == f"@{LAST}":
        why = f"there is no finished recording in {folder}{going}; make one with `armrig collect`"
    else:
        why = f"no finished recording in {folder} has that name{going}; `armrig ls` lists all names"
        newest = islice(summaries(newest_first(folder)), _MAX_SEARCHED)
        wanted = text.removeprefix("@").removesuffix(VALIDATION)
        near = get_close_matches(wanted, sorted({s.name for s in newest if s.name}), n=1)
        why += f": did you mean @{near[0]}?" if near else ""
    return f"{text}: {why}"
