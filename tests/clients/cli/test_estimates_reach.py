"""Options of commands that estimate or simulate: their values, and the next command."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import typer
from armrig import Dataset
from armrig.cli import main
from armrig.cli.identification import _warn_of_integrator
from armrig.cli.integrators import _check_step
from armrig.cli.model_structures import requested_of_several
from armrig.cli.recorded_data import SignalChoice
from armrig.estimation.request import DEFAULTS, Request
from armrig.models.structure_table import COUNTED
from armrig_core.errors import OperationError

from tests.clients.told import told

NOTHING: dict[str, Any] = {
    **dict.fromkeys(("structure", "nk", *COUNTED)),
    **{name: x for name, x in DEFAULTS.items() if name not in ("structure", "orders", "nk")},
}


def test_the_recommended_step_depends_on_methods_input_and_tolerance(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[dict[str, Any]] = []

    def work(*_: Any, **named: Any) -> None:
        calls.append(named)
        raise OperationError("no work")

    monkeypatch.setattr("armrig.physics.integrators.step_choice.recommend_step", work)
    given = ["--omega", "5", "--amplitude", "2", "--span", "3", "--tolerance", "0.02"]

    assert main(["integrate", *given, "--method", "heun", "--method", "ab2"]) == 1

    [named] = calls
    names = ("omega", "amplitude", "span", "tolerance")
    assert [named[name] for name in names] == [5.0, 2.0, 3.0, 0.02]
    assert tuple(named["methods"]) == ("heun", "ab2")
    capsys.readouterr()
    for h, said in (
        ("4", "--h 4: a step is > 0 and at most the span, 3 s"),
        ("-1", "--h -1: a step is > 0 and at most the span, 3 s"),
        ("nan", "--h nan: a step is > 0"),
        ("1e-6", "--h 1e-06: 3000000 steps; at most 2000000: give a larger step"),
    ):
        assert main(["integrate", "--span", "3", "--h", "0.1", "--h", h]) == 2
        assert said in told(capsys)
    problem: Any = SimpleNamespace(span=3.0)
    for step in (3.0, 0.1, 3.0 / 2_000_000):
        _check_step(step, problem)


def _asked(**options: Any) -> dict[str, Any]:
    return NOTHING | options


def test_the_options_of_several_signals_reach_their_request() -> None:
    def of_several(shared: bool = False, **options: Any) -> Request:
        integrating = ("theta_1",)
        return requested_of_several(_asked(**options), integrating=integrating, shared=shared)

    assert of_several(structure="n4sid", order=3, nk=2, weights="cva") == Request(
        structure="n4sid", orders={"order": 3}, nk=2, weights="cva"
    )
    assert of_several(True, structure="oe", nb=2, nf=3, integrator=True) == Request(
        structure="oe", orders={"nb": 2, "nf": 3}, integrating=("theta_1",), shared=True
    )
    with pytest.raises(typer.BadParameter, match="--nd 1 does not go with OE of several signals"):
        of_several(structure="oe", nd=1)
    with pytest.raises(typer.BadParameter, match="--structure iv4 has one output and one input"):
        of_several(structure="iv4")


def test_the_next_command_reads_the_same_data() -> None:
    every = SignalChoice(
        **{"signal": "y 1", "input": "2", "time": "t_s", "Ts": 0.05, "detrend": True},
        **{"hampel": True, "calibration": Path("c.toml"), "start": 0.0, "stop": 2.5},
    )
    data: Any = SimpleNamespace(output="alpha")

    assert every.options(data) == (
        " --input 2 --signal 'y 1' --time t_s --Ts 0.05 --detrend --hampel --calibration c.toml"
        " --from 0 --to 2.5"
    )
    nothing = SignalChoice(signal=None)
    assert nothing.options() == ""
    assert nothing.options(data) == " --signal alpha"
    for output in ("theta_1", "y", ""):
        assert nothing.options(SimpleNamespace(output=output)) == ""  # type: ignore[arg-type]
    assert SignalChoice(signal="a,b").several
    assert SignalChoice(signal=None, input="1,2").several
    assert not SignalChoice(signal="a", input="b").several


@pytest.mark.parametrize(
    ("source", "output", "is_told"),
    [
        *(("ab12", "velocity", True), ("ab12", "alpha", True), ("ab12", "theta_1", False)),
        *(("csv:ab12", "y", False), ("csv:ab12", "alpha", False)),
    ],
)
def test_an_integrator_for_a_stable_output_of_the_rig_causes_a_warning(
    source: str, output: str, is_told: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    _warn_of_integrator(Dataset(u=np.ones(2), y=np.ones(2), Ts=1.0, source=source, output=output))

    said = (
        f"armrig: --integrator: the rig has no pole at 1 for {output}, which does not integrate\n"
    )
    assert capsys.readouterr().err == said * is_told
