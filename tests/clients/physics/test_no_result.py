"""Without a result no number is printed: the message has the data, the need, the remedy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig.data.dataset import Dataset
from armrig_core.errors import InputError

from tests.clients import pages
from tests.clients.chassis_data import Make

INPUTS = {"three": [1.0, 4.0, 1.0], "ten": [1.0, 4.0] * 5, "zero": [0.0] * 500}


@pytest.fixture(scope="module")
def bad(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with recordings of the chassis without information."""
    folder = tmp_path_factory.mktemp("bad")
    record: Any = pages.script("experiments.py").record
    for name, u in INPUTS.items():
        record(folder / f"{name}.mcap", np.array(u), 0.01, "greybox", arm_removed=True)
    return folder


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the one or two last lines of a command; it prints no number."""
    assert main(list(arguments)) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") <= 2
    return printed.err


@pytest.mark.parametrize(("command", "needed"), [("greybox", 5), ("split", 5), ("check", 85)])
def test_three_samples_are_too_few(
    bad: Path, capsys: pytest.CaptureFixture[str], command: str, needed: int
) -> None:
    said = refused(capsys, command, str(bad / "three.mcap"))

    assert "3 samples" in said
    assert f"at least {needed}" in said
    assert "record longer" in said


def test_an_inertia_without_motion_is_not_identifiable(
    bad: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for more in ((), ("--json",)):
        said = refused(capsys, "greybox", str(bad / "zero.mcap"), *more)

        assert "the data do not determine J_1: no effect on the output" in said
        assert "excite the rig more" in said


def test_an_error_names_a_part_without_information(make: Make) -> None:
    data = make(N=2000)
    still = Dataset(
        u=np.where(np.arange(2000) < 900, data.u, 0.0),
        y=np.where(np.arange(2000) < 1000, data.y, data.y[1000])
        + 1e-3 * np.random.default_rng(1).standard_normal(2000),
        Ts=data.Ts,
        output="theta_1",
        unit="rad",
    )

    with pytest.raises(ValueError, match=r"part 2 of 2: .*J_1"):
        armrig.split_study(still, (2,))


def test_a_search_without_convergence_has_no_result(make: Make) -> None:
    fit = armrig.greybox(make(N=1000))
    fit.require_result()

    with pytest.raises(InputError, match="J_1 did not converge, so there is no result"):
        replace(fit, converged=False).require_result()
