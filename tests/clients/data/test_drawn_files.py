"""Drawn files: each is read rightly, doubted in the first line, or refused with a way out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from armrig import Signals
from armrig_core.errors import FileError

from tests import drawn_files
from tests.drawn_files import read_case, run


def test_a_drawn_file_is_read_rightly_or_refused_with_a_way_out() -> None:
    """10 files from a fresh seed; `python -m tests.drawn_files SEED 300` judges a bank."""
    seed = int(np.random.default_rng().integers(1_000_000))
    judged = [(i, *run(seed, i)) for i in range(10)]

    by_kind = {
        wanted: [
            f"case {i}: {why}, {case.dialect}" for i, case, kind, why in judged if kind == wanted
        ]
        for wanted in ("wrong", "stuck")
    }
    assert by_kind["wrong"] == [], f"seed {seed}"
    # Of 150 cases of seed 77, one was refused without a way out.
    assert len(by_kind["stuck"]) < 2, f"seed {seed}: {by_kind['stuck']}"


def changed(z: Signals, **fields: object) -> Signals:
    """Return data with other fields and without doubts."""
    given = {"u": z.u, "y": z.y, "Ts": z.Ts, "starts": z.starts, "inputs": z.inputs}
    given |= {"outputs": z.outputs, "units": z.units, "input_units": z.input_units}
    return Signals(**(given | fields))  # type: ignore[arg-type]


def refuse(z: Signals) -> Signals:
    raise FileError("no way out")


PLANTED: dict[str, Callable[[Signals], Signals]] = {
    "u a row late": lambda z: changed(z, u=np.roll(z.u, 1, axis=0)),
    "rows turned round": lambda z: changed(z, u=z.u[::-1], y=z.y[::-1]),
    "milliseconds as seconds": lambda z: changed(z, Ts=1000 * z.Ts),
    "another value": lambda z: changed(z, y=z.y * np.where(np.arange(z.N) == 9, 1.1, 1)[:, None]),
    "rows lost": lambda z: changed(z, u=z.u[:50], y=z.y[:50], starts=[0]),
    "rows joined": lambda z: changed(z, u=z.u[::2], y=z.y[::2], starts=[0]),
    "a refusal": refuse,
}


@pytest.mark.parametrize("bug", PLANTED)
def test_the_judge_sees_a_planted_bug(bug: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawn_files, "read_case", lambda *of: PLANTED[bug](read_case(*of)))

    kinds = [run(4, i)[1] for i in range(5)]

    assert {"wrong", "stuck"} & {*kinds}
    assert "right" not in kinds
