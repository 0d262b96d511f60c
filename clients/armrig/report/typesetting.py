"""Typst's part of a report: a template, its values as JSON and figures beside it, to a PDF."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import Any

import matplotlib as mpl
import typst

from armrig.recordings.recording import Recording

_NEVER = datetime(1970, 1, 1, tzinfo=UTC)


class ReportError(RuntimeError):
    """The report cannot be typeset."""


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
    root: Path, template: str, values: Mapping[str, Any], made: datetime, label: str
) -> tuple[bytes, list[tuple[str, float]]]:
    """Return the PDF of a template of this package, and where its sections begin.

    Parameters
    ----------
    root : Path
        Where the figures lie.
    values : mapping of str to anything
        What the template reads from data.json.
    made : datetime
        The document's date.
    label : str
        Of the template's metadata that say where sections begin: pairs of name and page.

    Raises
    ------
    ReportError
        The compiler refuses, which is a fault of this package.
    """
    made_on = [made.year, made.month, made.day]  # without it typst takes the time of day
    data = json.dumps({**values, "made_on": made_on})
    (root / "data.json").write_text(data, encoding="utf-8")
    text = resources.files("armrig.report").joinpath(template).read_text(encoding="utf-8")
    (root / template).write_text(text, encoding="utf-8")
    fonts = Path(mpl.get_data_path()) / "fonts" / "ttf"
    try:
        compiler = typst.Compiler(
            str(root / template),
            root=str(root),
            font_paths=[str(fonts)],
            ignore_system_fonts=True,
        )
        pdf = compiler.compile()
        if not isinstance(pdf, bytes):  # never: a list is of pictures, None of a file
            raise ReportError(template)
        places = json.loads(compiler.query(f"<{label}>", field="value"))
    except RuntimeError as err:
        msg = f"the report cannot be typeset: {err}"
        raise ReportError(msg) from err
    return pdf, [(str(name), float(page)) for name, page in places]
