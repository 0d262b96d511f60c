"""Mistakes that students make in Python: each raises a fitting exception with the way out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest

RNG = np.random.default_rng(1)
U = 0.5 + 4.0 * RNG.integers(0, 2, 400)
Y = np.convolve(U, 0.1 * 0.9 ** np.arange(60))[:400] + 0.01 * RNG.standard_normal(400)
DATA = armrig.Dataset(u=U, y=Y, Ts=0.01)
OTHER = armrig.Dataset(u=U, y=Y, Ts=0.02)
FIT = armrig.arx(DATA, na=2, nb=2)
P = armrig.physics.ArmParameters()
A, B = np.array([[0.0, 1.0], [0.0, -5.0]]), np.array([[0.0], [5.0]])


def _dataset(**given: Any) -> armrig.Dataset:
    return armrig.Dataset(**({"u": U, "y": Y, "Ts": 0.01} | given))


def _entered(rig: str) -> None:
    with armrig.Rig(rig):
        pass


a: Any = armrig  # mypy would find most of these mistakes before Python does
MISTAKES: list[tuple[str, Any, type[Exception], str]] = [
    # Files.
    ("load('@last')", lambda: a.load("@last"), armrig.FileError, "make one with `armrig collect`"),
    ("load(3)", lambda: a.load(3), TypeError, 'armrig.load("F.mcap")'),
    ("load(data)", lambda: a.load(DATA), TypeError, "pass the name of a file"),
    ("load('nofile')", lambda: a.load("nofile"), FileNotFoundError, "nofile"),
    ("load_data(path, 'u', 'y')", lambda: a.load_data("f", "u", "y"), TypeError, "by name"),
    ("load_data(output=)", lambda: a.load_data("f", output="y"), TypeError, "it takes path, input"),
    # A Dataset.
    ("Dataset(u, y, Ts)", lambda: a.Dataset(U, Y, 0.01), TypeError, "Dataset(u=…, y=…, Ts=…)"),
    ("Dataset without Ts", lambda: a.Dataset(u=U, y=Y), TypeError, "Dataset needs Ts"),
    ("Dataset(ts=)", lambda: a.Dataset(u=U, y=Y, ts=1), TypeError, "did you mean Ts?"),
    ("other lengths", lambda: _dataset(y=Y[1:]), ValueError, "one value for each instant"),
    ("(N, 1)", lambda: _dataset(u=U[:, None]), ValueError, "use u.ravel()"),
    ("(N, 2)", lambda: _dataset(u=np.c_[U, U]), ValueError, "such as u[:, 0]"),
    ("a single value", lambda: _dataset(u=2.5), ValueError, "numpy.full(N, 2.5)"),
    ("nothing", lambda: _dataset(u=[], y=[]), ValueError, "u is empty"),
    ("None", lambda: _dataset(u=None), TypeError, "u is missing; give an array of numbers"),
    ("Ts < 0", lambda: _dataset(Ts=-0.01), ValueError, "must be from 1e-12 to 1e+12 s"),
    ("Ts = 1e300", lambda: _dataset(Ts=1e300), ValueError, "from 1e-12 to 1e+12 s"),
    ("Ts='10 ms'", lambda: _dataset(Ts="10 ms"), TypeError, "one number, in seconds"),
    ("Ts=t", lambda: _dataset(Ts=np.arange(400.0)), TypeError, "such as Ts=0.01"),
    ("inf in y", lambda: _dataset(y=Y * np.inf), ValueError, "valid=numpy.isfinite(y)"),
    ("inf in Signals", lambda: a.Signals(u=Y, y=Y * np.inf, Ts=0.1), ValueError, "isfinite(y)"),
    ("text", lambda: _dataset(u=["1,5"] * 400), ValueError, "numbers with a decimal point"),
    ("a file's name", lambda: _dataset(u="f.csv"), ValueError, "armrig.load_data(path)"),
    ("data[0]", lambda: DATA[a and 0], TypeError, "data[a:b]"),
    ("data[1.0:2.0]", lambda: DATA[1.0:2.0], TypeError, "round(t / data.Ts)"),
    ("split(2.5)", lambda: DATA.split(a and 2.5), ValueError, "must be an integer"),
    ("merge(d, d)", lambda: a.merge(DATA, DATA), TypeError, "merge([parts, …])"),
    (
        "merge of other Ts",
        lambda: a.merge([DATA, OTHER]),
        ValueError,
        "apply the same treatment",
    ),
    ("detrend(order=3)", lambda: a.detrend(DATA, order=3), ValueError, "must be 0 (remove the me"),
    ("detrend(u)", lambda: a.detrend(U), TypeError, "armrig.Dataset(u=u, y=y, Ts=Ts)"),
    # Estimation.
    ("arx(data)", lambda: a.arx(DATA), TypeError, "arx(data, na=…, nb=…)"),
    ("arx(data, 2, 2, 1)", lambda: a.arx(DATA, 2, 2, 1), TypeError, "arx(data, na=2, nb=2, nk=1)"),
    ("arx(data, [2, 2, 1])", lambda: a.arx(DATA, [2, 2, 1]), TypeError, "na=2, nb=2, nk=1"),
    ("arx(u, y)", lambda: a.arx(U, Y, na=2, nb=2), TypeError, "data is a ndarray: give a Dataset"),
    ("arx('f')", lambda: a.arx("f.mcap", na=2, nb=2), TypeError, 'armrig.load("F.mcap")'),
    ("arx(na=2.0)", lambda: a.arx(DATA, na=2.0, nb=2), ValueError, "na=2.0 must be an integer"),
    ("arx(nf=2)", lambda: a.arx(DATA, na=2, nb=2, nf=2), TypeError, "it takes data, na, nb, nk"),
    ("y = u", lambda: a.arx(_dataset(y=U), na=2, nb=2), ValueError, "equals u: give the column"),
    ("u = 2.5", lambda: a.arx(_dataset(u=0 * U), na=2, nb=2), ValueError, "u is always 0"),
    ("oe(nb=0)", lambda: a.oe(DATA, nb=0, nf=0), ValueError, "nb=0 must be an integer >= 1"),
    ("oe(nb=1e30)", lambda: a.oe(DATA, nb=10**30, nf=2), ValueError, "must be at most 10000"),
    ("arx(na=1e9)", lambda: a.arx(DATA, na=10**9, nb=2), ValueError, "must be at most 10000"),
    ("telegraph(1e9)", lambda: a.telegraph(10**9, 0.1), ValueError, "must be at most 100000000"),
    ("resample(1e9)", lambda: a.resample(DATA, 1e9), ValueError, "samples; resampling to 1e+09"),
    ("search(progress=3)", lambda: a.search(DATA, progress=3), TypeError, "a function of (done,"),
    ("search(executor=3)", lambda: a.search(DATA, executor=3), TypeError, "must be a concurrent."),
    ("search(offset='x')", lambda: a.search(DATA, offset="x"), ValueError, "must be True or False"),
    ("oe(nf=500)", lambda: a.oe(DATA, nb=2, nf=500), ValueError, "needs at least"),
    (
        "oe(integrator='yes')",
        lambda: a.oe(DATA, nb=2, nf=2, integrator="yes"),
        ValueError,
        "must be True or False",
    ),
    ("select_orders(na=4)", lambda: a.select_orders(DATA, na=4), TypeError, "na=range(1, 5)"),
    ("iddata", lambda: a.iddata(Y, U, 0.01), AttributeError, "armrig.Dataset"),
    ("resid", lambda: a.resid(DATA, FIT), AttributeError, "armrig.residuals"),
    ("OE", lambda: a.OE(DATA), AttributeError, "did you mean armrig.oe?"),
    # A model.
    ("simulate(data)", lambda: FIT.simulate(a and DATA), TypeError, "such as data.u"),
    ("predict(u)", lambda: FIT.predict(a and U), TypeError, "for an input, use fit.simulate(u)"),
    (
        "predict(horizon=1.5)",
        lambda: FIT.predict(DATA, horizon=a and 1.5),
        ValueError,
        "an integer",
    ),
    ("compare(fit, data)", lambda: a.compare(FIT, DATA), TypeError, "compare(data, fit)"),
    ("compare(data)", lambda: a.compare(DATA), ValueError, "compare(data, fit)"),
    (
        "compare(data, [fit])",
        lambda: a.compare(DATA, [FIT]),
        TypeError,
        "compare(data, fit1, fit2)",
    ),
    ("compare of other Ts", lambda: a.compare(OTHER, FIT), ValueError, "validate at the same rate"),
    ("residuals(data, data)", lambda: a.residuals(DATA, DATA), TypeError, "residuals(fit, data)"),
    # Physics.
    ("free=('J1',)", lambda: a.greybox(DATA, free=("J1",)), ValueError, "is none of J_1, J_2"),
    ("model='chassis'", lambda: a.greybox(DATA, model="chassis"), TypeError, "as armrig.physics."),
    (
        "model=chassis(p)",
        lambda: a.greybox(DATA, model=a.physics.chassis(P)),
        TypeError,
        "without parenth",
    ),
    ("fixed={}", lambda: a.greybox(DATA, fixed={}), TypeError, "ArmParameters(J_1=0.0017)"),
    ("split_study(parts=3)", lambda: a.split_study(DATA, parts=3), TypeError, "parts=(1, 2, 4)"),
    ("replace(p, J1=)", lambda: replace(P, **{"J1": 1.0}), TypeError, "did you mean J_1?"),
    ("replace(p, J_1='1')", lambda: replace(P, J_1=a and "1"), TypeError, "in SI units"),
    ("arm()", lambda: a.physics.arm(), TypeError, "arm needs p: arm(p)"),
    ("arm({})", lambda: a.physics.arm({}), TypeError, "armrig.physics.ArmParameters()"),
    (
        "physical_model(p)",
        lambda: a.physics.physical_model(P),
        TypeError,
        "physical_model(p, data)",
    ),
    (
        "integrate(u=0.5)",
        lambda: a.physics.integrate(A, B, 1, [0, 0], 1, 9),
        TypeError,
        "lambda t: 2.5",
    ),
    (
        "method='euler'",
        lambda: a.physics.stability_limit(A, "euler"),
        ValueError,
        "none of forward_euler",
    ),
    # The rig and its input.
    ("telegraph(3000, 5)", lambda: a.telegraph(3000, 5), ValueError, "a probability, 0 <= a <= 1"),
    ("telegraph(3000)", lambda: a.telegraph(3000), TypeError, "telegraph(N, a)"),
    ("low > high", lambda: a.telegraph(9, 0.1, low=5, high=0), ValueError, "must be below high"),
    ("high=6", lambda: a.telegraph(9, 0.1, high=6), ValueError, "outside the rig's 0 to 5 V"),
    ("low=-1", lambda: a.telegraph(9, 0.1, low=-1), ValueError, "outside the rig's 0 to 5 V"),
    ("Rig(1)", lambda: a.Rig(1), TypeError, "give the id in quotes, such as '1'"),
    ("run before arm", lambda: a.Rig("1").run(U), armrig.RigError, "call arm(owner) first"),
    ("Rig without with", lambda: a.Rig("1").arm("I"), armrig.RigError, "used in a with block"),
    ("no such rig", lambda: _entered("nosuch"), armrig.RigError, "`armrig lab --rig nosuch`"),
]


@pytest.mark.parametrize(
    ("call", "raised", "way_out"), [m[1:] for m in MISTAKES], ids=[m[0] for m in MISTAKES]
)
def test_a_wrong_argument_is_refused_with_the_remedy(
    call: Any,
    raised: type[Exception],
    way_out: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))

    with pytest.raises(raised) as refusal:
        call()

    message = str(refusal.value)
    assert way_out in message
    assert "\n" not in message
    assert len(message) <= 260


def test_the_model_warns_of_swapped_columns() -> None:
    """An output of two levels looks like an input."""
    fit = armrig.arx(armrig.Dataset(u=Y, y=U, Ts=0.01), na=2, nb=2)

    assert "the columns may be swapped" in fit.warnings[0]


def test_lists_and_numpy_integers_are_accepted() -> None:
    data = armrig.Dataset(u=U.tolist(), y=Y.tolist(), Ts=0.01)

    fit = armrig.arx(data, na=int(np.int64(2)), nb=a and np.int64(2))

    np.testing.assert_array_equal(fit.theta, FIT.theta)
