"""`armrig compare` and `armrig simulate` of saved models on a short recording."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig.cli.comparison import _same, print_comparison
from armrig.validation.comparison import ComparisonTable, row_line
from armrig_core.arm import ArmParameters

from tests.clients.made_recordings import of_the_arm, written


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a folder with a recording and two models of it."""
    folder = tmp_path_factory.mktemp("compared")
    u = armrig.telegraph(300, 0.1, seed=1)
    path = written(folder, of_the_arm(u, missing=slice(200, 203)), "f.mcap")
    data = armrig.load(path).dataset()
    armrig.arx(data, na=3, nb=2).save(folder / "good.json")
    armrig.arx(data, na=1, nb=1).save(folder / "poor.json")
    return folder


class _NoWorkError(RuntimeError):
    """In place of the comparison."""


@pytest.mark.parametrize(
    ("command", "horizon"), [("compare", 3), ("compare", None), ("simulate", None)]
)
def test_saved_models_and_the_physics_are_compared_at_the_horizon_on_the_part(
    command: str, horizon: int | None, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def compared(data: Any, *fits: Any, horizon: int | None = None, labels: Any = None) -> None:
        asked.append((data, fits, horizon, labels))
        raise _NoWorkError

    monkeypatch.setattr("armrig.validation.comparison.compare", compared)
    models = [x for name in ("good", "poor") for x in ("--model", str(here / f"{name}.json"))]
    given = [command, str(here / "f.mcap"), *models, "--from", "0.5", "--to", "2.75"]
    given += ["--horizon", str(horizon)] if horizon else []

    assert main([*given, "--set", "J_2=0.006"]) == 1

    [(data, fits, at, labels)] = asked
    whole = armrig.load(here / "f.mcap").dataset()
    np.testing.assert_array_equal(data.y, whole.y[50:275])
    assert at == horizon
    assert labels == ["good", "poor", "handout", "J_2=0.006"]
    for fit, name in zip(fits, ("good", "poor"), strict=False):
        assert fit.theta.tolist() == armrig.load_fit(here / f"{name}.json").theta.tolist()
    for rig, p in zip(fits[2:], (ArmParameters(), ArmParameters(J_2=0.006)), strict=True):
        assert rig.F.tolist() == armrig.physical_model(p, data).F.tolist()


def _row(name: str, **changes: Any) -> Any:
    of = {"fit_percent": 9.5, "rms_error": 0.0123456, "velocity_fit_percent": None}
    return SimpleNamespace(**of | {"name": name, "on_estimation_data": False} | changes)


class _Table(ComparisonTable):
    def explain(self, *, brief: bool = False) -> str:
        return "OE is the best." + "\nOE differs." * 6

    def table(self, *, brief: bool = False) -> str:
        return "the table"


@pytest.mark.parametrize(
    ("horizon", "how"), [(None, "simulated"), (7, "predicted 7 samples ahead")]
)
def test_a_comparison_begins_with_the_best_and_has_a_line_for_each_model(
    horizon: int | None, how: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [_row("OE"), _row("the physics of it", velocity_fit_percent=3.0)]
    table = _Table(rows=tuple(rows), horizon=horizon, unit="rad", note="", data=None)  # type: ignore[arg-type]
    fits = [
        *("OE is the best.", f"{how} on F"),
        "  OE                 fit    9.50 %  rms 0.01235 rad",
        "  the physics of it  fit    9.50 %  rms 0.01235 rad  velocity fit    3.00 %",
    ]

    print_comparison(table, "on F", verbose=False)
    *short, more = capsys.readouterr().out.splitlines()
    print_comparison(table, "on F", verbose=True)
    whole = capsys.readouterr().out.splitlines()

    assert short == [*fits, *["OE differs."] * 4]
    assert more.startswith("--verbose: 2 more differences, ")
    assert whole == [*fits, "the table", *["OE differs."] * 6]


def test_models_are_the_same_by_their_polynomials_and_their_sampling_time() -> None:
    of = {name: np.array([1.0, 0.5, -0.25]) for name in "ABCDF"} | {"Ts": 0.01}

    def model(**changes: Any) -> Any:
        return SimpleNamespace(**of | changes)

    assert _same(model(), model())
    assert not _same(model(), model(Ts=0.02))
    for name in "ABCDF":
        assert _same(model(), model(**{name: np.array([1.0, 0.5, -0.25 - 1e-8])}))
        assert not _same(model(), model(**{name: np.array([1.0, 0.5, -0.25 - 1e-5])}))
        assert not _same(model(), model(**{name: np.array([1.0, 0.5])}))


def test_a_row_has_what_is_known_of_a_model() -> None:
    full = _row("OE", velocity_fit_percent=-3.0, on_estimation_data=True)

    assert row_line("OE", _row("OE"), "rad") == "  OE  fit    9.50 %  rms 0.01235 rad"
    assert row_line("OE", full, "") == (
        "  OE  fit    9.50 %  rms 0.01235  velocity fit   -3.00 %  (estimation data)"
    )
