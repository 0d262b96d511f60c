"""Own equations: the estimates of several plants from distant starts, and bad equations."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig_core.errors import InputError
from numpy.typing import NDArray
from scipy.signal import lfilter

from tests.clients import pages

P = armrig.Parameter


def pendulum(**values: float) -> armrig.Ode:
    """Return a pendulum with friction; w2 in 1/s², c in rad/s², b in 1/s, k in rad/s² per V."""

    def f(t: Any, x: Any, u: Any, p: Any) -> Any:
        friction = armrig.friction(x[1], coulomb=p.c, viscous=p.b, width=0.05)
        return [x[1], p.k * u[0] - p.w2 * np.sin(x[0]) - friction]

    return armrig.Ode(
        f=f,
        output=lambda t, x, u, p: x[0],
        states=["angle [rad]", "rate [rad/s]"],
        parameters={name: P(value, low=0) for name, value in values.items()},
    )


def tanks(**values: float) -> armrig.Ode:
    """Return two tanks, one above the other, by Torricelli's law."""

    def f(t: Any, x: Any, u: Any, p: Any) -> Any:
        out_1, out_2 = (np.sqrt(np.maximum(level, 1e-6)) for level in x)
        return [p.k * u[0] - p.a * out_1, p.a * out_1 - p.b * out_2]

    return armrig.Ode(
        f=f,
        output=lambda t, x, u, p: [x[0], x[1]],
        states=["level 1 [cm]", "level 2 [cm]"],
        parameters={name: P(value, low=0) for name, value in values.items()},
    )


PLANTS: dict[str, tuple[Callable[..., armrig.Ode], dict[str, float], float, float]] = {
    "pendulum": (pendulum, {"w2": 30.0, "c": 0.5, "b": 0.3, "k": 6.0}, 0.02, 3.0),
    "tanks": (tanks, {"k": 1.0, "a": 0.8, "b": 0.6}, 1.0, 0.0),
}


def record(plant: str, seed: int, N: int = 600) -> tuple[armrig.Signals, NDArray[np.float64]]:
    """Return data of a plant with noise of 1 % of the output's deviation, and the factors 3."""
    make, truth, Ts, low = PLANTS[plant]
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-low, 3.0, N // 20), 20)
    y = make(**truth).simulate(u, Ts=Ts)
    y += 0.01 * y.std(axis=0) * rng.standard_normal(y.shape)
    return armrig.Signals(u=u, y=y, Ts=Ts), 3.0 ** rng.uniform(-1, 1, len(truth))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("plant", PLANTS)
def test_the_truth_is_found_from_starts_within_a_factor_of_3(plant: str, seed: int) -> None:
    make, truth, *_ = PLANTS[plant]
    data, factors = record(plant, seed)
    start = {k: v * c for (k, v), c in zip(truth.items(), factors, strict=True)}
    fit = armrig.greybox(data, make(**start))
    assert fit.converged
    for name, value in truth.items():
        assert abs(fit.values[name] - value) < 4 * fit.std[name] < 0.2 * value


def test_slow_noise_is_a_reason_to_distrust_the_deviations() -> None:
    """Noise 1/(1 - 0.9 q^-1) in 300 samples; white noise of the same size is none."""
    both, rng = tanks(k=0.5, a=0.4, b=0.3), np.random.default_rng(3)
    lower = replace(both, output=lambda t, x, u, p: x[1])
    u, e = np.repeat(rng.uniform(0.5, 3.0, 20), 15), rng.standard_normal(300)
    y, said = lower.simulate(u, Ts=1.0, values={})[:, 0], []
    for v in (e, 0.44 * lfilter([1.0], [1.0, -0.9], e)):
        fit = armrig.greybox(armrig.Dataset(u=u, y=y + 0.05 * v, Ts=1.0), lower)
        said.append(any("independent ones" in text for text in fit.warnings))

    assert said == [False, True]


def test_missing_samples_and_several_experiments_are_used_as_they_are() -> None:
    (first, _), (second, _) = record("pendulum", 2), record("pendulum", 3)
    gap = np.ones(first.N, bool)
    gap[100:180] = False
    whole = armrig.merge(
        [
            armrig.Dataset(u=first.u[:, 0], y=first.y[:, 0], valid=gap, Ts=0.02),
            armrig.Dataset(u=second.u[:, 0], y=second.y[:, 0], Ts=0.02),
        ]
    )
    fit = armrig.greybox(whole, pendulum(w2=25.0, c=0.6, b=0.3, k=6.0), fixed={"b": 0.3})
    assert fit.N == 2 * first.N - 80
    assert len(fit.initial) == 2
    assert abs(fit.values["w2"] - 30.0) < 4 * fit.std["w2"]


def test_an_rc_circuit_has_the_estimate_of_the_exact_model() -> None:
    """The exact model is a first-order OE with an initial state; its pole is exp(-Ts/tau)."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(0, 5, 40), 10)
    rc = armrig.Ode(
        f=lambda t, x, u, p: [(p.gain * u[0] - x[0]) / p.tau],
        output=lambda t, x, u, p: x[0],
        states=["voltage [V]"],
        parameters={"tau": P(0.3, "s", low=0), "gain": P(2.0)},
    )
    y = rc.simulate(u, Ts=0.02, values={"tau": 0.1, "gain": 1.0})[:, 0]
    data = armrig.Dataset(u=u, y=y + 0.01 * rng.standard_normal(u.size), Ts=0.02)
    fit, exact = armrig.greybox(data, rc), armrig.oe(data, nb=1, nf=1, nk=1)
    pole = float(np.real(exact.poles().values[0]))
    assert np.exp(-0.02 / fit.values["tau"]) == pytest.approx(pole, abs=2e-4)
    assert fit.loss == pytest.approx(exact.loss, rel=2e-3)


def equations(f: Any, output: Any = lambda t, x, u, p: x[0], **parameters: Any) -> armrig.Ode:
    """Return equations with two states."""
    return armrig.Ode(
        f=f, output=output, states=["a", "b"], parameters=parameters or {"k": P(1.0, low=0)}
    )


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (equations(lambda t, x, u, p: [x[0]]), r"f returns 1 value; the model has 2 states: a, b"),
        (equations(lambda t, x, u, p: [x[1] if x[0] > 0 else 0, u[0]]), "use numpy.where"),
        (equations(lambda t, x, u, p: [p.m * x[0], u[0]]), "f raised AttributeError.*m"),
        (equations(lambda t, x, u, p: x.sort() or [x[0], x[1]]), "must not change its arguments"),
        (equations(lambda t, x, u, p: [p.k * x[0] ** 3 + u[0], x[1]]), r"not finite from t = \d"),
        (
            equations(lambda t, x, u, p: [p.k * u[0] - x[0], 0 * x[1]], k=P(1.0), m=P(2.0)),
            "m: no effect on the output",
        ),
        (
            equations(lambda t, x, u, p: [x[1], p.k * u[0]], lambda t, x, u, p: [x[0], x[1]]),
            r"output returns 2 values; the data have 1 output",
        ),
        (
            equations(lambda t, x, u, p: [-1e6 * (x[0] - u[0]), p.k * x[0]]),
            "a time constant far below Ts/64",
        ),
    ],
)
def test_bad_equations_are_refused_in_a_sentence(model: armrig.Ode, message: str) -> None:
    rng = np.random.default_rng(5)
    u = rng.uniform(0, 5, 200)
    data = armrig.Dataset(u=u, y=np.cumsum(u) * 0.01 + rng.standard_normal(200), Ts=0.1)
    with pytest.raises(InputError, match=message):
        armrig.greybox(data, model)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: P(0.0, low=0), "must be between 0 and inf, not at a bound"),
        (lambda: P(3.0, low=0, high=2), "give another start, or other bounds"),
        (lambda: equations(lambda t, x, u, p: x, **{"class": 1.0}), "begins with a letter"),
        (lambda: equations("x"), "give a function"),
    ],
)
def test_a_bad_model_is_refused(make: Callable[[], Any], message: str) -> None:
    with pytest.raises((InputError, TypeError), match=message):
        make()


def test_the_page_prints_what_it_shows(capsys: pytest.CaptureFixture[str]) -> None:
    assert pages.run(pages.DOCS / "own-equations.md", capsys, atol=2e-3) == 1


def test_the_command_estimates_the_equations_of_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(6)
    u = np.repeat(rng.uniform(0, 5, 30), 10)
    y = lfilter([0, 0.1], [1, -0.9], u) + 0.01 * rng.standard_normal(300)
    table, equations = tmp_path / "rc.csv", tmp_path / "rc.py"
    np.savetxt(table, np.column_stack([u, y]), delimiter=",", header="u,y", comments="")
    given = (
        "import armrig\n"
        "from dataclasses import replace\n"
        "model = armrig.Ode(f=lambda t, x, u, p: [(u[0] - x[0]) / p.tau],\n"
        "                   output=lambda t, x, u, p: x[0], states=['v'],\n"
        "                   parameters={'tau': armrig.Parameter(1.0, 's', low=0)})\n"
    )
    equations.write_text(given)
    command = ["greybox", str(table), "--Ts", "0.01", "--model", str(equations)]

    assert main([*command, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["parameters"]["tau"]
    assert found["value"] == pytest.approx(-0.01 / np.log(0.9), abs=4 * found["std"])
    for wrong, message in (
        (["--free", "b"], "has the parameters tau"),
        (["--friction", "viscous"], "write the value or the friction into the file"),
    ):
        assert main([*command, *wrong]) != 0
        assert message in capsys.readouterr().err
    for text, message in (
        ("model = 1 / 0", "rc.py, line 1: ZeroDivisionError"),
        ("raise SystemExit(3)", "rc.py, line 1: SystemExit: 3"),
        (
            f"{given}\nimport sys\nmodel = replace(model, f=lambda *_: sys.exit())",
            "f raised SystemExit",
        ),
    ):
        equations.write_text(text)
        assert main(command) != 0
        assert message in capsys.readouterr().err
    equations.unlink()
    os.mkfifo(equations)
    assert main(command) != 0
    assert "rc.py: no regular file" in capsys.readouterr().err


def test_friction_has_the_curve_of_stribeck() -> None:
    rates = np.array([-5.0, 0.0, 0.05, 5.0])
    found = armrig.friction(
        rates, coulomb=1.0, viscous=0.1, static=2.0, stribeck_rate=0.1, width=1e-3
    )
    assert found == pytest.approx([-1.5, 0.0, 1 + np.exp(-0.25) + 0.005, 1.5], abs=1e-9)


def test_a_start_that_ends_in_a_poorer_minimum_is_not_the_last() -> None:
    """From a single start, 7 of 19 such chassis did not reach their optimum."""

    def chassis(factors: Any) -> armrig.Ode:
        def f(t: Any, x: Any, u: Any, p: Any) -> Any:
            curve = {"coulomb": p.T_c, "static": p.T_s, "stribeck_rate": p.v_s, "viscous": p.b}
            friction = armrig.friction(x[1], width=0.05, **curve)
            return [x[1], (0.167 * u[0] - 0.0897 * x[1] - friction) / p.J]

        truth = {"J": 1.7e-3, "b": 5e-3, "T_c": 0.02, "T_s": 0.04, "v_s": 0.5}
        starts = zip(truth.items(), factors, strict=True)
        own = {name: P(value * factor, low=0) for (name, value), factor in starts}
        return armrig.Ode(f=f, output=lambda t, x, u, p: x[0], states=["a", "r"], parameters=own)

    rng = np.random.default_rng(2010)
    u = np.repeat(rng.uniform(-5, 5, 100), 20)
    noise = rng.standard_normal(2000)
    y = chassis(np.ones(5)).simulate(u, Ts=0.01, steps=8)[:, 0] + 3e-3 * noise
    data = armrig.Dataset(u=u, y=y, Ts=0.01)

    fit = armrig.greybox(data, chassis(3.0 ** rng.uniform(-1, 1, 5)))

    assert fit.converged
    assert fit.loss < 9e-6 * np.mean(noise**2)


def test_a_parameter_that_the_liveliest_window_hides_is_found_in_the_whole_record() -> None:
    """There noise alone leads the search for m to its bound, where m⁴ has no effect."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 1.0], (450, 2)), 10, axis=0)
    u[:2000] *= [3.0, 2e-4]
    free = {"k": P(1.0, low=0), "m": P(0.8, low=0)}
    own = equations(lambda t, x, u, p: [p.k * u[0] + p.m**4 * u[1] - x[0], -x[1]], **free)
    y = own.simulate(u, Ts=0.1, values={"m": 1.0}) + 0.01 * rng.standard_normal((4500, 1))
    fit = armrig.greybox(armrig.Signals(u=u, y=y, Ts=0.1), own)

    assert abs(fit.values["m"] - 1) < 4 * fit.std["m"] < 1e-3


def test_equations_see_the_voltage_at_the_pin_of_a_scaled_input() -> None:
    """A recording of a pump of 0 to 100 % has the percentage; the emulator's file has volts."""
    model = armrig.Ode(
        lambda t, x, u, p: [p.k * u[0] - x[0]],
        output=lambda t, x, u, p: x[0],
        states=["level"],
        parameters={"k": armrig.Parameter(1.0)},
    )
    rng = np.random.default_rng(5)
    volts = np.repeat(rng.uniform(0, 5, 20), 10)
    y = model.simulate(volts, Ts=0.1, values={"k": 3.0})[:, 0] + 0.01 * rng.standard_normal(200)
    data = armrig.Dataset(
        u=20 * volts - 7, y=y, Ts=0.1, input="pump", input_unit="%", input_scale=(-7.0, 20.0)
    )

    fit = armrig.greybox(data, model)

    assert fit.values["k"] == pytest.approx(3.0, abs=4 * fit.std["k"])
    assert armrig.oe(data, nb=1, nf=1, offset=True).inputs == ("pump",)
    level = armrig.detrend(data)
    assert np.ptp(level.signals().volts) == pytest.approx(np.ptp(volts))
