"""Results of commands: text or JSON, figures, and the next command."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from math import ceil, lcm
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from armrig_core.errors import InputError
from armrig_core.process.options import Group, group, option

import armrig
from armrig.cli.options import Json, Verbose
from armrig.cli.printing import inform, print_json, spinner, tell
from armrig.cli.printing import say as say_line

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

T = TypeVar("T")
Draw = Callable[..., Any]
"""Function that draws into its argument `ax`."""
_EACH = "*"  # placeholder for the subject in the names of files in a folder
HEIGHT = 3.6
"""Height of a diagram, in inches."""
WIDTH = 6.3
"""Width of the text of an A4 page, in inches."""
CHANNEL_WIDTH = 4.5
"""Width of the frequency response of one of several channels, in inches."""
_HEIGHT = 8.0  # in inches, of a screen
_DPI = 200
_RUNS: dict[str, str] = {}
"""Name or run id of each recording that the command read, by the recording's hash."""
_ESTIMATION: dict[Path, str] = {}
"""Names of estimation recordings, by path; validation recordings that were read name them."""
_MCAP = b"\x89MCAP0\r\n"


def name_runs(*recordings: armrig.Recording) -> None:
    """Store the names of recordings; figures of the command show these names, as `armrig ls` does.

    The name of a recording outside the recording folder is the id of its run. For a validation
    recording, the name of the estimation recording is also stored if it is in the same folder.
    """
    for r in recordings:
        _RUNS[r.sha256] = _run_label(r.path, r.manifest.run_id)
        estimation_id = str(r.manifest.details.get("validation_of", ""))
        if estimation_id.isalnum():
            paths = r.path.parent.glob(f"*-{estimation_id}.mcap")
            _ESTIMATION.update((path, _run_label(path, estimation_id)) for path in paths)


def _run_label(path: Path, run_id: str) -> str:
    from armrig.recordings.files.recording_names import name_of

    return name_of(path).removeprefix("@") or run_id


def _runs() -> dict[str, str]:
    """Return the name of each recording by the recording's hash; figures show these names."""
    from hashlib import file_digest

    runs = dict(_RUNS)
    for path, name in _ESTIMATION.items():
        with suppress(OSError), path.open("rb") as file:
            runs[file_digest(file, "sha256").hexdigest()] = name
    return runs


def figure_path(text: str | Path) -> Path:
    """Return the path of a figure: FOLDER/*.png for a folder or a text that ends with "/"."""
    path = Path(text)
    return path / f"{_EACH}.png" if str(text).endswith("/") or path.is_dir() else path


Plot = Annotated[
    Path | None,
    option(
        "-o --plot FIGURE",
        "Figure to write, such as a .png, .pdf or .svg; FOLDER/ gets a .png of each diagram.",
        parser=figure_path,
    ),
]


def check_plot(path: Path | None, inputs: Sequence[Path] = ()) -> None:
    """Refuse, before a command's work, a figure that cannot or must not be written."""
    if path is None:
        return
    folder = path.parent
    if path.stem != _EACH:
        check_output(path, inputs)
    elif folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}/: is a file; give a folder, or leave out the /")
    elif not folder.is_dir():
        check_output(folder, ())
    from matplotlib.figure import Figure

    kinds = Figure().canvas.get_supported_filetypes()
    if path.suffix.lower().removeprefix(".") not in kinds:
        raise InputError(f"{path}: the name of a figure ends in one of {', '.join(sorted(kinds))}")


def write_plot(
    path: Path | None,
    width: float = WIDTH,
    /,
    *,
    height: float = HEIGHT,
    columns: int | None = None,
    **draw: Draw,
) -> list[Path]:
    """Write a figure with axes for each subject, print its path, and return the files.

    The path is from `figure_path`; in a folder, each subject has its own file. An existing figure
    is replaced, and a message names it. `draw` are the functions that draw a subject into `ax`, by
    the subject's name. The axes of a subject have a width and a height in inches. By default the
    figure has enough columns to fit on a screen.
    """
    from armrig.plots.captions import name_by_run

    if path is None:
        return []
    if not draw:
        tell(f"{path}: not written, because there is nothing to draw; the text gives the values")
        return []
    from armrig.plots.layout import save

    figures = {path: list(draw.values())}
    if path.stem == _EACH:
        path.parent.mkdir(exist_ok=True)
        names = (subject.replace("_", "-") for subject in draw)
        figures = {
            path.with_stem(name): [function]
            for name, function in zip(names, draw.values(), strict=True)
        }
        for file in figures:
            check_output(file, ())
    replaced = [str(file) for file in figures if file.exists()]
    with spinner("drawing"), name_by_run(_runs()):
        for file, subjects in figures.items():
            save(_draw_figure(subjects, height, width, columns), file, dpi=_DPI)
    message = f"figure{'s' if len(figures) > 1 else ''}: {', '.join(map(str, figures))}"
    inform(message + (f"; replaced: {', '.join(replaced)}" if replaced else ""), dim=True)
    return list(figures)


def _draw_figure(
    subjects: Sequence[Draw], height: float, width: float, columns: int | None = None
) -> Figure:
    """Return a figure of all subjects; fewer subjects in the first row share its whole width."""
    from matplotlib.figure import Figure

    limit = _HEIGHT if columns is None else float("inf")
    columns = columns or ceil(len(subjects) * height / (1.1 * _HEIGHT))
    rows = ceil(len(subjects) / columns)
    size = (width * min(columns, len(subjects)), min(height * rows, limit))
    figure = Figure(figsize=size, layout="constrained")
    first = len(subjects) - columns * (rows - 1)
    cells = lcm(first, columns)
    grid = figure.add_gridspec(rows, cells)
    places = []
    for k in range(len(subjects)):
        row, column = (0, k) if k < first else divmod(k - first + columns, columns)
        n = cells // (columns if row else first)
        places.append(figure.add_subplot(grid[row, n * column : n * (column + 1)]))
    for ax, draw in zip(places, subjects, strict=True):
        draw(ax=ax)
    return figure


def figures_by_channel(
    outcomes: Mapping[tuple[str, ...], T], figures: Callable[[T], Mapping[str, Draw]]
) -> dict[str, Draw]:
    """Return the functions that draw each channel's result; panels show the channel's name."""
    drawn: dict[str, Draw] = {}
    for channel, outcome in outcomes.items():
        name = " to ".join(channel)
        for subject, draw in figures(outcome).items():
            key = "_".join([subject, *name.split()])
            drawn[key] = partial(_draw_with_name, name, draw) if channel else draw
    return drawn


def _draw_with_name(name: str, draw: Draw, *, ax: Axes) -> None:
    from armrig.plots.layout import drawable

    draw(ax=ax)
    backed = {"fc": "white", "lw": 0, "alpha": 0.7, "pad": 1}
    ax.text(0.99, 0.95, drawable(name), transform=ax.transAxes, ha="right", va="top", bbox=backed)


def check_output(
    path: Path, inputs: Sequence[Path], option: str = "", what: str = "", suffix: str = ""
) -> None:
    """Refuse, before a command's work, an output that cannot be written or would replace data.

    An error names the `option` of the output. If there is a `suffix`, the error for another suffix
    says `what` the file contains.
    """
    name = f"{option} {path}".strip()
    if path.is_dir():
        example = path / f"name{suffix or '.png'}"
        raise InputError(f"{name}: is a directory; give a file, such as {example}")
    if path.exists() and any(f.exists() and path.samefile(f) for f in inputs):
        raise InputError(f"{name}: is an input file, which would be overwritten; give another name")
    if path.is_file():
        with path.open("rb") as file:
            if file.read(len(_MCAP)) == _MCAP:
                text = "is a recording, which would be overwritten; give another name"
                raise InputError(f"{name}: {text}")
    if suffix and path.suffix.lower() != suffix:
        raise InputError(f"{name}: {what}; give a name that ends in {suffix}")
    if not path.absolute().parent.is_dir():
        if path.parent.exists():
            msg = f"{name}: {path.parent} is a file; give an existing directory"
        else:
            msg = f"{name}: there is no directory {path.parent}; create it first"
        raise InputError(msg)


@contextmanager
def whole_file(out: Path) -> Iterator[None]:
    """Delete the output file if an error interrupts its writing."""
    try:
        yield
    except BaseException as err:
        if out.is_file():
            with suppress(OSError):
                out.unlink()
        if isinstance(err, OSError) and not err.filename:  # the error of a write names no file
            raise OSError(err.errno, err.strerror or str(err), str(out)) from err
        raise


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputOptions:
    """Options of a command that choose the form of its result."""

    json: Json = False
    verbose: Verbose = False
    plot: Plot = None

    def show(
        self,
        *,
        facts: Callable[[], Any],
        say: Callable[[], None],
        taken: Sequence[str] = (),
        figures: Callable[[], Mapping[str, Draw]] = dict,
        say_next: Callable[[], None] | None = None,
        write: Callable[[], None] | None = None,
        width: float = WIDTH,
        height: float = HEIGHT,
        columns: int | None = None,
    ) -> None:
        """Print a result as text or JSON, write its files, and print the next command.

        `facts` returns the value for JSON, and `say` prints the text after the lines `taken`, which
        say how the data were taken. `figures` returns the functions that draw the diagrams, by
        name; each diagram has a width and a height in inches. By default the figure has enough
        columns to fit on a screen. `write` writes other files. `say_next` prints the next command
        after a text.
        """
        if self.json:
            print_json(facts())
        else:
            for line in taken:
                say_line(line)
            say()
        if write is not None:
            write()
        if self.plot is not None:
            write_plot(self.plot, width, height=height, columns=columns, **figures())
        if say_next is not None and not self.json:
            say_next()


def output_group(*names: str) -> Group:
    """Return options of `OutputOptions` in the order of the help; the figure is checked first."""
    return group(OutputOptions, names, check=lambda out, inputs: check_plot(out.plot, inputs))


Shown = Annotated[OutputOptions, output_group("json", "verbose", "plot")]
"""Options --json, --verbose and -o."""
ShownFigure = Annotated[OutputOptions, output_group("plot", "json", "verbose")]
"""The same options in another order of the help."""
