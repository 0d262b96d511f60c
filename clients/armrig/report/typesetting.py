"""Typst's part of a report: a template, its values as JSON and figures beside it, to a PDF."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from threading import Thread
from typing import Any

import matplotlib as mpl
import typst
from armrig_core.errors import OperationError

from armrig.recordings.recording import Recording

Places = list[tuple[str, float]]
"""Begin of each section: page, from 1, and the share of the page above it."""
_NEVER = datetime(1970, 1, 1, tzinfo=UTC)


def recorded(recordings: Iterable[Recording]) -> datetime:
    """Return when the newest recording was begun; 1970 where none says.

    A report bears this date and not the day on which it was typeset: the same recordings give the
    same bytes.
    """
    return max((_started(r) for r in recordings), default=_NEVER)


def _started(recording: Recording) -> datetime:
    try:
        started = datetime.fromisoformat(recording.manifest.started)
    except ValueError:
        return _NEVER
    return started.replace(tzinfo=started.tzinfo or UTC).astimezone(UTC)


def typeset(
    root: Path, template: str, values: Mapping[str, Any], made: datetime
) -> tuple[bytes, Places]:
    """Return the PDF of a template of this package, and where its sections begin.

    Parameters
    ----------
    root : Path
        Folder of the figures; the template and data.json are written into it.
    values : mapping of str to anything
        Values that the template reads from data.json.
    made : datetime
        Date of the document.

    Raises
    ------
    OperationError
        The compiler refuses, which is a fault of this package.
    """
    made_on = [made.year, made.month, made.day]  # without it typst takes the time of day
    data = json.dumps({**values, "made_on": made_on}, indent=1, ensure_ascii=False)
    (root / "data.json").write_text(data, encoding="utf-8")
    text = resources.files("armrig.report").joinpath(template).read_text(encoding="utf-8")
    (root / template).write_text(text, encoding="utf-8")
    return compiled(root / template)


@contextmanager
def source_folder(folder: Path | None) -> Iterator[Path]:
    """Give the folder in which a report is made: one that stays, or one that is removed after.

    Raises
    ------
    OperationError
        The folder contains something, or cannot be made.
    """
    if folder is None:
        with tempfile.TemporaryDirectory(prefix="armrig-report-") as directory:
            yield Path(directory)
        return
    try:
        folder.mkdir(exist_ok=True)
        if any(folder.iterdir()):
            raise OperationError(f"{folder}: contains files already; name a new folder")
    except OSError as err:
        raise OperationError(
            f"{folder}: {err.strerror}; name a new folder in a folder that you can write to"
        ) from err
    yield folder


def compiled(source: Path) -> tuple[bytes, Places]:
    """Return the PDF of a Typst file, and where its sections begin.

    The compiler reads files in the folder of the source alone, and packages of Typst.

    Raises
    ------
    OperationError
        The compiler refuses, a link leads out of the folder, or a mark of a section is another one
        than the template's.
    """
    _check_links(source.parent)
    pdf, told = _interruptible(lambda: _compiled(source))
    try:
        return pdf, [(str(name), float(page)) for name, page in json.loads(told)]
    except (TypeError, ValueError) as err:
        raise OperationError(
            f"{source}: a <place> there is not the template's: leave #mark as it was written"
        ) from err


def _check_links(folder: Path) -> None:
    """Refuse a link that leads out of a folder: the compiler follows it."""
    inside = folder.resolve()
    for path in folder.rglob("*"):
        if path.is_symlink() and not path.resolve().is_relative_to(inside):
            raise OperationError(
                f"{path}: a link that leads out of the folder: give a copy of its file"
            )


def _interruptible(work: Callable[[], tuple[bytes, str]]) -> tuple[bytes, str]:
    """Return what a thread returns; Ctrl-C, which the compiler never sees, ends the wait."""
    done: Future[tuple[bytes, str]] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as err:
            done.set_exception(err)

    Thread(target=run, daemon=True).start()
    return done.result()


def _compiled(source: Path) -> tuple[bytes, str]:
    """Return the PDF of a Typst file, and its marks as JSON."""
    fonts = Path(mpl.get_data_path()) / "fonts" / "ttf"
    try:
        compiler = typst.Compiler(
            str(source),
            root=str(source.parent),
            font_paths=[str(fonts)],
            ignore_system_fonts=True,
        )
        pdf = compiler.compile()
        if not isinstance(pdf, bytes):  # never: a list is of pictures, None of a file
            raise OperationError(source.name)
        return pdf, compiler.query("<place>", field="value")
    except RuntimeError as err:
        place = re.search(r"([^/\s]+):(\d+):\d+\n", str(getattr(err, "diagnostic", "")))
        at = f"{source.with_name(place[1])}, line {place[2]}" if place else str(source)
        raise OperationError(f"{at}: the report cannot be typeset: {err}") from err
