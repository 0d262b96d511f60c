"""The commands that judge models on a recording: validate, compare."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import typer

from armrig.cli.comparison_rows import row_facts
from armrig.cli.figures import Plot, check_plot, write_plot
from armrig.cli.options import (
    SAME_DATA,
    CalibrationFile,
    File,
    Json,
    Na,
    Nb,
    Nf,
    Nk,
    echo,
    print_json,
    tell,
    warned,
)

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset
    from armrig.models.model import Model
    from armrig.models.spectral_estimate import SpectralEstimate
    from armrig.recordings.recording import Recording
    from armrig.validation.comparison import Comparison

Output = Literal["theta_1", "alpha", "velocity"]
Models = Annotated[
    list[Path] | None,
    typer.Option("--model", metavar="JSON", help="Model that identify --save has written."),
]


def validate(
    file: File,
    model: Annotated[
        Path,
        typer.Option("--model", metavar="JSON", help="Model that identify --save has written."),
    ],
    horizon: Annotated[
        list[int] | None,
        typer.Option(
            "--horizon", min=1, help="Samples ahead to predict; repeatable.", show_default="1 10"
        ),
    ] = None,
    lags: Annotated[
        int | None,
        typer.Option("--lags", min=1, help="Of the residual tests.", show_default="25"),
    ] = None,
    calibration: CalibrationFile = None,
    plot: Plot = None,
    json: Json = False,
) -> None:
    """Test a model on a recording.

    Simulation, prediction, and what its residuals still hold.
    """
    from armrig.cli import model_output
    from armrig.cli.waiting import estimating
    from armrig.models.equation import heading
    from armrig.models.model_file import load_fit
    from armrig.recordings.loading import load
    from armrig.validation.comparison import compare as compared
    from armrig.validation.residuals import residuals

    check_plot(plot, [file, model])
    fit = load_fit(model)
    data = _dataset(warned(load(file, calibration)), fit)
    with estimating("the orders"):
        tables = [compared(data, fit, horizon=h) for h in (None, *(horizon or (1, 10)))]
        tests = residuals(fit, data, lags)
    if tables[0][0].on_estimation_data:
        tell(SAME_DATA)
    if plot is not None:
        from armrig.plots import plot_bode, plot_compare, plot_poles_zeros, plot_residuals

        beside = _spectral(data)
        write_plot(
            plot,
            lambda ax: plot_compare(data, fit, table=tables[0], ax=ax),
            lambda ax: plot_residuals(fit, data, lags=lags, ax=ax),
            lambda ax: plot_bode(fit, *beside, ax=ax),
            lambda ax: plot_poles_zeros(fit, ax=ax),
        )
    if json:
        facts = model_output.facts_of_tests(data, tables[0][0], tests)
        facts["ahead"] = [
            {"horizon": t.horizon, "fit_percent": t[0].fit_percent, "rms_error": t[0].rms_error}
            for t in tables[1:]
        ]
        print_json({"model": str(model), "identified_from": fit.source} | facts)
        return
    echo(f"{heading(fit)}\nvalidated on {file} (recording {data.source[:12]})")
    for table in tables:
        ahead = "simulated" if table.horizon is None else f"{table.horizon} ahead"
        echo(_row(f"{ahead:10}", table[0], table.unit))
    echo(f"  {tables[0].note}")
    echo("\n".join(model_output.of_tests(tests)))


def compare(
    file: File,
    other: Annotated[
        Path | None,
        typer.Argument(metavar="F2", help="Recording to validate with.", show_default=False),
    ] = None,
    na: Na = 4,
    nb: Nb = 4,
    nf: Nf = 4,
    nk: Nk = 1,
    model: Models = None,
    horizon: Annotated[
        int | None,
        typer.Option("--horizon", min=1, help="Samples ahead.", show_default="simulation"),
    ] = None,
    calibration: CalibrationFile = None,
    plot: Plot = None,
    json: Json = False,
) -> None:
    """Compare models on a recording that they never saw.

    Identify ARX and OE from F and compare them, the physics and those of --model on F2; without
    F2 compare those of --model on F.
    """
    from armrig.models.model_file import load_fit
    from armrig.recordings.loading import load
    from armrig.validation.comparison import compare as compared

    if other is None and not model:
        msg = "give a second recording to validate with, or the models to compare, --model FILE "
        msg += "(from `armrig identify --save FILE`)"
        raise typer.BadParameter(msg)
    files = [file] if other is None else [file, other]
    check_plot(plot, [*files, *(model or [])])
    named: list[tuple[str, Model]] = [(path.stem, load_fit(path)) for path in model or []]
    recordings = [warned(load(f, calibration)) for f in files]
    where = str(files[-1])
    if other is None:
        data = _dataset(recordings[0], named[0][1])
    else:
        done, where = _studied(recordings, na=na, nb=nb, nf=nf, nk=nk)
        data = done.validation
        named = [(assessed.name, assessed.model) for assessed in done.models] + named
    names = [name for name, _ in named]
    table = compared(data, *(fit for _, fit in named), horizon=horizon, labels=names)
    if any(row.on_estimation_data for row in table.rows):
        tell(SAME_DATA)
    if plot is not None:
        from armrig.plots import plot_bode, plot_compare, plot_poles_zeros, plot_step

        fits = [fit for _, fit in named]
        beside = _spectral(data)
        words = [*names, *("spectral analysis, 95 %" for _ in beside)]
        write_plot(
            plot,
            lambda ax: plot_compare(data, *fits, labels=names, table=table, ax=ax),
            lambda ax: plot_bode(*fits, *beside, labels=words, ax=ax),
            lambda ax: plot_step(*fits, labels=names, ax=ax),
            lambda ax: plot_poles_zeros(*fits, labels=names, ax=ax),
            height=4.2,
        )
    if json:
        print_json({"validation": data.source, "models": [row_facts(row) for row in table.rows]})
        return
    what = "simulated" if horizon is None else f"predicted {horizon} samples ahead"
    echo(f"{what} on {where} (recording {data.source[:12]})")
    width = max(8, *(len(name) for name in names))
    for row in table.rows:
        echo(_row(f"{row.name:{width}}", row, table.unit))
    echo(f"{table.table()}\n{table.explain()}")


def _studied(recordings: list[Recording], *, na: int, nb: int, nf: int, nk: int) -> tuple[Any, str]:
    """Return ARX, OE and the physics on the second recording, and in words where that is."""
    from armrig.cli.waiting import estimating
    from armrig.report.study import Orders, study

    with estimating("na, nb and nf"):
        done = study(recordings, orders=Orders(na=na, nb=nb, nf=nf, nk=nk))
    where = str(done.recording_of(done.validation.source).path)
    where += ", its second half, the first one estimates" if done.halves else ""
    return done, where


def _spectral(data: Dataset) -> list[SpectralEstimate]:
    """Return what the data themselves say of the frequency response, if they say anything."""
    from armrig.nonparametric.spectral_reference import spectral_reference

    try:
        return [spectral_reference(data)]
    except ValueError as err:
        tell(f"no spectral analysis beside the model: {err}")
        return []


def _dataset(recording: Recording, model: Model) -> Any:
    """Return the data of the output that the model is of."""
    for output in get_args(Output):
        if output == model.output:
            return recording.dataset(output)
    msg = f"the model is of {model.output!r}, a recording has {', '.join(get_args(Output))}"
    raise ValueError(msg)


def _row(name: str, row: Comparison, unit: str) -> str:
    velocity = row.velocity_fit_percent
    return (
        f"  {name} fit {row.fit_percent:7.2f} %  rms {row.rms_error:.4g} {unit}".rstrip()
        + (f"  velocity fit {velocity:7.2f} %" if velocity is not None else "")
        + ("  (estimation data)" if row.on_estimation_data else "")
    )
