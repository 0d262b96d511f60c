"""Data of which a test must not decide more than the data show, from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig.numerics.polynomial import apply_filter
from numpy.typing import NDArray

Vector = NDArray[np.float64]
COLUMNS = ["--input", "heater", "--signal", "temp"]


def written(path: Path, u: Vector, y: Vector) -> str:
    """Write a table of u and y; return its name."""
    table = np.column_stack([np.arange(u.size), u, y])
    np.savetxt(path, table, "%.6g", ",", header="time,heater,temp", comments="")
    return str(path)


def lag(u: Vector, seed: int = 1, *, pole: float = 0.95, noise: float = 0.02) -> Vector:
    """Return the response of a lag of gain 1 with noise."""
    rng = np.random.default_rng(seed)
    return apply_filter([0.0, 1 - pole], [1.0, -pole], u) + noise * rng.standard_normal(u.size)


@pytest.fixture
def constant(tmp_path: Path) -> str:
    """Give a table of a lag that warms up from 22.5 under a constant input."""
    u = np.full(300, 50.0)
    return written(tmp_path / "constant.csv", u, 22.5 + lag(0.8 * u, pole=0.98, noise=0.1))


def said(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    """Return exit code, output and errors of a command."""
    code = main([*arguments, *COLUMNS])
    out, err = capsys.readouterr()
    assert "Traceback" not in err
    return code, out, err


def test_an_assumption_reaches_the_tests_of_a_given_structure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    u = armrig.telegraph(400, 0.1, 0.0, 4.0, seed=3)
    y = apply_filter([0.0, 0.1], [1.0, -1.0], u - 2) + 0.02 * np.random.default_rng(
        1
    ).standard_normal(400)
    table = written(tmp_path / "level.csv", u - 2, y)
    line = f"identify {table} --structure n4sid --order 1".split()

    _, decided, _ = said(line, capsys)
    _, assumed, after = said([*line, "--assume", "settling"], capsys)

    assert "! integrator: temp behaves as an integrating output" in decided
    assert "if it settles" in decided
    assert "behaves as an integrating output" not in assumed
    assert assumed.startswith("temp is taken as settling, as --assume says\n")
    assert "--integrator" not in after


def test_a_constant_input_does_not_show_a_level(
    constant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The level seemed to be 9 standard deviations from 0, and --offset found a gain of -1e11."""
    line = ["identify", constant, "--structure", "oe", "--nb", "1", "--nf", "1"]

    code, out, after = said(line, capsys)

    assert code == 0
    assert out.count("u is constant: gain and level cannot be distinguished") == 1
    assert "standard deviations from 0" not in out
    assert "--offset" not in after
    for option in ("--offset", "--detrend", "--search"):
        code, out, err = said(
            [*line[:2], option] if option == "--search" else [*line, option], capsys
        )
        assert (code, out.count("fits")) == (1, 0)
        assert "u is constant: gain and level cannot be distinguished" in err
    code, _, err = said(
        ["identify", constant, "--structure", "arx", "--na", "1", "--nb", "1", "--detrend"], capsys
    )
    assert code == 1
    assert "u is constant: gain and level cannot be distinguished" in err


def test_a_search_of_one_step_recommends_other_data(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a response in the second half, the search chose a double integrator."""
    step = np.repeat([0.0, 2.0], [30, 270])
    table = written(tmp_path / "step.csv", step, lag(step, pole=0.98))
    line = ["identify", table, "--search", "--max-order", "2", "--structure", "oe", "--detrend"]

    assert main([*line, "--json", *COLUMNS]) == 0

    found = json.loads(capsys.readouterr().out)
    assert found["parameters"]["f1"]["value"] == pytest.approx(-0.98, abs=0.01)
    assert any("u moves in one part of the data only" in r for r in found["search"]["reasons"])


def test_a_search_splits_the_data_so_that_the_input_changes_in_both_parts() -> None:
    """The pulses end at sample 160 of 400."""
    u = np.append(np.tile(np.repeat([0.0, 2.0], 20), 4), np.zeros(240))

    found = armrig.search(
        armrig.Dataset(u=u, y=lag(u, noise=0.05), Ts=1.0), families=["oe"], orders=[1, 2]
    )

    assert found.chosen.candidate.order == 1
    assert found.fit.poles().values.real[0] == pytest.approx(0.95, abs=0.01)
