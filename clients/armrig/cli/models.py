"""The commands that estimate models: identify, compare."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from armrig.cli.options import SAME_DATA, File, Json, Na, Nb, Nf, Nk, print_json, tell, warned

if TYPE_CHECKING:
    from armrig.fit import Fit

# None says that the option was not given: what does not apply is refused, not ignored.
NaOrNone = Annotated[
    int | None, typer.Option("--na", help="Number of a's (ARX only).", show_default="4")
]
NfOrNone = Annotated[
    int | None,
    typer.Option(
        "--nf", help="Number of f's (OE only), the integrator's included.", show_default="4"
    ),
]
Output = Annotated[
    Literal["theta_1", "alpha", "velocity"], typer.Option("--output", help="Which output.")
]
Structure = Literal["arx", "oe"]


def identify(
    file: File,
    structure: Annotated[Structure, typer.Option("--structure", help="Which model.")],
    na: NaOrNone = None,
    nb: Nb = 4,
    nf: NfOrNone = None,
    nk: Nk = 1,
    integrator: Annotated[
        bool, typer.Option("--integrator", help="OE: one root of F is 1 exactly.")
    ] = False,
    validate: Annotated[
        Path | None, typer.Option("--validate", metavar="F2", help="Recording to validate with.")
    ] = None,
    output: Output = "theta_1",
    json: Json = False,
) -> None:
    """Estimate a model from a recording and say how sure it is."""
    from armrig import account
    from armrig.estimating import estimating
    from armrig.preprocess import INTEGRATING_OUTPUTS
    from armrig.recording import load
    from armrig.validation import compare, residuals

    _check_options_apply(structure, na=na, nf=nf, integrator=integrator)
    na, nf = 4 if na is None else na, 4 if nf is None else nf
    if integrator and output not in INTEGRATING_OUTPUTS:
        tell(f"--integrator: {output} does not integrate, a root at 1 of F is not the rig's")
    data = warned(load(file)).dataset(output)
    # Before the minutes that an estimation may take.
    other = None if validate is None else warned(load(validate)).dataset(output)
    fit = _estimated(data, structure, na=na, nb=nb, nf=nf, nk=nk, integrator=integrator)
    judged = None
    if other is not None:
        with estimating("nb, and na or nf"):
            judged = compare(other, fit), residuals(fit, other)
        if judged[0][0].on_estimation_data:
            tell(SAME_DATA)
    if not json:
        typer.echo("\n".join(account.of_model(fit)))
        if judged is not None:
            typer.echo(f"validation on {validate}\n{judged[0]!r}")
            typer.echo("\n".join(account.of_tests(judged[1])))
        if hint := account.hint(fit):
            tell(hint)
        return
    facts = _model_facts(fit) | {"recording": data.source}
    if other is not None and judged is not None:
        facts["validation"] = _validation_facts(other, judged[0][0], judged[1])
    print_json(facts)


def compare(
    file: File,
    other: Annotated[Path, typer.Argument(metavar="F2", help="Recording to validate with.")],
    na: Na = 4,
    nb: Nb = 4,
    nf: Nf = 4,
    nk: Nk = 1,
    json: Json = False,
) -> None:
    """Identify ARX and OE from F, and compare them and the physics on F2, which they never saw."""
    from armrig.estimating import estimating
    from armrig.recording import load
    from armrig.study import Orders, study

    recordings = [warned(load(f)) for f in (file, other)]
    with estimating("na, nb and nf"):
        done = study(recordings, orders=Orders(na=na, nb=nb, nf=nf, nk=nk))
    same = done.validation.digest == done.estimation.digest
    if same:
        tell(SAME_DATA)
    rows = [
        {
            "model": model.name,
            "fit_percent": row.fit_percent,
            "rms_error": row.rms_error,
            "velocity_fit_percent": row.velocity_fit_percent,
            "on_estimation_data": row.on_estimation_data,
        }
        for model, row in zip(done.models, done.table.rows, strict=True)
    ]
    if json:
        print_json({"validation": done.validation.source, "models": rows})
        return
    where = str(done.recording_of(done.validation.source).path)
    where += ", its second half, the first one estimates" if done.halves else ""
    typer.echo(f"simulated on {where} (recording {done.validation.source[:12]})")
    for model, row in zip(done.models, done.table.rows, strict=True):
        velocity = row.velocity_fit_percent
        typer.echo(
            f"  {model.name:8} fit {row.fit_percent:7.2f} %  rms {row.rms_error:.4g} "
            f"{done.table.unit}"
            + (f"  velocity fit {velocity:7.2f} %" if velocity is not None else "")
            + ("  (estimation data)" if row.on_estimation_data else "")
        )


def _check_options_apply(
    structure: str, *, na: int | None, nf: int | None, integrator: bool
) -> None:
    """Refuse options of the other structure, which would be without effect."""
    if structure == "arx" and integrator:
        msg = "--integrator goes with --structure oe; an ARX model finds its own"
        raise typer.BadParameter(msg)
    if structure == "arx" and nf is not None:
        msg = f"--nf {nf} goes with --structure oe; an ARX model has na and nb"
        raise typer.BadParameter(msg)
    if structure == "oe" and na is not None:
        msg = f"--na {na} goes with --structure arx; an OE model has nb and nf"
        raise typer.BadParameter(msg)


def _estimated(
    data: Any, structure: Structure, *, na: int, nb: int, nf: int, nk: int, integrator: bool
) -> Fit:
    """Return the model; orders that are too high for the data are refused."""
    from armrig.estimating import estimating, require_finite
    from armrig.estimation.orders import require_sensible

    samples = data.N - data.missing
    if structure == "arx":
        from armrig.estimation.arx import arx

        require_sensible(samples=samples, nk=nk, na=na, nb=nb)
        with estimating("na and nb"):
            fit = arx(data, na=na, nb=nb, nk=nk)
            require_finite(fit, "na and nb")
    else:
        from armrig.estimation.oe import oe

        require_sensible(samples=samples, nk=nk, integrator=integrator, nb=nb, nf=nf)
        with estimating("nb and nf"):
            fit = oe(data, nb=nb, nf=nf, nk=nk, integrator=integrator)
            require_finite(fit, "nb and nf")
    return fit


def _model_facts(fit: Any) -> dict[str, Any]:
    rows = zip(fit.names, fit.theta, fit.std, fit.std_robust, strict=True)
    return {
        "structure": fit.structure,
        "orders": fit.orders,
        "integrator": fit.integrator,
        "Ts": fit.Ts,
        "parameters": {
            name: {"value": float(v), "std": float(s), "std_robust": float(r)}
            for name, v, s, r in rows
        },
        "noise_variance": fit.noise_variance,
        "loss": fit.loss,
        "fpe": fit.fpe,
        "aic": fit.aic,
        "mdl": fit.mdl,
        "fit_percent": fit.fit_percent,
        "p_white": fit.whiteness,
        "converged": fit.converged,
        "warnings": list(fit.warnings),
        "N": fit.N,
    }


def _validation_facts(other: Any, row: Any, tests: Any) -> dict[str, Any]:
    return {
        "recording": other.source,
        "on_estimation_data": row.on_estimation_data,
        "fit_percent": row.fit_percent,
        "rms_error": row.rms_error,
        "velocity_fit_percent": row.velocity_fit_percent,
        "p_white": tests.whiteness,
        "p_no_dynamics_missing": tests.missing_dynamics,
        "p_no_feedback": tests.feedback,
    }
