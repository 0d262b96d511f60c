"""The command that tests data for feedback and for a delay: check."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.errors import InputError

from armrig.cli.chosen_recording import DataFile
from armrig.cli.figures import Draw, Plot, check_plot, of_channel, write_plot
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
from armrig.cli.recorded_data import (
    Channel,
    SignalChoice,
    each_channel,
    from_recording,
    reads_data,
    source_facts,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.dataset import Dataset, Signals
    from armrig.validation.feedback_and_delay.delay_result import Delay
    from armrig.validation.feedback_and_delay.open_loop import OpenLoop

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
    """Test the data for feedback and a delay (handout 3.7, 3.8).

    With several signals, each pair of an input and an output is tested.
    """
    from armrig.cli.spinner import spinner
    from armrig.validation.feedback_and_delay.delay import delay
    from armrig.validation.feedback_and_delay.open_loop import open_loop, require_level

    check_plot(plot, [file])
    require_level(level)
    data = signals.of(file)
    integrator, taken = signals.integrator, list[str]()
    if signals.shape == (1, 1):
        integrates, taken = signals.choice(data)
        integrator = integrator if json else integrates  # the remarks then contain the reason
    with spinner("testing") as progress:
        loops = _tested(partial(open_loop, level=level), data)
        delays = _tested(partial(delay, integrator=integrator, progress=progress), data)
    channels = [name for name, _ in each_channel(data)]
    tests = {name: (loops[name], delays[name]) for name in channels}
    if all(isinstance(one, str) for found in tests.values() for one in found):
        raise InputError(str(loops[channels[0]]))
    write_plot(plot, height=3.6, **_drawn(tests))
    if json:
        print_json(source_facts(data) | _facts(tests))
        return
    of_rig = from_recording(data)
    for line in taken:
        say(line)
    for channel, found in tests.items():
        if channel:
            say(" to ".join(channel), bold=True)
        for which, number, one in zip(("open loop", "delay"), ("3.7", "3.8"), found, strict=True):
            where = f"{which} (handout {number})" if of_rig else which
            if isinstance(one, str):
                say(f"{where}: not known: {one}")
                continue
            first, *more = (one.explain() if verbose else one.brief()).splitlines()
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


def _tested(test: Callable[[Any], Any], data: Dataset | Signals) -> dict[Channel, Any]:
    """Return the result of a test for each channel, or the reason why there is no result."""
    columns = data.signals()
    if (columns.ny, columns.nu) == (1, 1):
        try:
            return {(): test(data)}
        except ValueError as err:
            return {(): str(err)}
    found = test(columns)
    every = {**found.results, **found.refused}
    return {(input, output): one for (output, input), one in every.items()}


def _drawn(tests: Mapping[Channel, tuple[Any, Any]]) -> dict[str, Draw]:
    """Return the functions that draw the results, by their names."""
    drawn: dict[str, Draw] = {}
    for channel, found in tests.items():
        for which, one in zip(("open_loop", "delay"), found, strict=True):
            if not isinstance(one, str):
                drawn |= of_channel(which, partial(_draw, one), channel)
    return drawn


def _draw(found: OpenLoop | Delay, ax: Axes) -> None:
    found.plot(ax=ax)


def _facts(tests: Mapping[Channel, tuple[Any, Any]]) -> dict[str, Any]:
    """Return the results as JSON fields; several channels have a list."""
    each = [
        dict(zip(("input", "output"), channel, strict=False))
        | {"open_loop": _loop_facts(loop), "delay": _delay_facts(late)}
        for channel, (loop, late) in tests.items()
    ]
    return each[0] if len(each) == 1 else {"channels": each}


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
