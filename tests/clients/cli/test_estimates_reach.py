"""Options of commands that estimate or simulate: their values, and the next command."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import typer
from armrig import Signals
from armrig.cli import main
from armrig.cli.identify import _for_outputs, _SearchRange
from armrig.cli.integration import _check_step
from armrig.cli.model_structures import build_request
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

    monkeypatch.setattr("armrig.physics.recommend_step", work)
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


def _outputs(*outputs: str, source: str = "ab12") -> Any:
    """Return data of one input; with one output, the data are a Dataset."""
    rng = np.random.default_rng(0)
    y = rng.standard_normal((3, len(outputs)))
    data = Signals(u=np.ones(3), y=y, Ts=1.0, source=source, outputs=outputs)
    return data if len(outputs) > 1 else data.dataset()


def test_the_options_of_several_signals_reach_their_request() -> None:
    def of(*outputs: str, source: str = "ab12", **options: Any) -> Any:
        wanted = build_request(_asked(**options), len(outputs))
        integrator = bool(options.get("integrator"))
        return _for_outputs(wanted, _outputs(*outputs, source=source), integrator=integrator)

    oe: dict[str, Any] = {"structure": "oe", "nb": 2, "nf": 3, "integrator": True}
    both: dict[str, Any] = {"structure": "oe", "orders": {"nb": 2, "nf": 3}}
    assert of("theta_1", "alpha", structure="n4sid", order=3, nk=2, weights="cva") == Request(
        structure="n4sid", orders={"order": 3}, nk=2, weights="cva"
    )
    assert of("alpha", "theta_1", **oe) == Request(**both, integrator=("theta_1",), shared=True)
    assert of("y", "z", source="csv:1", **oe) == Request(**both, integrator=("y", "z"))
    assert of("theta_1", **oe) == Request(**both, integrator=True)
    for options, said in (
        ({"structure": "oe", "nd": 1}, "--nd 1 goes with --structure bj or ararx; an OE model has"),
        ({"structure": "iv4"}, "--structure iv4 has one output and one input; for several"),
        ({"structure": "oe", "integrator": True}, "the rig has no pole at 1 for alpha and v"),
    ):
        with pytest.raises(typer.BadParameter, match=said):
            of("alpha", "velocity", **options)
    with pytest.raises(typer.BadParameter, match="--shared is for several outputs: name them"):
        of("theta_1", structure="oe", shared=True)


@pytest.mark.parametrize(
    ("outputs", "source", "integrator", "found"),
    [
        (("theta_1", "alpha"), "ab12", False, ("theta_1",)),
        (("y", "z"), "csv:1", False, ()),
        (("y", "z"), "csv:1", True, ("y", "z")),
    ],
)
def test_a_search_of_several_outputs_knows_which_integrate(
    outputs: tuple[str, ...], source: str, integrator: bool, found: tuple[str, ...]
) -> None:
    data, wanted = _outputs(*outputs, source=source), _SearchRange(fixed={"nk": 2}, most=3, jobs=1)

    chosen: Any = _for_outputs(wanted, data, integrator=integrator)

    assert chosen.fixed == {"nk": 2, "integrator": found}


def test_the_next_command_reads_the_same_data() -> None:
    every = SignalChoice(
        **{"signal": "y 1", "input": "2", "Ts": 0.05, "detrend": True},
        **{"hampel": True, "calibration": Path("c.toml"), "start": 0.0, "stop": 2.5},
    )
    data = _outputs("alpha")

    assert every.options(data) == (
        " --input 2 --signal 'y 1' --Ts 0.05 --detrend --hampel --calibration c.toml"
        " --from 0 --to 2.5"
    )
    nothing = SignalChoice(signal=None)
    assert nothing.options() == ""
    assert nothing.options(data) == " --signal alpha"
    for output in ("theta_1", "y", ""):
        assert nothing.options(_outputs(output)) == ""
    assert nothing.options(_outputs("alpha", "y")) == ""
    assert SignalChoice(signal="a,b").shape == (2, 1)
    assert SignalChoice(signal=None, input="1,2").shape == (1, 2)
    assert SignalChoice(signal="a", input="b").shape == SignalChoice().shape == (1, 1)


def test_a_repeated_option_names_several_signals_as_commas_do() -> None:
    of = SignalChoice.of_options

    assert of(signal=["a", "b"], input=None) == of(signal="a,b") == SignalChoice(signal="a,b")
    assert of(signal=[], input=["u,v", "w"]).inputs == ("u", "v", "w")
