"""Lines, facts and figures of a model of several signals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

from armrig.cli.model_output import coefficients, root_lines
from armrig.estimation.multivariable.request import SignalsRequest
from armrig.numerics.quantities import listed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.signals import Signals
    from armrig.models.fit import Fit
    from armrig.models.multivariable.fit import MultivariableFit
    from armrig.validation.multivariable.residual_test import SignalsResidualTest
    from armrig.validation.multivariable.search import SignalsSearch


def answer(fit: MultivariableFit) -> str:
    """Return the fit of each output and its residuals in a sentence or two."""
    fits = [
        f"{name} to {q.fit_percent:.2f} %" for name, q in zip(fit.outputs, fit.quality, strict=True)
    ]
    coloured = [name for name, q in zip(fit.outputs, fit.quality, strict=True) if q.white.coloured]
    said = f"{fit.label} fits {listed(fits)} one step ahead"
    if coloured:
        return f"{said}; the residuals of {listed(coloured)} are coloured: σ robust applies."
    return f"{said}; the residuals are white."


def lines(fit: MultivariableFit, *, verbose: bool) -> Iterator[str]:
    """Yield the model in short, or each channel with its coefficients."""
    yield repr(fit)
    if verbose:
        for i, j, channel in fit.channels():
            yield f"{fit.inputs[j]} to {fit.outputs[i]}, delay {channel.nk} Ts"
            yield from coefficients(channel)
            yield from root_lines(channel)


def request_of(found: SignalsSearch) -> SignalsRequest:
    """Return the request that estimates the chosen model again, from all data."""
    chosen = found.chosen
    integrators = zip(found.fit.outputs, found.fit.form.integrators, strict=True)
    integrating = tuple(name for name, integrates in integrators if integrates)
    n = chosen.order
    is_shared = chosen.family == "oe"
    return SignalsRequest(
        structure=chosen.family,
        orders=dict.fromkeys(("nb", "nf"), n + bool(integrating)) if is_shared else {"order": n},
        nk=found.nk,
        integrating=integrating,
        shared=is_shared,
    )


def model_facts(fit: MultivariableFit) -> dict[str, Any]:
    """Return the results of the estimation as JSON fields."""
    poles = fit.poles()
    return {
        "structure": fit.structure,
        "orders": fit.orders,
        "shared": fit.shared,
        "inputs": list(fit.inputs),
        "Ts": fit.Ts,
        "outputs": {
            name: {
                "fit_percent": q.fit_percent,
                "loss": q.loss,
                "N": q.N,
                "p_white": q.white.p_value,
                "whiteness_test": q.white.test,
            }
            for name, q in zip(fit.outputs, fit.quality, strict=True)
        },
        "noise_covariance": fit.noise_covariance.tolist(),
        "poles": [
            {"real": z.real, "imag": z.imag, "std": float(std)}
            for z, std in zip(poles.values.tolist(), poles.std, strict=True)
        ],
        "channels": [
            {
                "input": fit.inputs[j],
                "output": fit.outputs[i],
                "nk": channel.nk,
                "parameters": {
                    name: {"value": float(v), "std": float(s), "std_robust": float(r)}
                    for name, v, s, r in zip(
                        channel.names, channel.theta, channel.std, channel.std_robust, strict=True
                    )
                },
            }
            for i, j, channel in fit.channels()
        ],
        "converged": fit.converged,
        "warnings": list(fit.warnings),
    }


def test_facts(tests: SignalsResidualTest) -> dict[str, Any]:
    """Return the tests of the residuals as JSON fields."""
    return {
        "p_white": tests.white.p_value,
        "p_no_dynamics_missing": tests.missing_dynamics,
        "p_no_feedback": tests.feedback,
        "outputs": {
            name: {"p_white": white.p_value, "whiteness_test": white.test}
            for name, white in zip(tests.outputs, tests.white_by_output, strict=True)
        },
        "pairs": [
            {
                "input": input,
                "output": output,
                "p_no_dynamics_missing": float(tests.missing_dynamics_by_pair[i, j]),
                "p_no_feedback": float(tests.feedback_by_pair[i, j]),
            }
            for i, output in enumerate(tests.outputs)
            for j, input in enumerate(tests.inputs)
        ],
    }


def figures(fit: MultivariableFit, data: Signals) -> dict[str, Callable[[Axes], Axes]]:
    """Return the functions that draw the simulated outputs, and each channel's Bode diagram."""
    from armrig.models.multivariable.comparison import compare
    from armrig.models.multivariable.figures import plot_signals_comparison

    table = compare(data, fit)
    drawn: dict[str, Callable[[Axes], Axes]] = {
        "compare": lambda ax: plot_signals_comparison(table, ax=ax)
    }
    for i, j, channel in fit.channels():
        label = f"{fit.inputs[j]} to {fit.outputs[i]}"
        drawn[f"bode_{label.replace(' ', '_')}"] = partial(_bode, channel, label)
    return drawn


def _bode(channel: Fit, label: str, ax: Axes) -> Axes:
    from armrig.plots import plot_bode

    return plot_bode(channel, labels=[label], ax=ax)
