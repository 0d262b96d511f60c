"""The command that compares models: compare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armrig.cli.chosen_recording import File, OtherFile
from armrig.cli.figures import Draw, Plot, check_plot, write_plot
from armrig.cli.next_step import say_next, typed
from armrig.cli.options import (
    Json,
    Na,
    Nb,
    Nf,
    Nk,
    Verbose,
    echo,
    inform,
    print_json,
    say,
    say_more,
)
from armrig.cli.parameters import Given, physics_beside
from armrig.cli.recorded_data import (
    SignalChoice,
    reads_part,
    spectral_beside,
    warn_of_estimation_data,
)
from armrig.numerics.quantities import plural

if TYPE_CHECKING:
    from armrig_core.arm import ArmParameters

    from armrig.data.dataset import Dataset, Signals
    from armrig.models.fit import Fit
    from armrig.recordings.recording import Recording
    from armrig.validation.comparison import Comparison, ComparisonTable


_SAME_RTOL = 1e-6
_MAX_DIFFERENCES = 4
"""Largest number of differences without --verbose."""

Models = Annotated[
    list[Path] | None,
    typer.Option(
        "--model", metavar="JSON", help="Model file written by identify --save; repeatable."
    ),
]
Horizon = Annotated[
    int | None,
    typer.Option(
        "--horizon",
        min=1,
        help="Prediction horizon, in samples.",
        show_default="none: the models are simulated",
    ),
]


@reads_part
def compare(
    *,
    file: File,
    other: OtherFile = None,
    na: Na = 4,
    nb: Nb = 4,
    nf: Nf = 4,
    nk: Nk = 1,
    model: Models = None,
    horizon: Horizon = None,
    given: Given = None,
    part: SignalChoice,
    plot: Plot = None,
    json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Compare models on data that they were not estimated from.

    With F2, the command estimates an ARX and an OE model from F. On F2, it compares these two
    models, the physical model and the models of --model. Without F2, it compares the models of
    --model on F. --set adds a physical model with the given parameters.
    """
    changed = physics_beside(given) if given else {}
    if other is None and not model:
        raise typer.BadParameter(
            "give a second recording to validate with, or the models to compare, --model FILE "
            "(from `armrig identify --save FILE`)"
        )
    files = [file] if other is None else [file, other]
    check_plot(plot, [*files, *(model or [])])
    saved = _saved_models(model or [])
    _check_signals(saved, alone=other is None and not given)
    if other is None:
        data = part.recorded(file, saved[0][1])
        recordings = part.read
        compared = _Compared(models=saved, data=data, where=typed(file))
    else:
        from armrig.physics.systems import HANDOUT

        recordings = part.recordings(*files)
        compared = _studied(recordings, saved, na=na, nb=nb, nf=nf, nk=nk)
        changed.pop(HANDOUT, None)  # the handout's model is in the comparison already
    compared = _with_physics(compared, changed)
    table = _table(compared, horizon)
    _plot_comparison(compared, table, plot)
    if json:
        models = [row_facts(rows) for rows in table.models]
        print_json({"validation": compared.data.source, "models": models})
    else:
        from armrig.recordings.usability import emulation

        print_comparison(table, f"on {compared.where}", verbose=verbose)
        for text in emulation(recordings):
            say(text, dim=True)
        columns = compared.data.signals()
        channel = part.of_channel(columns.outputs[0], columns.inputs[0], compared.data)
        say_next("compare", file=typed(file), given=channel.options(compared.data))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Compared:
    """Models and the data of their comparison."""

    models: list[tuple[str, Fit]]
    """Pairs of name and model; several models may have the same name."""
    data: Dataset | Signals
    where: str
    """Name by which messages refer to the data."""

    @property
    def names(self) -> list[str]:
        """Names of the models."""
        return [name for name, _ in self.models]

    @property
    def fits(self) -> list[Fit]:
        """Models without their names."""
        return [fit for _, fit in self.models]


def _saved_models(files: Sequence[Path]) -> list[tuple[str, Fit]]:
    """Return the models with their names."""
    from armrig.models.model_file import load_fit

    return [(path.stem, load_fit(path)) for path in files]


def _check_signals(saved: Sequence[tuple[str, Fit]], *, alone: bool) -> None:
    """Refuse models of several signals with models of other signals; `alone`: only saved models."""
    shapes = {(fit.outputs, fit.inputs) for _, fit in saved}
    several = any((fit.ny, fit.nu) != (1, 1) for _, fit in saved)
    if several and (len(shapes) > 1 or not alone):
        raise typer.BadParameter(
            "--model: models of several signals are compared with models of the same signals only, "
            "on one recording F"
        )


def _studied(
    recordings: list[Recording],
    saved: list[tuple[str, Fit]],
    *,
    na: int,
    nb: int,
    nf: int,
    nk: int,
) -> _Compared:
    """Estimate ARX and OE models; return all models to compare, and the validation data."""
    from armrig.cli.spinner import estimating
    from armrig.report.study import Orders, study

    with estimating("na, nb and nf"):
        done = study(recordings, orders=Orders(na=na, nb=nb, nf=nf, nk=nk))
    where = typed(done.recording_of(done.validation.source).path)
    if done.halves:
        where += ", its second half (the models are estimated from its first half)"
    models = [(assessed.name, assessed.model) for assessed in done.models]
    more = []
    for name, fit in saved:
        same = next((n for n, m in models if _same(m, fit)), None)
        if same is None:
            more.append((name, fit))
        else:
            inform(f"the model {name} equals the {same} model estimated here; it is shown once")
    return _Compared(models=models + more, data=done.validation, where=where)


def _same(a: Fit, b: Fit) -> bool:
    """Return True if two models have the same polynomials, within 1e-6."""
    import numpy as np

    pairs = [(getattr(a, letter), getattr(b, letter)) for letter in "ABCDF"]
    return a.Ts == b.Ts and all(
        x.size == y.size and np.allclose(x, y, rtol=_SAME_RTOL, atol=0) for x, y in pairs
    )


def _with_physics(compared: _Compared, changed: dict[str, ArmParameters]) -> _Compared:
    """Return the comparison, with the physical models after the other models."""
    from armrig.physics.systems import physical_model

    data = compared.data.signals().dataset() if changed else None
    more = [(name, physical_model(p, data)) for name, p in changed.items() if data is not None]
    return replace(compared, models=[*compared.models, *more])


def _table(compared: _Compared, horizon: int | None) -> ComparisonTable:
    from armrig.validation.comparison import compare as comparison_of

    table = comparison_of(compared.data, *compared.fits, horizon=horizon, labels=compared.names)
    warn_of_estimation_data(table)
    return table


def _plot_comparison(compared: _Compared, table: ComparisonTable, plot: Path | None) -> None:
    if plot is None:
        return
    from armrig.plots import plot_bode, plot_compare, plot_poles_zeros, plot_step

    data, fits, names = compared.data, compared.fits, compared.names
    drawn: dict[str, Draw] = {
        "compare": lambda ax: plot_compare(data, *fits, labels=names, table=table, ax=ax)
    }
    if all((fit.ny, fit.nu) == (1, 1) for fit in fits):
        beside = spectral_beside(data.signals().dataset())
        with_spectral = [*names, *("spectral analysis, 95 %" for _ in beside)]
        drawn["bode"] = lambda ax: plot_bode(*fits, *beside, labels=with_spectral, ax=ax)
        drawn["step"] = lambda ax: plot_step(*fits, labels=names, ax=ax)
        drawn["poles"] = lambda ax: plot_poles_zeros(*fits, labels=names, ax=ax)
    write_plot(plot, height=4.2, **drawn)


def print_comparison(table: ComparisonTable, where: str, *, verbose: bool) -> None:
    """Print the closest model, the fit of each model, and the differences between the models.

    For several signals, print the best model of each output, and the fits.

    With `verbose`, also print the characteristics of the models, and the causes of the differences.
    """
    if any((row.model.ny, row.model.nu) != (1, 1) for row in table):
        from armrig.validation.answer import closest

        say(closest(table), bold=True)
        say(repr(table))
        return
    best, *differences = table.explain(brief=not verbose).splitlines()
    say(best, bold=True)
    how = "simulated" if table.horizon is None else f"predicted {table.horizon} samples ahead"
    say(f"{how} {where}", dim=True)
    say("\n".join(repr(table).splitlines()[1:]))
    if verbose:
        echo(table.table())
    left = [] if verbose else differences[_MAX_DIFFERENCES:]
    for text in differences[: len(differences) - len(left)]:
        say(text)
    if verbose:
        return
    more = [plural(len(left), "more difference")] if left else []
    say_more(", ".join([*more, "characteristics of the models, causes of the differences"]))


def row_facts(rows: Sequence[Comparison]) -> dict[str, Any]:
    """Return the errors of a model, and its characteristic numbers, as JSON fields."""
    from armrig.cli.model_output import error_facts

    facts = {"model": rows[0].name} | error_facts(rows)
    facts["on_estimation_data"] = rows[0].on_estimation_data
    if (rows[0].model.ny, rows[0].model.nu) != (1, 1):
        return facts
    t = rows[0].characteristics
    return facts | {
        "of_rate": t.integrating,
        "figures": {name: {"value": getattr(t, name), "std": std} for name, std in t.std.items()},
        "poles": [[z.real, z.imag] for z in t.poles.tolist()],
    }
