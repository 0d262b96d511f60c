"""The command that estimates models: identify."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from armrig.cli.figures import Plot, check_plot, write_plot
from armrig.cli.files import check_output
from armrig.cli.model_structures import (
    NaOrNone,
    NbOrNone,
    NcOrNone,
    NdOrNone,
    NfOrNone,
    OrderOrNone,
    Structure,
    WeightsOrNone,
    check_integrator,
    chosen_orders,
    estimated,
)
from armrig.cli.options import (
    SAME_DATA,
    CalibrationFile,
    File,
    Json,
    Nk,
    print_json,
    say,
    tell,
    warned,
)

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset
    from armrig.models.fit import Fit
    from armrig.validation.search_result import SearchResult

Output = Annotated[
    Literal["theta_1", "alpha", "velocity"], typer.Option("--output", help="Which output.")
]


def identify(
    file: File,
    structure: Annotated[
        Structure | None, typer.Option("--structure", help="Which model.", show_default=False)
    ] = None,
    na: NaOrNone = None,
    nb: NbOrNone = None,
    nc: NcOrNone = None,
    nd: NdOrNone = None,
    nf: NfOrNone = None,
    order: OrderOrNone = None,
    nk: Nk = 1,
    weights: WeightsOrNone = None,
    integrator: Annotated[
        bool,
        typer.Option("--integrator", help="One pole is 1 exactly (ARMAX, OE, BJ, N4SID)."),
    ] = False,
    search: Annotated[
        bool,
        typer.Option("--search", help="Try all structures, or the one given, with several orders."),
    ] = False,
    most: Annotated[
        int, typer.Option("--max-order", min=1, help="Highest order that --search tries.")
    ] = 5,
    jobs: Annotated[
        int, typer.Option("--jobs", min=1, help="Processes that --search estimates in.")
    ] = 1,
    validate: Annotated[
        Path | None, typer.Option("--validate", metavar="F2", help="Recording to validate with.")
    ] = None,
    output: Output = "theta_1",
    calibration: CalibrationFile = None,
    save: Annotated[
        Path | None, typer.Option("--save", metavar="JSON", help="File to write the model to.")
    ] = None,
    plot: Plot = None,
    json: Json = False,
) -> None:
    """Estimate a model from a recording, or search for one.

    Says how sure each parameter is.
    """
    from armrig.data.treatment import INTEGRATING_OUTPUTS
    from armrig.recordings.loading import load

    given = {"na": na, "nb": nb, "nc": nc, "nd": nd, "nf": nf, "order": order}
    orders: dict[str, int | None] = {}
    if search:
        _check_nothing_fixed(given, weights=weights)
    elif structure is None:
        msg = "give --structure, such as --structure oe --integrator, or --search"
        raise typer.BadParameter(msg)
    else:
        orders = chosen_orders(structure, given)
    if integrator and structure is not None:
        check_integrator(structure)
    if weights is not None and structure != "n4sid":
        msg = f"--weights {weights} goes with --structure n4sid"
        raise typer.BadParameter(msg)
    if integrator and output not in INTEGRATING_OUTPUTS:
        tell(f"--integrator: {output} does not integrate, a root at 1 is not the rig's")
    inputs = [file, *([validate] if validate else [])]
    check_plot(plot, inputs)
    if save is not None:
        check_output(save, inputs)
    data = warned(load(file, calibration)).dataset(output)
    # Before the minutes that an estimation may take.
    other = None if validate is None else warned(load(validate, calibration)).dataset(output)
    found = None
    if search:
        found = _searched(
            data, other, structure, nk=nk, integrator=integrator, most=most, jobs=jobs
        )
        fit = found.fit
    elif structure is not None:
        fit = estimated(data, structure, orders, nk=nk, integrator=integrator, weights=weights)
    _told(fit, found, data, other, where=validate, json=json)
    if save is not None:
        fit.save(save)
    if plot is not None:
        from armrig.plots import plot_bode, plot_poles_zeros, plot_step

        write_plot(
            plot,
            lambda ax: plot_bode(fit, ax=ax),
            lambda ax: plot_step(fit, ax=ax),
            lambda ax: plot_poles_zeros(fit, ax=ax),
        )


def _check_nothing_fixed(given: dict[str, int | None], *, weights: str | None) -> None:
    """Refuse orders beside a search for them."""
    fixed = {name: value for name, value in (given | {"weights": weights}).items() if value}
    for name, value in fixed.items():
        msg = f"--{name} {value} does not go with --search, which tries orders up to --max-order"
        raise typer.BadParameter(msg)


def _searched(
    data: Dataset,
    other: Dataset | None,
    structure: Structure | None,
    *,
    nk: int,
    integrator: bool,
    most: int,
    jobs: int,
) -> SearchResult:
    from concurrent.futures import ProcessPoolExecutor
    from contextlib import nullcontext

    from armrig.cli.waiting import estimating
    from armrig.validation.model_search import FAMILIES, search

    families = FAMILIES if structure is None else (structure,)
    pool = ProcessPoolExecutor(jobs) if jobs > 1 else nullcontext()
    with estimating("--max-order"), pool as executor:
        return search(
            data,
            other,
            families=families,
            orders=range(1, most + 1),
            nk=nk,
            integrator=True if integrator else None,
            executor=executor,
        )


def _told(
    fit: Fit,
    found: SearchResult | None,
    data: Dataset,
    other: Dataset | None,
    *,
    where: Path | None,
    json: bool,
) -> None:
    from armrig.cli import model_output
    from armrig.cli.waiting import estimating
    from armrig.validation.comparison import compare
    from armrig.validation.residuals import residuals

    judged = None
    if other is not None:
        with estimating("the orders"):
            judged = compare(other, fit), residuals(fit, other)
        if judged[0][0].on_estimation_data:
            tell(SAME_DATA)
    if not json:
        if found is not None:
            say("\n".join(model_output.of_search(found)))
        say("\n".join(model_output.of_model(fit)))
        if judged is not None:
            say(f"validation on {where}\n{judged[0]!r}")
            say("\n".join(model_output.of_tests(judged[1])))
        if hint := model_output.hint(fit):
            tell(hint)
        return
    facts = model_output.facts_of_model(fit) | {"recording": data.source}
    if found is not None:
        facts["search"] = _search_facts(found)
    if other is not None and judged is not None:
        facts["validation"] = model_output.facts_of_tests(other, judged[0][0], judged[1])
    print_json(facts)


def _search_facts(found: SearchResult) -> dict[str, Any]:
    rows = zip(found.ranked, found.rms, found.excess, found.excess_std, strict=True)
    return {
        "models": [
            {
                "model": j.candidate.name,
                "parameters": j.parameters,
                "rms_error": float(rms),
                "excess": float(excess),
                "excess_std": float(std),
                "chosen": j is found.chosen,
            }
            for j, rms, excess, std in rows
        ],
        "failed": {j.candidate.name: j.reason for j in found.failed},
        "reasons": found.explain().splitlines(),
    }
