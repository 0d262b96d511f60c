"""Typesetting of a report: a Typst template, values as JSON and figures are compiled to a PDF."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from threading import Thread

import matplotlib as mpl
import typst
from armrig_core.errors import OperationError

from armrig.recordings.recording import Recording
from armrig.report.sections import Contents

Places = list[tuple[str, float]]
"""Name and start of each section. A start of 2.3 is on page 2, below 30 % of the page."""
TEMPLATE, _VALUES = "report.typ", "data.json"
_UNKNOWN_DATE = datetime(1970, 1, 1, tzinfo=UTC)


def recorded(recordings: Iterable[Recording]) -> datetime:
    """Return the start time of the newest recording; 1970 if no recording contains a start time.

    This time is the date of a report, so that a report of the same recordings has the same bytes.
    """
    return max((_started(r) for r in recordings), default=_UNKNOWN_DATE)


def _started(recording: Recording) -> datetime:
    try:
        started = datetime.fromisoformat(recording.manifest.started)
    except ValueError:
        return _UNKNOWN_DATE
    return started.replace(tzinfo=started.tzinfo or UTC).astimezone(UTC)


def typeset(root: Path, contents: Contents, made: datetime) -> tuple[bytes, Places]:
    """Write the template and the contents into a folder, and compile them to a PDF.

    The folder contains the figures already. The template reads the contents from data.json. The
    date of the document is `made`. If the compiler refuses the document, which is a fault of this
    package, the function raises an OperationError.
    """
    made_on = [made.year, made.month, made.day]  # without a date, typst uses the current time
    values = asdict(contents) | {"version": version("armrig"), "made_on": made_on}
    data = json.dumps(values, indent=1, ensure_ascii=False)
    (root / _VALUES).write_text(data, encoding="utf-8")
    text = resources.files("armrig.report").joinpath(TEMPLATE).read_text(encoding="utf-8")
    (root / TEMPLATE).write_text(text, encoding="utf-8")
    return compiled(root / TEMPLATE)


def page_limit(folder: Path) -> int | None:
    """Return the largest number of pages of the report with its source in a folder."""
    try:
        limit = json.loads((folder / _VALUES).read_text(encoding="utf-8"))["max_pages"]
    except (OSError, ValueError, KeyError, TypeError):  # the reader wrote a source of their own
        return None
    return limit if isinstance(limit, int) else None


@contextmanager
def source_folder(folder: Path | None) -> Iterator[Path]:
    """Yield the folder for a report's source: `folder`, or a temporary folder if it is None.

    Raises
    ------
    OperationError
        The folder is not empty, or cannot be created.
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
    """Compile a Typst file; return the PDF and the starts of its sections.

    The compiler can read only files in the folder of the source, and packages of Typst.

    Raises
    ------
    OperationError
        The compiler refuses the file, a link points out of the folder, or somebody changed the mark
        of a section.
    """
    _check_links(source.parent)
    pdf, marks = _interruptible(lambda: _compiled(source))
    try:
        return pdf, [(str(name), float(page)) for name, page in json.loads(marks)]
    except (TypeError, ValueError) as err:
        raise OperationError(
            f"{source}: a #mark of the template is missing or changed: restore each #mark"
        ) from err


def _check_links(folder: Path) -> None:
    """Raise OperationError for a link that points out of a folder: the compiler would follow it."""
    inside = folder.resolve()
    for path in folder.rglob("*"):
        if path.is_symlink() and not path.resolve().is_relative_to(inside):
            raise OperationError(
                f"{path}: this link points out of the folder: replace it by a copy of its file"
            )


def _interruptible(work: Callable[[], tuple[bytes, str]]) -> tuple[bytes, str]:
    """Run `work` in a thread, so that Ctrl-C ends the wait although the compiler ignores Ctrl-C."""
    done: Future[tuple[bytes, str]] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as err:
            done.set_exception(err)

    Thread(target=run, daemon=True).start()
    return done.result()


def _compiled(source: Path) -> tuple[bytes, str]:
    """Compile a Typst file; return the PDF and the marks of its sections as JSON."""
    fonts = Path(mpl.get_data_path()) / "fonts" / "ttf"
    try:
        compiler = typst.Compiler(
            str(source), root=str(source.parent), font_paths=[str(fonts)], ignore_system_fonts=True
        )
        pdf = compiler.compile()
        if not isinstance(pdf, bytes):  # only images and output files have another type
            raise OperationError(source.name)
        return pdf, compiler.query("<place>", field="value")
    except RuntimeError as err:
        place = re.search(r"([^/\s]+):(\d+):\d+\n", str(getattr(err, "diagnostic", "")))
        at = f"{source.with_name(place[1])}, line {place[2]}" if place else str(source)
        raise OperationError(f"{at}: the report cannot be typeset: {err}") from err
