"""Next commands after an estimation, a validation or a comparison."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig import Signals
from armrig.cli.next_step import CHECK, after_validate, options_after
from armrig.cli.recorded_data import SignalChoice
from armrig.data.finding import warning
from armrig.estimation.request import Request

OE: dict[str, Any] = {"structure": "oe", "orders": {"nb": 4, "nf": 3}, "nk": 2}
INTEGRATING = OE | {"integrator": True}
BJ: dict[str, Any] = {"structure": "bj", "orders": {"nb": 1, "nc": 2, "nd": 3, "nf": 4}}
PEM: dict[str, Any] = {
    **{"structure": "pem", "orders": {"na": 0, "nb": 2, "nc": 0, "nd": 0, "nf": 2}}
}
ARX: dict[str, Any] = {"structure": "arx", "orders": {"na": 2, "nb": 3}}
TF: dict[str, Any] = {"structure": "tf", "orders": {"poles": 4, "zeros": 1}, "delay": "0.1"}
P1: dict[str, Any] = {"structure": "process", "orders": {}}
OPTIONS = "--structure oe --nb 4 --nf 3 --nk 2"


@pytest.mark.parametrize(
    ("asked", "remedies", "how", "wanted"),
    [
        (OE, "", "", OPTIONS),
        (OE, "integrator", "", f"{OPTIONS} --integrator"),
        (OE, "integrator level", "", f"{OPTIONS} --offset"),
        (OE, "level", "detrended", "--structure oe --nb 4 --nf 3 --nk 2 --offset"),
        (OE | {"offset": True}, "level", "", "--structure oe --nb 3 --nf 2 --nk 2 --offset"),
        (INTEGRATING, "level order", "searched", "--search"),
        (OE, "outliers check", "searched", "--search --hampel"),
        (OE, "nk", "", "--structure oe --nb 4 --nf 3 --nk 7"),
        (P1 | {"form": "P1"}, "nk", "", "--structure process --form P1D"),
        (TF, "nk", "", "--structure tf --poles 4 --zeros 1 --delay estimate"),
        (OE | {"offset": True}, "integrator", "", f"{OPTIONS} --integrator"),
        (OE, "outliers", "", f"{OPTIONS} --hampel"),
        (OE, "outliers check", "", f"{OPTIONS} --hampel"),
        (OE, "order", "", "--structure oe --nb 3 --nf 2 --nk 2"),
        (OE, "order", "2 poles", "--structure oe --nb 2 --nf 1 --nk 2"),
        (OE, "order", "3 poles", "--structure oe --nb 1 --nf 1 --nk 2"),
        (INTEGRATING, "order", "3 poles", "--structure oe --nb 1 --nf 2 --nk 2 --integrator"),
        (OE, "search", "", "--structure oe --search"),
        (OE, "search", "searched", "--search"),
        (OE, "search check", "", CHECK),
        (OE, "feedback", "", CHECK),
        (BJ, "feedback", "", "--structure bj --nb 1 --nc 2 --nd 3 --nf 4 --nk 1"),
        (BJ, "feedback check", "", CHECK),
        (ARX, "level", "", "--structure arx --na 2 --nb 3 --nk 1 --detrend"),
        (ARX, "level", "detrended", "--structure arx --na 1 --nb 2 --nk 1"),
        (ARX, "integrator", "", "--structure arx --na 2 --nb 3 --nk 1"),
        (ARX, "structure", "", "--structure oe --nb 3 --nf 2 --nk 1 --integrator"),
        (BJ, "order", "2 poles", "--structure bj --nb 1 --nc 2 --nd 3 --nf 2 --nk 1"),
        (TF, "order", "2 poles", "--structure tf --poles 2 --zeros 0 --delay 0.1"),
        (TF, "search", "", "--search"),
        (P1 | {"form": "P1"}, "integrator", "", "--structure process --form P1I"),
        (P1 | {"form": "P1"}, "search", "", "--structure process --form P1D"),
        (P1 | {"form": "P2DI"}, "search order", "", "--structure process --form P3DI"),
        (P1 | {"form": "P3D"}, "search", "", "--search"),
        (P1 | {"form": "P1DI"}, "search", "complete", "--structure process --form P1DI"),
        (PEM, "search", "", "--structure pem --na 0 --nb 2 --nc 0 --nd 0 --nf 2 --nk 1"),
    ],
)
def test_the_next_estimation_follows_the_findings(
    asked: dict[str, Any], remedies: str, how: str, wanted: str
) -> None:
    request = Request(**asked)
    numbers = {"poles": int(how[0])} if "poles" in how else {"nk": 7}
    about: dict[str, Any] = {"feedback": ("feedback", "text", "check")}
    names = remedies.split()
    findings: Any = [warning(*about.get(name, ("x", "text", name)), **numbers) for name in names]
    fit = SimpleNamespace(
        **{"ny": 1, "nu": 1, "structure": request.structure},
        orders=request.orders | {"nk": request.nk},
        integrator=request.integrator,
        offset=request.offset,
    )

    options = options_after(
        _found(
            fit=fit,
            request=request,
            search=fit if "searched" in how else None,
            validation=_validation(0.5 if how == "complete" else 0.0),
            signals=SignalChoice(detrend="detrended" in how),
        ),
        findings,
    )

    assert options == wanted


def _validation(missing_dynamics: float) -> Any:
    return SimpleNamespace(tests=SimpleNamespace(missing_dynamics=missing_dynamics))


def _found(**fields: Any) -> Any:
    usual = {"search": None, "validation": None}
    usual["search_options"] = "--search" * (fields.get("search") is not None)
    return SimpleNamespace(**(usual | fields))


@pytest.mark.parametrize(
    ("source", "outputs", "wanted"),
    [
        ("", ("alpha", "theta_1"), "simulate F --model m.json --from 1 --to 9 -o simulate.png"),
        ("", ("alpha", "velocity"), "check F --signal alpha --detrend --from 1 --to 9"),
        ("csv:12", ("y", "z"), ""),
    ],
)
def test_a_validation_suggests_the_physics_or_the_poorest_channel(
    source: str, outputs: tuple[str, ...], wanted: str, capsys: pytest.CaptureFixture[str]
) -> None:
    tests: Any = SimpleNamespace(poorest_pair=("alpha", "w"))
    given = SignalChoice(signal=",".join(outputs), input="u,w", start=1, stop=9, detrend=True)
    fit: Any = SimpleNamespace(outputs=outputs, ny=2, nu=2)

    after_validate(fit, tests, _data(source, outputs), Path("F"), Path("m.json"), given)

    assert capsys.readouterr().err == (f"next: armrig {wanted}\n" if wanted else "")


def _data(source: str, outputs: tuple[str, ...], mean: float = 0.0) -> Signals:
    """Return 40 samples of two inputs and the outputs, with a mean of the outputs."""
    rng = np.random.default_rng(0)
    y = mean + rng.standard_normal((40, len(outputs)))
    u = rng.choice([-1.0, 1.0], (40, 2))
    return Signals(u=u, y=y, Ts=1.0, source=source, outputs=outputs, inputs=("u", "w"))


@pytest.mark.parametrize(
    ("source", "outputs", "mean", "about", "wanted"),
    [
        ("", ("theta_1", "alpha"), 0.0, "residuals", "--structure oe --integrator"),
        ("", ("alpha", "velocity"), 9.0, "residuals", "--search"),
        ("csv:12", ("y", "z"), 9.0, "residuals feedback", f"{OPTIONS} --offset"),
        ("csv:12", ("y", "z"), 0.0, "residuals", "--search"),
        ("csv:12", ("y", "z"), 0.0, "residuals feedback", CHECK),
    ],
)
def test_coloured_residuals_of_several_signals_suggest_means_integrator_or_search(
    source: str, outputs: tuple[str, ...], mean: float, about: str, wanted: str
) -> None:
    of = {"fit": SimpleNamespace(ny=2, nu=2), "request": Request(**OE)}

    found = _found(data=_data(source, outputs, mean), **of)

    findings = [warning(name, "text") for name in about.split()]
    assert options_after(found, findings) == wanted


@pytest.mark.parametrize(
    ("source", "output", "given"),
    [
        ("", "theta_1", ""),
        ("", "alpha", " --signal alpha"),
        ("csv:12", "theta_1", " --input w --signal theta_1"),
    ],
)
def test_a_channel_is_chosen_by_the_names_that_its_file_needs(
    source: str, output: str, given: str
) -> None:
    several = SignalChoice(signal="theta_1,alpha", input=None if not source else "u,w")
    data = _data(source, ("theta_1", "alpha"))

    assert several.of_channel(output, "w", data).options(data) == given
    alone = SignalChoice(signal="alpha")
    assert alone.of_channel(output, "u", data.dataset("alpha", "u")) is alone
