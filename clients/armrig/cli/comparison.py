"""The command that compares models: compare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armrig.cli.chosen_recording import File, OtherFile
from armrig.cli.figures import Plot, check_plot, write_plot
from armrig.cli.next_step import say_next, typed
from armrig.cli.options import (
    Json,
    Na,
    Nb,
    Nf,
    Nk,
    Verbose,
    echo,
    fields_of,
    inform,
    print_json,
    say,
    say_more,
)
from armrig.cli.parameters import Given, physics_beside
from armrig.cli.recorded_data import (
    SignalChoice,
    dataset_of,
    reads_part,
    spectral_beside,
    warn_of_estimation_data,
)
from armrig.cli.several_signals import compare as compare_several
from armrig.numerics.quantities import plural

if TYPE_CHECKING:
    from armrig_core.arm import ArmParameters

    from armrig.data.dataset import Dataset
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
    saved, several = _saved_models(model or [])
    if several:
        if saved or other is not None or given:
            raise typer.BadParameter(
                f"{model[0] if model else file}: models of several signals are compared with each "
                "other only, on one recording F"
            )
        compare_several(several, file, part, horizon, plot=plot, json=json)
        return
    recordings = part.recordings(*files)
    if other is None:
        data = dataset_of(recordings[0], saved[0][1])
        compared = _Compared(models=saved, data=data, where=typed(file))
    else:
        from armrig.physics.systems import HANDOUT

        compared = _studied(recordings, saved, na=na, nb=nb, nf=nf, nk=nk)
        changed.pop(HANDOUT, None)  # the handout's model is in the comparison already
    compared = _with_physics(compared, changed)
    table = _table(compared, horizon)
    _plot_comparison(compared, table, plot)
    if json:
        rows = [row_facts(row) for row in table.rows]
        print_json({"validation": compared.data.source, "models": rows})
    else:
        from armrig.recordings.usability import emulation

        print_comparison(table, f"on {compared.where}", verbose=verbose)
        for text in emulation(recordings):
            say(text, dim=True)
        say_next("compare", file=typed(file), given=part.options(compared.data))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Compared:
    """Models and the data of their comparison."""

    models: list[tuple[str, Fit]]
    """Pairs of name and model; several models may have the same name."""
    data: Dataset
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


def _saved_models(
    files: Sequence[Path],
) -> tuple[list[tuple[str, Fit]], list[tuple[str, Fit]]]:
    """Return the models of one output and one input, and the models of several signals."""
    from armrig.models.model_file import load_fit

    single: list[tuple[str, Fit]] = []
    several: list[tuple[str, Fit]] = []
    for path in files:
        fit = load_fit(path)
        if (fit.ny, fit.nu) != (1, 1):
            several.append((path.stem, fit))
        else:
            single.append((path.stem, fit))
    return single, several


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
    from armrig.physics.physical_model import physical_model

    more = [(name, physical_model(p, compared.data)) for name, p in changed.items()]
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
    beside = spectral_beside(data)
    with_spectral = [*names, *("spectral analysis, 95 %" for _ in beside)]
    write_plot(
        plot,
        compare=lambda ax: plot_compare(data, *fits, labels=names, table=table, ax=ax),
        bode=lambda ax: plot_bode(*fits, *beside, labels=with_spectral, ax=ax),
        step=lambda ax: plot_step(*fits, labels=names, ax=ax),
        poles=lambda ax: plot_poles_zeros(*fits, labels=names, ax=ax),
        height=4.2,
    )


def print_comparison(table: ComparisonTable, where: str, *, verbose: bool) -> None:
    """Print the closest model, the fit of each model, and the differences between the models.

    With `verbose`, also print the characteristics of the models, and the causes of the differences.
    """
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


def row_facts(row: Comparison) -> dict[str, Any]:
    """Return the row of a model, and the model's characteristic numbers, as JSON fields."""
    t = row.characteristics
    figures = {name: {"value": getattr(t, name), "std": std} for name, std in t.std.items()}
    poles = [[z.real, z.imag] for z in t.poles.tolist()]
    return {
        "model": row.name,
        **fields_of(row, "fit_percent rms_error velocity_fit_percent on_estimation_data"),
        "of_rate": t.integrating,
        "figures": figures,
        "poles": poles,
    }
