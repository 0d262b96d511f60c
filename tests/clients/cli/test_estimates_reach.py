"""Every option of a command that estimates or simulates reaches what does its work."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import armrig
import numpy as np
import pytest
import typer
from armrig import Dataset
from armrig.cli import main
from armrig.cli.identification import _warn_of_integrator
from armrig.cli.integrators import _check_step
from armrig.cli.model_structures import requested, requested_of_several, searched_for
from armrig.cli.recorded_data import SignalChoice, between, from_recording, source_facts
from armrig.estimation.multivariable.request import SignalsRequest
from armrig.estimation.request import DEFAULTS, Request
from armrig.models.structure_table import COUNTED
from armrig.physics import systems
from armrig_core.arm import ArmParameters
from armrig_core.errors import InputError

from tests.clients.made_recordings import of_the_arm, written
from tests.clients.told import told

NOTHING: dict[str, Any] = {
    **dict.fromkeys(("structure", "nk", *COUNTED)),
    **{name: x for name, x in DEFAULTS.items() if name not in ("structure", "orders", "nk")},
}


class _NoWorkError(RuntimeError):
    """In place of the work."""


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Give the arguments with which an estimation or a simulation would begin."""
    found: list[Any] = []

    def work(*arguments: Any, **named: Any) -> Any:
        found.append((arguments, named))
        raise _NoWorkError("no work")

    for name in (
        "physics.grey_box.estimate.greybox",
        "physics.integrators.step_choice.recommend_step",
        "validation.model_search.search",
        "validation.multivariable.search.search",
        "validation.feedback_and_delay.open_loop.open_loop",
        "validation.residuals.residuals",
    ):
        monkeypatch.setattr(f"armrig.{name}", work)
    return found


@pytest.fixture
def file(tmp_path: Path) -> str:
    """Give a recording of the arm, 3 s at 100 Hz."""
    return str(written(tmp_path, of_the_arm(armrig.telegraph(300, 0.1, seed=1))))


def test_a_grey_box_has_its_parameters_its_friction_and_its_part(
    file: str, calls: list[Any]
) -> None:
    part = ["--from", "0.5", "--to", "2.5", "--set", "R_m=4"]
    free = ["--free", "J_2", "--free", "K_lin"]

    assert main(["greybox", file, *part, *free, "--friction", "both", "--signal", "alpha"]) == 1
    assert main(["greybox", file, "--signal", "theta_1,alpha", "--friction", "viscous"]) == 1
    assert main(["split", file, "--parts", "2,3", *part, *free, "--signal", "alpha"]) == 1

    (one, how), (both, of_both), (split, _) = calls
    assert one[0].N == 200
    assert one[1:] == (systems.arm, ("J_2", "K_lin"), ArmParameters(R_m=4), "alpha")
    assert how == {"friction": "both"}
    assert both[0].outputs == ("theta_1", "alpha")
    assert both[1:] == (systems.arm, ("J_1",), ArmParameters(), "theta_1")
    assert of_both == {"friction": "viscous"}
    assert split[1:] == one[1:]
    assert split[0].N < 101


def test_an_integration_recommends_for_its_methods_its_input_and_its_tolerance(
    calls: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--omega", "5", "--amplitude", "2", "--span", "3", "--tolerance", "0.02"]

    assert main(["integrate", *given, "--method", "heun", "--method", "ab2"]) == 1

    [(_, named)] = calls
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


def test_a_search_has_its_orders_its_structure_and_its_validation(
    file: str, calls: list[Any], tmp_path: Path
) -> None:
    other = written(tmp_path, of_the_arm(armrig.telegraph(210, 0.1, seed=2)), "other.mcap")
    given = ["identify", file, "--search", "--max-order", "3", "--nk", "2", "--integrator"]

    assert main([*given, "--structure", "oe", "--validate", str(other)]) == 1
    assert main([*given, "--signal", "theta_1,alpha"]) == 1
    assert main(["identify", file, "--search", "--offset"]) == 1

    (one, how), (several, of_several), (_, plain) = calls
    assert [data.N for data in one] == [300, 210]
    assert list(how.pop("orders")) == [1, 2, 3]
    assert (how.pop("executor"), how.pop("progress") is None) == (None, False)
    assert how == {"families": ("oe",), "nk": 2, "integrator": True}
    assert several[0].outputs == ("theta_1", "alpha")
    assert several[1] is None
    assert list(of_several["orders"]) == [1, 2, 3]
    assert (of_several["nk"], of_several["integrator"]) == (2, ("theta_1",))
    assert list(plain["orders"]) == [1, 2, 3, 4, 5]
    assert plain["offset"]


def test_a_test_for_feedback_has_its_level_and_a_validation_its_lags(
    file: str, calls: list[Any], tmp_path: Path
) -> None:
    armrig.arx(armrig.load(file).dataset(), na=1, nb=1).save(tmp_path / "m.json")

    assert main(["check", file, "--level", "0.002", "--to", "2"]) == 1
    assert main(["validate", file, "--model", str(tmp_path / "m.json"), "--lags", "7"]) == 1

    (loop, how), (tests, _) = calls
    assert (loop[0].N, how) == (200, {"level": 0.002})
    assert (tests[1].N, tests[2]) == (300, 7)


def _asked(**options: Any) -> dict[str, Any]:
    return NOTHING | options


@pytest.mark.parametrize(
    ("options", "request_"),
    [
        ({"structure": "arx"}, Request(structure="arx", orders={"na": 4, "nb": 4})),
        (
            {"structure": "oe", "nb": 2, "nk": 0, "integrator": True},
            Request(structure="oe", orders={"nb": 2, "nf": 4}, nk=0, integrator=True),
        ),
        (
            {"structure": "bj", "nc": 0, "nd": 3, "stable": True, "offset": True},
            Request(
                structure="bj",
                orders={"nb": 4, "nc": 0, "nd": 3, "nf": 4},
                stable=True,
                offset=True,
            ),
        ),
        (
            {"structure": "n4sid", "weights": "moesp"},
            Request(structure="n4sid", orders={"order": None}, weights="moesp"),
        ),
    ],
)
def test_the_options_of_an_estimation_make_its_request(
    options: dict[str, Any], request_: Request
) -> None:
    assert requested(_asked(**options)) == request_


def test_options_that_a_structure_does_not_have_are_refused_with_those_that_have_it() -> None:
    for options, said in (
        ({"structure": None}, "give --structure, such as"),
        ({"structure": "ss"}, "--structure ss is for several signals"),
        ({"structure": "iv4", "nc": 0}, "--nc 0 goes with --structure armax or bj"),
        ({"structure": "arx", "integrator": True}, "an ARX model finds an integrator by itself"),
        ({"structure": "iv4", "offset": True}, "subtract the means with --detrend"),
    ):
        with pytest.raises(typer.BadParameter, match=said):
            requested(_asked(**options))


def test_the_options_of_several_signals_make_their_request() -> None:
    def of_several(shared: bool = False, **options: Any) -> SignalsRequest:
        integrating = ("theta_1",)
        return requested_of_several(_asked(**options), integrating=integrating, shared=shared)

    assert of_several(structure="n4sid", order=3, nk=2, weights="cva") == SignalsRequest(
        structure="n4sid", orders={"order": 3}, nk=2, weights="cva"
    )
    assert of_several(True, structure="oe", nb=2, nf=3, integrator=True) == SignalsRequest(
        structure="oe", orders={"nb": 2, "nf": 3}, integrating=("theta_1",), shared=True
    )
    with pytest.raises(typer.BadParameter, match="--nd 1 does not go with OE of several signals"):
        of_several(structure="oe", nd=1)
    with pytest.raises(typer.BadParameter, match="--structure iv4 has one output and one input"):
        of_several(structure="iv4")


def test_a_search_fixes_what_is_given_but_no_orders() -> None:
    given = _asked(structure="armax", nk=0, integrator=True)

    assert searched_for(given) == {"families": ("armax",), "nk": 0, "integrator": True}
    assert searched_for(_asked(offset=True)) == {"offset": True}
    for options, said in (
        ({"na": 2}, "--na 2 does not go with --search, which tries orders up to --max-order"),
        ({"stable": True}, "--stable does not go with --search, whose models are always stable"),
        ({"structure": "arx", "integrator": True}, "--integrator goes with --structure"),
    ):
        with pytest.raises(typer.BadParameter, match=said):
            searched_for(_asked(**options))


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


def test_a_part_has_a_sample_and_says_how_long_the_data_last() -> None:
    data = Dataset(u=np.arange(50.0), y=np.zeros(50), Ts=0.1)

    assert between(data, None, None) is data
    assert between(data, 4.9, None).u.tolist() == [49]
    assert between(data, 0.2, 0.4).u.tolist() == [2, 3]
    assert between(data, 1.0, 99.0).N == 40
    for start, stop, said in (
        (5.0, None, r"no samples from --from 5 s on: the data last 5 s"),
        (2.0, 2.0, r"no samples from --from 2 s on to --to 2 s: the data last 5 s"),
        (3.0, 2.0, r"no samples from --from 3 s on to --to 2 s"),
        (-1.0, None, r"no samples from --from -1 s on: the data"),
        (None, 0.0, r"no samples from --from 0 s on to --to 0 s"),
    ):
        with pytest.raises(InputError, match=said):
            between(data, start, stop)


def test_data_are_of_a_recording_or_of_a_file_by_their_source() -> None:
    values = {"u": np.ones(2), "y": np.array([0.0, 1.0]), "Ts": 1.0}
    recorded, other = (Dataset(**values, source=source) for source in ("ab12", "csv:cd34"))

    assert [from_recording(data) for data in (recorded, other)] == [True, False]
    assert source_facts(recorded) == {"recording": "ab12"}
    assert source_facts(other) == {"csv": "cd34"}


def test_outliers_are_marked_before_the_means_are_subtracted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 2.0], 200)
    y = 7 + np.append(0.0, u[:-1]) + 0.1 * rng.standard_normal(200)
    y[[30, 90]] += 500.0
    np.savetxt(tmp_path / "f.csv", np.column_stack([u, y]), "%.6f", ",", header="u,y", comments="")
    given = SignalChoice(signal=None, Ts=0.1, detrend=True, hampel=True)

    data = given.of(tmp_path / "f.csv")

    assert data.missing == 2
    assert abs(data.y[data.valid].mean()) < 1e-9
    assert "marked 2 of 200 samples" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("source", "output", "is_told"),
    [
        *(("ab12", "velocity", True), ("ab12", "alpha", True), ("ab12", "theta_1", False)),
        *(("csv:ab12", "y", False), ("csv:ab12", "alpha", False)),
    ],
)
def test_an_integrator_is_doubted_for_what_does_not_integrate_on_the_rig(
    source: str, output: str, is_told: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    _warn_of_integrator(Dataset(u=np.ones(2), y=np.ones(2), Ts=1.0, source=source, output=output))

    said = (
        f"armrig: --integrator: the rig has no pole at 1 for {output}, which does not integrate\n"
    )
    assert capsys.readouterr().err == said * is_told
