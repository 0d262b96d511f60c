"""The command recover, which finishes unfinished recordings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armrig.cli.options import Json, echo, inform, print_json, tell

if TYPE_CHECKING:
    from collections.abc import Iterator

    from armrig_core.recording_file.recovery import RecoveredFile

Where = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="FILE|FOLDER…",
        help="Unfinished recordings (*.mcap.active), or folders that contain them.",
        show_default="the folder that the daemon records into",
    ),
]


def recover(where: Where = None, json: Json = False) -> None:
    """Finish recordings that a daemon left unfinished when it died.

    A daemon completes its own recordings when it starts again; this command is for copied files. It
    refuses a file that a daemon is still writing. Each file keeps its undamaged part and gets a
    name that ends in .mcap. If a file cannot be recovered, it stays unchanged, and the exit code is
    1.
    """
    from armrig_core.recording_file.recovery import sentence
    from armrig_core.recording_file.unfinished import NotOursError, RecoveryError

    from armrig.recordings.recording_names import recording_folder

    paths = list(_files(where or [recording_folder()]))
    done: list[RecoveredFile] = []
    left: list[tuple[Path, str]] = []
    failed = False
    recovery = _recovery()
    for path, is_named in paths:
        try:
            done.append(recovery.recover(path))
        except RecoveryError as err:
            left.append((path, str(err)))
            failed |= is_named or not isinstance(err, NotOursError)
            tell(str(err))
        else:
            if not json:
                echo(sentence(done[-1]))
    if json:
        unfinished = [{"recording": str(path), "why": why} for path, why in left]
        print_json({"recovered": [_facts(file) for file in done], "left": unfinished})
    elif not paths:
        inform(f"nothing to recover in {', '.join(map(str, where or [recording_folder()]))}")
    if failed:
        raise typer.Exit(1)


def _files(where: list[Path]) -> Iterator[tuple[Path, bool]]:
    """Yield each unfinished file, and True if the user named the file and not its folder."""
    from armrig_core.recording_file.unfinished import unfinished

    for path in where:
        if path.is_dir():
            yield from ((file, False) for file in unfinished(path))
        else:
            yield path, True


def _recovery() -> Any:
    from datetime import UTC, datetime
    from importlib.metadata import version

    from armrig_core.recording_file.recovery import Recovery

    return Recovery(
        armrig=version("armrig"),
        now=lambda: datetime.now(UTC).astimezone().isoformat(timespec="milliseconds"),
    )


def _facts(file: RecoveredFile) -> dict[str, Any]:
    return {
        "recording": str(file.path),
        "samples": file.outcome.samples,
        "missing": file.outcome.missing,
        "outcome": file.outcome.outcome,
        "recovered": file.recovered,
    }
