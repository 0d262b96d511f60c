"""A request for an estimation: what reaches the estimator, and what comes back after `next:`."""

from __future__ import annotations

import shlex
from typing import Any, get_args

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig.cli.model_structures import build_request
from armrig.estimation.request import OPTIONS, Request, flag, options_of, require_sensible
from armrig.models.structure_table import OFFERED, users
from armrig.report.batch.tasks import Identify
from armrig_core.errors import InputError, OperationError
from msgspec.structs import asdict

DATA = armrig.Dataset(
    u=np.random.default_rng(0).standard_normal(200),
    y=np.random.default_rng(1).standard_normal(200),
    Ts=0.1,
)


def _with(option: str) -> Request:
    """Return a request with an option that is not its default, and one of each kind of order."""
    kind, _ = OPTIONS[option]
    flags = (bool, bool | None, bool | tuple[str, ...])
    value = True if kind in flags else (get_args(get_args(kind)[0]) or ["P1D"])[-1]
    structure = users(option)[0]
    orders = dict.fromkeys(OFFERED[structure].orders, 2)
    nk = int(OFFERED[structure].continuous)  # the default, since these have no nk
    return Request(structure=structure, orders=orders, nk=nk, **{option: value})


@pytest.mark.parametrize("option", OPTIONS)
def test_options_of_a_request_are_parsed_to_the_same_request(
    option: str, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    request, asked, tasks = _with(option), list[Any](), list[Any]()
    monkeypatch.setattr("armrig.cli.identify._process", lambda task, *_, **__: tasks.append(task))

    def noted(*given: Any) -> Any:
        asked.append(build_request(*given))
        return asked[-1]

    monkeypatch.setattr("armrig.cli.model_structures.build_request", noted)
    monkeypatch.setattr("armrig.cli.recorded_data.SignalChoice.of", _ended)

    typed = shlex.split(options_of(request))
    of_one = OPTIONS[option][1].channels == 1
    columns = [] if of_one else ["--signal", "y", "--signal", "z"]
    batch = ["batch", "identify", str(tmp_path), "-o", "t.parquet", *typed]
    assert main(batch) == (0 if of_one else 2)  # a batch has one output and one input
    assert main(["identify", "data.csv", *typed, *columns]) == 1

    assert asked == [request] * (1 + of_one)
    assert tasks == [Identify(**asdict(request))] * of_one


def _ended(*_: Any, **__: Any) -> None:
    raise OperationError("no work")


@pytest.mark.parametrize("option", OPTIONS)
def test_an_option_of_another_structure_is_refused(
    option: str, tmp_path: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    others = [name for name in OFFERED if name not in users(option)]
    value = options_of(_with(option)).partition(flag(option))[2].strip()
    typed = f"{flag(option)} {value}".strip()

    for structure in others:
        arguments = ["identify", "F.csv", "--save", str(tmp_path / "m.json"), "--signal", "y,z"]
        assert main([*arguments, "--structure", structure, *typed.split()]) == 2
        said = " ".join(capsys.readouterr().err.split())
        assert f"{typed} goes with --structure {' or '.join(users(option))}" in said


def test_an_order_and_a_delay_of_0_reach_the_estimator() -> None:
    fit = Request(structure="armax", orders={"na": 1, "nb": 1, "nc": 0}, nk=0).estimated(DATA)

    assert fit.orders == {"na": 1, "nb": 1, "nc": 0, "nk": 0}


def test_the_request_of_a_fit_has_its_orders_and_options() -> None:
    request = Request(structure="n4sid", orders={"order": None}, weights="moesp", stable=True)
    fit = request.estimated(DATA)

    again = request.of_fit(fit)

    assert again.orders == {"order": fit.orders["order"]}
    assert (again.weights, again.stable) == ("moesp", True)
    np.testing.assert_array_equal(again.estimated(DATA).theta, fit.theta)


@pytest.mark.parametrize("option", ["integrator", "offset", None])
def test_the_request_of_a_fit_repeats_its_integrator_or_offset(option: str | None) -> None:
    """With an integrator the offset is estimated anyway, so it is not asked for."""
    more = {option: True} if option else {}
    orders: dict[str, int | None] = {"na": 2, "nb": 1, "nc": 0}
    request = Request(structure="armax", orders=orders, nk=2, starts="few", **more)
    fit = request.estimated(DATA)

    again = Request(structure="armax", orders={}).of_fit(fit)

    assert (again.integrator, again.offset) == (option == "integrator", option == "offset")
    assert (again.orders, again.nk) == (orders, 2)


def test_orders_are_limited_by_the_number_of_samples_with_an_output() -> None:
    data = DATA.replaced(valid=np.arange(200) % 5 < 2, step=None)
    request = Request(structure="armax", orders={"na": 4, "nb": 4, "nc": 1}, integrator=True)

    request.check(data)
    more = Request(structure="n4sid", orders={"order": None}, nk=9)
    with pytest.raises(InputError, match="nk=9: at most 8 for 80 samples"):
        more.check(data)
    with pytest.raises(InputError, match="9 parameters from 80 samples; at most 8 parameters"):
        Request(structure="armax", orders=request.orders).check(data)


@pytest.mark.parametrize("samples", [10, 19, 75, 200])
def test_parameters_and_nk_are_limited_to_a_tenth_of_the_samples(samples: int) -> None:
    most = samples // 10

    require_sensible(samples=samples, nk=most, na=most - 1, nb=1)
    require_sensible(samples=samples, nk=1, integrator=True, na=most, nb=1)
    for nk, na in ((most + 1, most - 1), (1, most)):
        with pytest.raises(InputError, match=f"at most {most} "):
            require_sensible(samples=samples, nk=nk, na=na, nb=1)


def test_a_request_of_another_structure_keeps_common_options() -> None:
    """An output-error model has no projection whose weights could be chosen."""
    request = Request(structure="n4sid", orders={"order": 2}, nk=3, weights="moesp", stable=True)

    other = request.of_structure("oe", {"nb": 2, "nf": 2})

    assert other == Request(structure="oe", orders={"nb": 2, "nf": 2}, nk=3, stable=True)
