"""Names of recordings on the command line: a path, `@last`, `@NAME` or `@NAME/validation`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from armrig_core.recording_file.part_names import part_paths

from armrig.cli.options import inform
from armrig.data.files import OTHER_DATA, RECORDING

_NAMES = "@last or @NAME"


def recording_path(text: str) -> Path:
    """Return the path of a recording from its path or @name; print what the @name means.

    Raises
    ------
    NoSuchRecordingError
        No recording has the name, or several recordings have the name.
    """
    from armrig.recordings.recording_names import chosen, described, recording_folder

    if not text.startswith("@"):
        _check_bare_name(Path(text))
        return Path(text)
    found = chosen(text, recording_folder())
    about = described(found).removeprefix(f"{text}, ")  # an id is not repeated
    inform(f"{text} is {about}", dim=True)
    return found.path


def _check_bare_name(path: Path) -> None:
    """Refuse a word that is not a file: a name without @, or a file without its suffix."""
    if path.suffix or path.parent != Path() or path.exists():
        return
    from armrig.recordings.recording_names import NoSuchRecordingError

    beside = path.with_suffix(RECORDING)
    is_there = path.name and part_paths(beside)[0].exists()
    meant = str(beside) if is_there else f"@{path}"
    raise NoSuchRecordingError(f"{path}: there is no such file; did you mean {meant}?")


OtherFile = Annotated[
    Path | None,
    typer.Argument(
        metavar="F2",
        parser=recording_path,
        help="Recording for validation.",
        show_default=False,
    ),
]
File = Annotated[
    Path,
    typer.Argument(metavar="F", parser=recording_path, help=f"Recording (*.mcap), {_NAMES}."),
]
DataFile = Annotated[
    Path,
    typer.Argument(
        metavar="F",
        parser=recording_path,
        help=f"Recording (*.mcap, {_NAMES}), or {OTHER_DATA}.",
    ),
]
