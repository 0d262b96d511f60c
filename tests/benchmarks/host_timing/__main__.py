"""`make timing`: this host's timing against the limit. `make timing ARGS=--help` says how."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from armrig.cli.figures import check_figure, check_output
from armrig_core.errors import ArmrigError
from rich.console import Console

from tests.benchmarks.host_timing.machine import machine
from tests.benchmarks.host_timing.results import Result, lines, write_figure
from tests.benchmarks.host_timing.rounds import Plan, measure


def main(
    seconds: Annotated[
        float, typer.Option("--seconds", help="For each contestant at each rate, over 4 rounds.")
    ] = 20.0,
    rates: Annotated[
        str, typer.Option("--rates", metavar="HZ,…", help="Sampling rates.")
    ] = "100,500,1000,2000",
    burn: Annotated[
        bool, typer.Option("--burn", help="Keep all processors busy beside everybody.")
    ] = False,
    json: Annotated[Path | None, typer.Option("--json", metavar="F", help="JSON to write.")] = None,
    plot: Annotated[
        Path | None, typer.Option("-o", "--plot", metavar="F", help="Figure to write.")
    ] = None,
) -> None:
    """Measure this host's timing against the limit.

    Daemon, cyclictest, bare loop and bare zenoh, in turn, in one run.

    The exit code says that all was measured, not that the targets are met.
    """
    for file in (json, plot):  # not after minutes of measuring
        if file is not None:
            check_output(file, [])
    if plot is not None:
        check_figure(plot)
    host = machine()
    plan = Plan(rates_hz=_rates(rates), seconds=seconds, burners=host.cpus if burn else 0)
    with Console(stderr=True).status("measuring") as status:
        result = Result(machine=host, plan=plan, rates=measure(plan, host, status.update))
    print("\n".join(lines(result)))
    if json is not None:
        json.write_bytes(msgspec.json.format(msgspec.json.encode(result.facts())))
    if plot is not None:
        write_figure(result, plot)


def _rates(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(rate) for rate in text.split(","))
    except ValueError as err:
        raise typer.BadParameter(
            f"--rates {text!r}: whole numbers of Hz with commas are wanted, such as 100,1000"
        ) from err


def run(arguments: list[str]) -> int:
    """Measure, or print the reason why not, and return the exit code."""
    app = typer.Typer(add_completion=False)
    app.command()(main)
    try:
        return app(arguments, standalone_mode=False) or 0  # 130 after Ctrl-C
    except (ArmrigError, typer.BadParameter) as err:
        print(f"host_timing: {err}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
