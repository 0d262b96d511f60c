"""The form of a command's result: text or JSON, a figure, and the next command."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from armrig.cli.figures import HEIGHT, WIDTH, Draw, Plot, check_plot, write_plot
from armrig.cli.options import Json, Verbose, group, print_json


@dataclass(frozen=True, slots=True, kw_only=True)
class Output:
    """Options of a command that choose the form of its result."""

    json: Json = False
    verbose: Verbose = False
    plot: Plot = None

    def check(self, *inputs: Path | None) -> None:
        """Refuse, before a command's work, a figure that cannot or must not be written."""
        check_plot(self.plot, [path for path in inputs if path is not None])

    def show(
        self,
        *,
        facts: Callable[[], Any],
        say: Callable[[], None],
        figures: Callable[[], Mapping[str, Draw]] = dict,
        say_next: Callable[[], None] | None = None,
        write: Callable[[], None] | None = None,
        width: float = WIDTH,
        height: float = HEIGHT,
    ) -> None:
        """Print a result as text or JSON, write its files, and print the next command.

        Parameters
        ----------
        facts : callable
            Return the result as a value for JSON.
        say : callable
            Print the result as text.
        figures : callable
            Return the functions that draw the result, by the names of the diagrams.
        say_next : callable, optional
            Print the next command, after the text.
        write : callable, optional
            Write other files than the figure.
        width, height : float
            Size of each diagram, in inches.
        """
        if self.json:
            print_json(facts())
        else:
            say()
        if write is not None:
            write()
        if self.plot is not None:
            write_plot(self.plot, width, height=height, **figures())
        if say_next is not None and not self.json:
            say_next()


Shown = Annotated[Output, group(Output)]
"""Options --json, --verbose and -o."""
ShownFigure = Annotated[Output, group(Output, ("plot", "json", "verbose"))]
"""The same options in another order of the help."""
