"""Options of `armrig design` reach the law, and its file is the law that was checked."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.cli import main


@pytest.fixture
def model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> armrig.Fit:
    """Give a model of a lag, saved as model.json in the working folder."""
    monkeypatch.chdir(tmp_path)
    u = armrig.prbs(400, clock=4, low=0.0, high=4.0, seed=1)
    y = np.zeros(400)
    for k in range(1, 400):
        y[k] = 0.9 * y[k - 1] + 0.1 * u[k - 1]
    y += 0.02 * np.random.default_rng(1).standard_normal(400)
    fit = armrig.oe(armrig.Dataset(u=u, y=y, Ts=0.05, input_unit="V"), nb=1, nf=1)
    fit.save("model.json")
    return fit


@pytest.mark.parametrize(
    ("line", "design", "named"),
    [
        ("pid", "pid", {}),
        ("pid --time-constant 0.4 --weight 0.7", "pid", {"time_constant": 0.4, "weight": 0.7}),
        ("pid --ms 1.4 --derivative", "pid", {"ms": 1.4, "derivative": True}),
        ("pid --filter-time 0.2 --no-derivative", "pid", {"filter_time": 0.2}),
        ("pid --u0 2 --y0 1.5", "pid", {"u0": 2.0, "y0": 1.5}),
        ("pid --reference=0,1.5", "pid", {"reference": (0.0, 1.5)}),
        (
            "place --pole=-3 --observer=-8+2j",
            "place",
            {"poles": [-3], "observer": [-8 + 2j, -8 - 2j]},
        ),
        ("lqg --effort 0.3 --drift 0.05", "lqg", {"effort": 0.3, "drift": 0.05}),
        ("lqg --input-noise 0.3", "lqg", {"input_noise": 0.3}),
    ],
)
def test_the_file_is_the_law_of_the_function(
    line: str,
    design: str,
    named: dict[str, Any],
    model: armrig.Fit,
    capsys: pytest.CaptureFixture[str],
) -> None:
    command, *options = line.split()
    assert main(["design", command, "model.json", *options, "--draws", "20", "--json"]) == 0

    law = armrig.control.load_law("law.json")
    expected = getattr(armrig.control, design)(model, **named)
    assert (law.A, law.B, law.C, law.D) == (expected.A, expected.B, expected.C, expected.D)
    assert (law.u0, law.x0, law.reference) == (expected.u0, expected.x0, expected.reference)
    facts = json.loads(capsys.readouterr().out)
    assert facts["sha256"] == law.sha256
    assert facts["corners"].keys() == {"gain -20 %", "gain +20 %", "one more sample of delay"}


def test_check_reads_the_model_that_the_law_names(
    model: armrig.Fit, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["design", "lqg", "model.json", "-o", "lqg.json", "--draws", "50"]) == 0
    designed = capsys.readouterr().out
    assert main(["design", "check", "lqg.json", "--draws", "50"]) == 0
    assert capsys.readouterr().out == designed

    Path("model.json").unlink()
    assert main(["design", "check", "lqg.json"]) == 1
    assert "model.json: No such file" in capsys.readouterr().err


def test_a_requirement_is_part_of_the_law(
    model: armrig.Fit, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["design", "pid", "model.json", "--draws", "20", "--settling", "0.05"]
    assert main(line) == 0
    assert "misses the requirement (5 % settling at most 0.05 s)" in capsys.readouterr().out
    assert armrig.control.load_law("law.json").design["requirement"] == {"settling": 0.05}

    assert main([*line, "--overshoot=-1"]) == 1
    assert "--overshoot -1: must be 0 % or more" in capsys.readouterr().err
