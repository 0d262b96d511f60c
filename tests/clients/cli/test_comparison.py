"""`armrig compare` and `armrig simulate` of saved models on a short recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig.data.dataset import Signals
from armrig.validation.answer import closest
from armrig.validation.comparison import Comparison, ComparisonTable
from armrig_core.rig.arm import ArmParameters

from tests.clients.made_recordings import of_the_arm, written
from tests.clients.models.made_fits import made


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

    monkeypatch.setattr("armrig.compare", compared)
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
        assert rig.F.tolist() == armrig.physics.physical_model(p, data).F.tolist()


def _table(horizon: int | None, **rms: list[float]) -> ComparisonTable:
    """Return a comparison of models by their errors of the outputs y and z."""
    model, data = made(), Signals(u=[0.0, 1.0], y=np.eye(2), Ts=1.0, outputs=["y", "z"])
    rows = [
        Comparison(
            name=name, output=output, unit=unit, fit_percent=100 - e, rms_error=e, y=np.zeros(2),
            velocity_fit_percent=None, on_estimation_data=False, model=model,
        )
        for name, errors in rms.items()
        for output, unit, e in zip("yz", ("rad", ""), errors, strict=True)
    ]  # fmt: skip
    return ComparisonTable(rows=tuple(rows), horizon=horizon, note="", data=data)


@pytest.mark.parametrize(
    ("horizon", "rms", "said"),
    [
        (None, {"a": [1, 5], "b": [2, 4]}, "Simulated, a has the least error of y and b has"),
        (None, {"a": [3, 5], "b": [2, 4]}, "Simulated, b has the least error of y and z."),
        (7, {"a": [3, np.nan], "b": [4, 9]}, "Predicted 7 ahead, a has the least error of y"),
        (2, {"a": [3, 5]}, "Predicted 2 ahead, a fits y to 97.00 % (rms 3 rad) and z to 95.00 %"),
    ],
)
def test_the_model_with_the_least_error_is_named_for_each_output(
    horizon: int | None, rms: dict[str, list[float]], said: str
) -> None:
    assert closest(_table(horizon, **rms)).startswith(said)
