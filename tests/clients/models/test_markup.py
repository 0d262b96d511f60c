"""A model's equation for Typst."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typst
from armrig.data.dataset import Dataset
from armrig.estimation.arx import arx
from armrig.estimation.bj import bj
from armrig.models.fit import Fit
from armrig.numerics.polynomial import filtered


@pytest.fixture(scope="module")
def fits() -> tuple[Fit, ...]:
    """Return models of several forms, one with tiny and one with unknown deviations."""
    u, e = np.random.default_rng(0).standard_normal((2, 300))
    y = filtered([0, 1.0, 0.5], [1, -1.2, 0.6], u) + filtered([1], [1, -0.7], 0.3 * e)
    data = Dataset(u=u, y=y, Ts=1.0)
    whole = bj(data, nb=2, nc=1, nd=1, nf=2, starts="few")
    tiny, unknown = (replace(whole, covariance=x * np.eye(6)) for x in (1e-20, np.nan))
    return (
        whole,
        arx(data, na=2, nb=1),
        bj(data, nb=2, nc=0, nd=1, nf=2, starts="few"),
        tiny,
        unknown,
    )


def test_typst_takes_the_equation(fits: tuple[Fit, ...], tmp_path: Path) -> None:
    source = tmp_path / "equations.typ"
    source.write_text("\n\n".join(fit.typst() for fit in fits), encoding="utf-8")

    assert typst.compile(str(source)).startswith(b"%PDF")
