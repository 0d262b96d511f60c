"""Printing: text, JSON and tables; on standard error messages, questions, and a spinner."""

from __future__ import annotations

import os
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread, Timer
from time import monotonic
from typing import TYPE_CHECKING, Any, TextIO

import typer
from armrig_core.errors import OperationError
from armrig_core.process.journal import log_prefix
from armrig_core.process.printable import brief, json_printable, printable, with_degrees

if TYPE_CHECKING:
    from rich.console import Console

MIN_WAIT_S = 1.0
"""Shortest wait that shows a spinner, in s."""
PROGRESS_INTERVAL_S = 4.0
"""Time between two lines of progress in a pipe, in s."""

Count = Callable[[int, int, str], None]
"""Function of the number of finished items, the number of all items, and the next item's name."""
_ANSWER_WIDTH = 16  # characters for the default and the answer after a question
_NO_BREAK_SPACE = "\u00a0"


def tell(message: str) -> None:
    """Print a warning or an error on standard error."""
    inform(f"armrig: {message}")


def tell_findings(findings: Iterable[Any]) -> None:
    """Print each finding as a warning."""
    for finding in findings:
        tell(finding.text)


def inform(message: str, **style: bool) -> None:
    """Print news for the user on standard error, as a single line, in a style of `say`."""
    with suppress(OSError):  # the terminal may be closed
        line = fold(_for_terminal(brief(" ".join(message.split()))), _columns(sys.stderr))
        typer.echo(_style_text(line, sys.stderr, style), err=True)


def tell_error(message: str) -> None:
    """Print a line for the user on standard error; systemd's journal shows the line as an error."""
    with suppress(OSError):
        print(log_prefix("error") or "", end="", file=sys.stderr)
    tell(message)


def say(text: str, **style: bool) -> None:
    """Print text on standard output; on a terminal, lines are folded between words.

    A terminal shows the text in a style, such as `bold=True` or `dim=True`.
    """
    text = _for_terminal(fold(text, _columns(sys.stdout)), keep="\n")
    typer.echo(_style_text(text, sys.stdout, style))


def say_answer(text: str) -> None:
    """Print text as `say` does; the first line, which contains the verdict, is bold."""
    first, _, details = text.partition("\n")
    say(first, bold=True)
    if details:
        say(details)


def say_more(contents: str) -> None:
    """Print what --verbose adds to the output."""
    say(f"--verbose: {contents}", dim=True)


def takes_styles() -> bool:
    """Return True if the user accepts bold and dim text (https://no-color.org)."""
    return not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def _style_text(text: str, stream: TextIO, style: dict[str, bool]) -> str:
    """Return the text in a style if the stream is a terminal; otherwise return it unchanged."""
    return typer.style(text, **style) if style and stream.isatty() and takes_styles() else text


def echo(text: str) -> None:
    """Print text on standard output with unprintable characters escaped.

    The text may contain parts from other users or from files of unknown origin. All output
    therefore uses this function, `print_json` or `print_table`.
    """
    typer.echo(_for_terminal(text, keep="\n"))


def _for_terminal(text: str, keep: str = "") -> str:
    """Return the text for a terminal, with ordinary blanks between numbers and units."""
    return printable(with_degrees(text).replace(_NO_BREAK_SPACE, " "), keep)


def question(text: str) -> str:
    """Return a question, folded into lines; the last line leaves room for the answer."""
    columns = _columns(sys.stderr)
    return fold(text, columns - _ANSWER_WIDTH, indent=0) if columns > 2 * _ANSWER_WIDTH else text


def agree(text: str, *, yes: bool) -> None:
    """Ask the user for agreement, unless `yes` is True; raise OperationError without agreement."""
    if yes:
        return
    if not sys.stdin.isatty():
        raise OperationError(
            "there is no terminal for the question: --yes agrees, --dry-run only shows the plan"
        )
    if not typer.confirm(question(text), err=True):
        raise OperationError("nothing was done")


def fold(text: str, columns: int, indent: int | None = None) -> str:
    """Return the text with lines of at most `columns` characters, broken at blanks.

    A width of 0 leaves the text as it is. The indent of continuation lines is by default two more
    than the line's own indent.
    """
    if not columns:
        return text
    lines = []
    for line in text.splitlines():
        line_indent = len(line) - len(line.lstrip())
        next_indent = min(line_indent + 2 if indent is None else indent, columns // 2)
        lines += textwrap.wrap(
            line,
            columns,
            subsequent_indent=" " * next_indent,
            break_long_words=False,
            break_on_hyphens=False,
        ) or [""]
    return "\n".join(lines)


def _columns(stream: TextIO) -> int:
    """Return the width of the terminal; 0 if the stream is not a terminal."""
    try:
        return os.get_terminal_size(stream.fileno()).columns if stream.isatty() else 0
    except (OSError, ValueError):
        return 0


def some(names: Sequence[str], most: int) -> str:
    """Return the first `most` names as text, and the number of the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def fields_of(value: Any, names: str) -> dict[str, Any]:
    """Return attributes of a value as JSON fields; blanks separate the names."""
    return {name: getattr(value, name) for name in names.split()}


def print_json(value: Any) -> None:
    """Print a value as a line of JSON; a complex number is its two parts, a path is a text."""
    import msgspec

    try:
        text = msgspec.json.encode(value, enc_hook=_plain)
    except UnicodeEncodeError:  # the name of a file need not be valid text
        text = msgspec.json.encode(_as_text(msgspec.to_builtins(value, enc_hook=_plain)))
    typer.echo(json_printable(text.decode()))


def _plain(value: Any) -> Any:
    match value:
        case complex():
            return [value.real, value.imag]
        case Path():
            return str(value)
    return value.tolist()


def _as_text(value: Any) -> Any:
    """Return the value with invalid text escaped."""
    match value:
        case str():
            return value.encode("utf-8", "backslashreplace").decode()
        case dict():
            return {_as_text(key): _as_text(item) for key, item in value.items()}
        case list():
            return [_as_text(item) for item in value]
    return value


def print_result(facts: Any, *lines: str, json: bool) -> None:
    """Print the facts of a result as JSON, or its lines of text for a person."""
    if json:
        print_json(facts)
    elif lines:
        say("\n".join(lines))


def columns(rows: Sequence[Sequence[str]], most: int | None = None, *, gap: str = "  ") -> str:
    """Return rows of cells as text in columns.

    A column is as wide as its longest cell, but at most `most`; a longer cell is not cut.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    widths = [min(width, most or width) for width in widths]
    return "\n".join(
        gap.join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


def print_table(*rows: tuple[str, str], verdict: bool = False) -> None:
    """Print each value in a line of its own, after its name; a verdict in the first row is bold."""
    width = max(len(name) for name, _ in rows)
    columns = _columns(sys.stdout)
    for i, (name, value) in enumerate(rows):
        line = fold(_for_terminal(f"{name:{width}}  {value}"), columns, indent=width + 2)
        typer.echo(_style_text(line, sys.stdout, {"bold": True} if verdict and not i else {}))


def report_damage(recording: Any) -> Any:
    """Return the recording, and print its damage."""
    if recording.truncated:
        unfinished = recording.path.suffix == ".active"
        why = "still being recorded, or the daemon was killed; " if unfinished else ""
        name = recording.name if recording.name.startswith("@") else recording.path
        tell(f"{name}: {why}{recording.damage}")
    return recording


@contextmanager
def estimating(orders: str) -> Iterator[Count]:
    """Show a spinner during an estimation, and suppress the warnings of libraries.

    If a matrix cannot be decomposed, the InputError names the `orders`, which may be too high.
    """
    import numpy as np

    with (
        spinner("estimating") as count,
        np.errstate(all="ignore"),
        warnings.catch_warnings(),
    ):
        # The search itself handles overflows.
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            yield count
        except np.linalg.LinAlgError as err:
            from armrig.estimation.request import too_high

            raise too_high(orders) from err


@contextmanager
def spinner(
    activity: str, console: Console | None = None, after_s: float = MIN_WAIT_S
) -> Iterator[Count]:
    """Show a spinner after `after_s` if standard error is a terminal.

    The yielded function replaces the spinner with a bar that shows the item, the number of
    remaining items, and the time left. Without a terminal, a line every few seconds shows them.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

    console = console or Console(stderr=True)
    if not console.is_terminal:
        with _progress_lines(activity) as tell_count:
            yield tell_count
        return
    waiting = SpinnerColumn(), TextColumn("{task.description} …", markup=False)
    progress = Progress(*waiting, console=console, transient=True)
    task = progress.add_task(activity, total=None, left="")
    begun = monotonic()

    def count(done: int, total: int, name: str) -> None:
        progress.columns = (
            *waiting,
            BarColumn(30),
            TextColumn("{task.fields[left]}", markup=False),
        )
        left = remaining(done, total, monotonic() - begun)
        doing = f"{activity} {printable(name)}" if name else activity
        progress.update(task, completed=done, total=total, description=doing, left=left)

    timer = Timer(after_s, progress.start)
    timer.daemon = True
    timer.start()
    try:
        yield count
    finally:
        timer.cancel()
        timer.join()
        if progress.live.is_started:  # otherwise a dumb terminal would print an empty line
            progress.stop()


@contextmanager
def _progress_lines(activity: str) -> Iterator[Count]:
    """Print a line with the progress every `PROGRESS_INTERVAL_S`, once an item is counted."""
    begun, ended, line = monotonic(), Event(), ""

    def report() -> None:
        while not ended.wait(PROGRESS_INTERVAL_S):
            inform(line)

    thread = Thread(target=report, daemon=True)

    def count(done: int, total: int, name: str) -> None:
        nonlocal line
        line = f"{activity} {name}: {remaining(done, total, monotonic() - begun)}"
        if not thread.ident:
            thread.start()

    try:
        yield count
    finally:
        ended.set()
        if thread.ident:
            thread.join()


def remaining(done: int, total: int, elapsed_s: float) -> str:
    """Return number, rate and time left as text, such as: 12 of 40 remain, 3.5/s, about 8 s."""
    told = f"{total - done} of {total} remain"
    if not 0 < done < total:
        return told
    from armrig.numerics.quantities import digits

    left_s = elapsed_s / done * (total - done)
    told += f", {digits(done / elapsed_s, 2)}/s, about "
    return told + (f"{left_s:.0f} s" if left_s < 100 else f"{left_s / 60:.0f} min")
