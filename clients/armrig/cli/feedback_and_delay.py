"""The command that tests data for feedback and for a delay: check."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from armrig_core.errors import InputError

from armrig.cli.chosen_recording import DataFile
from armrig.cli.figures import Plot, check_plot, write_plot
from armrig.cli.next_step import chassis, kind_of, say_next, typed
from armrig.cli.options import (
    Json,
    Verbose,
    fields_of,
    inform,
    print_json,
    say,
    say_answer,
)
from armrig.cli.recorded_data import SignalChoice, from_recording, reads_data, source_facts

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.dataset import Dataset
    from armrig.validation.feedback_and_delay.delay_result import Delay
    from armrig.validation.feedback_and_delay.open_loop import OpenLoop

T = TypeVar("T")
_CHASSIS = (
    "handout 3.5 and 3.6 need a complete recording of the chassis alone: remove the arm, write "
    "chassis.toml with [arm] removed = true (docs/tutorial.md, part 9), and end `armrig lab`"
)


@reads_data()
def check(
    file: DataFile,
    signals: SignalChoice,
    level: Annotated[
        float, typer.Option("--level", help="Significance level of the test for feedback.")
    ] = 0.05,
    json: Json = False,
    verbose: Verbose = False,
    plot: Plot = None,
) -> None:
    """Test the data for feedback and a delay (handout 3.7, 3.8)."""
    from armrig.cli.spinner import spinner
    from armrig.validation.feedback_and_delay.delay import delay
    from armrig.validation.feedback_and_delay.open_loop import open_loop, require_level

    check_plot(plot, [file])
    require_level(level)
    data = signals.of(file)
    integrates, taken = signals.choice(data)
    integrator = signals.integrator if json else integrates  # the remarks then contain the reason
    with spinner("testing") as progress:
        loop = _tested(partial(open_loop, level=level), data)
        late = _tested(partial(delay, integrator=integrator, progress=progress), data)
    if isinstance(loop, str) and isinstance(late, str):
        raise InputError(loop)
    drawn = {"open_loop": loop, "delay": late}
    shown = {k: partial(_draw, one) for k, one in drawn.items() if not isinstance(one, str)}
    write_plot(plot, height=3.6, **shown)
    if json:
        print_json(
            source_facts(data) | {"open_loop": _loop_facts(loop), "delay": _delay_facts(late)}
        )
        return
    of_rig = from_recording(data)
    for line in taken:
        say(line)
    for which, number, found in (("open loop", "3.7", loop), ("delay", "3.8", late)):
        where = f"{which} (handout {number})" if of_rig else which
        if isinstance(found, str):
            say(f"{where}: not known: {found}")
            continue
        first, *more = (found.explain() if verbose else found.brief()).splitlines()
        verdict = first.removeprefix("open loop: ")
        say_answer("\n".join([f"{where}: {verdict}", *(f"  {line}" for line in more)]))
    _say_next(file, signals, of_rig=of_rig)


def _say_next(file: Path, signals: SignalChoice, *, of_rig: bool) -> None:
    """Print the next command; after a recording of the whole rig, it is for the chassis alone."""
    if not of_rig:
        say_next("check other", file=typed(file), given=signals.options())
    elif kind_of(file) == "greybox":
        say_next("check greybox")
    elif recorded := chassis():
        say_next("check with chassis", chassis=recorded)
    else:
        inform(_CHASSIS)
        say_next("check")


def _tested(test: Callable[[Dataset], T], data: Dataset) -> T | str:
    """Return the result of a test, or the reason why the test has no result."""
    try:
        return test(data)
    except ValueError as err:
        return str(err)


def _draw(found: OpenLoop | Delay, ax: Axes) -> None:
    found.plot(ax=ax)


def _loop_facts(loop: OpenLoop | str) -> dict[str, Any]:
    if isinstance(loop, str):
        return {"feedback": None, "p_value": None, "level": None, "lags": None, "remarks": [loop]}
    return {
        "feedback": loop.feedback,
        "p_value": loop.p_value,
        "level": loop.level,
        "lags": None if loop.sims is None else loop.sims.p,
        "remarks": loop.remarks,
    }


def _delay_facts(late: Delay | str) -> dict[str, Any]:
    if isinstance(late, str):
        return {"nk": None, "told": False, "remarks": [late]}
    of = "interval integrator level p_values before misfit t_q remarks"
    return fields_of(late, "nk delay") | {"told": late.told} | fields_of(late, of)
