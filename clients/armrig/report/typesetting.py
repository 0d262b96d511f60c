"""Typesetting of a report: a Typst template, values as JSON and figures are compiled to a PDF."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from datetime import UTC, datetime
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import typst
from armrig_core.errors import OperationError
from armrig_core.process.printable import printable_texts, with_degrees

from armrig.recordings.recording import Recording
from armrig.report.sections import Contents, ReportFigure

Places = list[tuple[str, float]]
"""Name and start of each section. A start of 2.3 is on page 2, below 30 % of the page."""
TEMPLATE, _VALUES = "report.typ", "data.json"
_UNKNOWN_DATE = datetime(1970, 1, 1, tzinfo=UTC)


def latest_start(recordings: Iterable[Recording]) -> datetime:
    """Return the start time of the newest recording; 1970 if none has a start time in UTC.

    This time is the date of a report, so that a report of the same recordings has the same bytes.
    """
    return max((_start_time(r) for r in recordings), default=_UNKNOWN_DATE)


def _start_time(recording: Recording) -> datetime:
    try:
        started = datetime.fromisoformat(recording.manifest.started)
        return started.replace(tzinfo=started.tzinfo or UTC).astimezone(UTC)
    except (ValueError, OverflowError):  # 9999-12-31 west of Greenwich is in the year 10000
        return _UNKNOWN_DATE


def typeset(root: Path, contents: Contents, made: datetime) -> tuple[bytes, Places]:
    """Write the template and the contents into a folder, and compile them to a PDF.

    The folder contains the figures already. The template reads the contents from data.json. The
    date of the document is `made`.
    """
    made_on = [made.year, made.month, made.day]  # without a date, typst uses the current time
    values = _values(contents) | {"version": version("armrig"), "made_on": made_on}
    values = printable_texts(json.loads(json.dumps(values, default=_values)))
    data = json.dumps(values, indent=1, ensure_ascii=False)
    data = with_degrees(data).replace('"degC"', '"°C"')
    (root / _VALUES).write_text(data, encoding="utf-8")
    text = resources.files("armrig.report").joinpath(TEMPLATE).read_text(encoding="utf-8")
    (root / TEMPLATE).write_text(text, encoding="utf-8")
    return compile_pdf(root / TEMPLATE)


def _values(part: Any) -> dict[str, Any]:
    """Return the fields of a part of a report that the template reads."""
    drawing = ("height", "draws") if isinstance(part, ReportFigure) else ()
    return {f.name: getattr(part, f.name) for f in fields(part) if f.name not in drawing}


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
            f"{folder}: {err.strerror}; give a new folder, in a place where you can write"
        ) from err
    yield folder


def compile_pdf(source: Path) -> tuple[bytes, Places]:
    """Compile a Typst file, which can read only the files in its folder.

    Returns the PDF and the starts of its sections.
    """
    fonts = Path(mpl.get_data_path()) / "fonts" / "ttf"
    compiler = typst.Compiler(
        str(source), root=str(source.parent), font_paths=[str(fonts)], ignore_system_fonts=True
    )
    pdf = cast("bytes", compiler.compile())  # only images and output files have another type
    return pdf, json.loads(compiler.query("<place>", field="value"))
