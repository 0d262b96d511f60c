"""Figures that commands write: one with all axes, or in a folder a file for each subject."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.errors import InputError

from armrig.cli.options import tell

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from armrig.recordings.recording import Recording


Draw = Callable[..., Any]
"""Draws into `ax`."""
_EACH = "*"  # for the subject, in the name of the files in a folder
_WIDTH, _HEIGHT = 6.3, 8.0  # in inches: the text of an A4 page, and a screen
_DPI = 200
_RUNS: dict[str, str] = {}
"""Run of each recording that the command has read, by the recording's hash."""
_ESTIMATION: dict[Path, str] = {}
"""Files that these recordings validate models of, which a saved model names by hash; their runs."""
_MCAP = b"\x89MCAP0\r\n"


def name_runs(*recordings: Recording) -> None:
    """Sign the command's figures with the ids of these runs, as `armrig ls` shows them.

    The run that a recording validates models of has its id, too, if it is in the same folder.
    """
    for r in recordings:
        _RUNS[r.sha256] = r.manifest.run_id
        of = str(r.manifest.details.get("validation_of", ""))
        if of.isalnum():
            _ESTIMATION.update((path, of) for path in r.path.parent.glob(f"*-{of}.mcap"))


def _runs() -> dict[str, str]:
    """Return the run of each recording that a figure may be of, by the recording's hash."""
    from hashlib import file_digest

    runs = dict(_RUNS)
    for path, of in _ESTIMATION.items():
        with suppress(OSError), path.open("rb") as file:
            runs[file_digest(file, "sha256").hexdigest()] = of
    return runs


def figure_path(text: str | Path) -> Path:
    """Return the path of a figure; of a folder, or of what ends with "/", FOLDER/*.png."""
    path = Path(text)
    return path / f"{_EACH}.png" if str(text).endswith("/") or path.is_dir() else path


Plot = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--plot",
        metavar="FIGURE",
        parser=figure_path,
        help="Figure, or FOLDER/ for a file each.",
    ),
]


def check_plot(path: Path | None, inputs: Sequence[Path] = ()) -> None:
    """Refuse, before any work, a figure that cannot or must not be written."""
    if path is None:
        return
    folder = path.parent
    if path.stem != _EACH:
        check_output(path, inputs)
    elif folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}/: is a file; give a folder, or leave the / out")
    elif not folder.is_dir():
        check_output(folder, ())
    check_figure(path)


def check_figure(path: Path) -> None:
    """Raise ValueError where no figure of that kind can be written."""
    from matplotlib.figure import Figure

    kinds = Figure().canvas.get_supported_filetypes()
    if path.suffix.lower().removeprefix(".") not in kinds:
        raise InputError(f"{path}: a figure's name ends in one of {', '.join(sorted(kinds))}")


def write_plot(path: Path | None, *, height: float = 3.6, **draw: Draw) -> list[Path]:
    """Write a figure with axes for each subject, say where it is, and return the files.

    A figure is made again by the same line, so one that is there is replaced, and said.

    Parameters
    ----------
    path : Path, optional
        Of one figure, or of a folder, by `figure_path`: then each subject has a file of its name.
    height : float
        Of the axes of one subject, in inches.
    **draw
        Subject -> what draws it into `ax`.
    """
    if path is None:
        return []
    from armrig.cli.spinner import spinner
    from armrig.plots.captions import named_by_run
    from armrig.plots.layout import save

    figures = {path: list(draw.values())}
    if path.stem == _EACH:
        path.parent.mkdir(exist_ok=True)
        names = (subject.replace("_", "-") for subject in draw)
        figures = {
            path.with_stem(name): [one] for name, one in zip(names, draw.values(), strict=True)
        }
        for file in figures:
            check_output(file, ())
    replaced = [str(file) for file in figures if file.exists()]
    with spinner("drawing"), named_by_run(_runs()):
        for file, subjects in figures.items():
            save(_drawn(subjects, height), file, dpi=_DPI)
    said = f"figure{'s' if len(figures) > 1 else ''}: {', '.join(map(str, figures))}"
    tell(said + (f"; replaced: {', '.join(replaced)}" if replaced else ""))
    return list(figures)


def _drawn(subjects: Sequence[Draw], height: float) -> Figure:
    """Return a figure of all subjects, in as many columns as keep it on a screen."""
    from matplotlib.figure import Figure

    columns = ceil(len(subjects) * height / (1.1 * _HEIGHT))
    rows = ceil(len(subjects) / columns)
    size = (_WIDTH * columns, min(height * rows, _HEIGHT))
    figure = Figure(figsize=size, layout="constrained")
    places = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, one in zip(places, subjects, strict=False):
        one(ax=ax)
    for ax in places[len(subjects) :]:
        ax.remove()
    return figure


def check_output(path: Path, inputs: Sequence[Path], suffix: str = "") -> None:
    """Refuse, before any work, a file that cannot be written, or must not: a recording is kept."""
    name = f"-o {path}" if suffix else str(path)
    if path.is_dir():
        example = path / ("report.pdf" if suffix else "timing.png")
        raise InputError(f"{name}: is a directory; give a file, such as {example}")
    if path.exists() and any(f.exists() and path.samefile(f) for f in inputs):
        raise InputError(
            f"{name}: is one of the files to read, which would be lost; give another name"
        )
    if path.is_file():
        with path.open("rb") as file:
            if file.read(len(_MCAP)) == _MCAP:
                raise InputError(f"{name}: is a recording, which would be lost; give another name")
    if suffix and path.suffix.lower() != suffix:
        raise InputError(f"{name}: a report is a PDF; give a name that ends in {suffix}")
    if not path.absolute().parent.is_dir():
        if path.parent.exists():
            msg = f"{name}: {path.parent} is a file; give a directory that is there"
        else:
            msg = f"{name}: there is no directory {path.parent}; make it first"
        raise InputError(msg)
