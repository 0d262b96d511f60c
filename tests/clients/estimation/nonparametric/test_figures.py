"""Figures of estimates without a structure show what they say and name their recording."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from armrig.estimation.nonparametric.bla import bla
from armrig.estimation.nonparametric.correlation import correlation
from armrig.estimation.nonparametric.etfe import etfe
from armrig.estimation.nonparametric.impulse import impulse_response
from armrig.estimation.nonparametric.sampling_time import sampling_time
from armrig.estimation.nonparametric.spectral import spa
from armrig.estimation.nonparametric.step_analysis import step_analysis
from armrig.validation.structure_hints import structure_hints
from matplotlib import pyplot as plt
from matplotlib.figure import Figure


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """Draw without a screen, and leave no figure open."""
    with mpl.rc_context({"backend": "agg"}):
        yield
        plt.close("all")


def periodic(arm: Any) -> Any:
    """Return four periods of noise."""
    return arm.dataset(np.tile(np.random.default_rng(1).uniform(0, 5, 100), 4), 1e-3)


RESULTS: dict[str, Callable[[Any], Any]] = {
    "impulse": lambda arm: impulse_response(arm.telegraph(), 40),
    "plain": lambda arm: impulse_response(arm.telegraph(), 30, None, 5, integrator=False),
    "correlation": lambda arm: correlation(arm.telegraph()),
    "spa": lambda arm: spa(arm.telegraph(), "log"),
    "etfe": lambda arm: etfe(periodic(arm)),
    "bla": lambda arm: bla([periodic(arm), periodic(arm)]),
    "step": lambda arm: step_analysis(arm.steps()),
    "sampling": lambda arm: sampling_time(arm.telegraph()),
    "structure": lambda arm: structure_hints(arm.telegraph()[:500]),
}


@pytest.mark.parametrize("made", RESULTS.values(), ids=RESULTS.keys())
def test_a_result_plots_itself(made: Callable[[Any], Any], arm: Any) -> None:
    result = made(arm)
    ax = Figure().add_subplot()

    assert result.plot(ax=ax) is ax.figure
    assert plt.get_fignums() == []
    ax.figure.canvas.draw()
    assert "abcdef012345" in ax.get_title(loc="right")
    assert result.plot().axes[0].has_data()
    assert len(plt.get_fignums()) == 1
    assert not re.search(r"\bnan\b", repr(result))


def test_the_band_about_zero_is_where_coefficients_are_judged(second: Any) -> None:
    found = impulse_response(
        second.dataset(np.random.default_rng(1)), 30, kernel=None, integrator=False
    )

    [ax] = found.plot(level=0.95).axes

    band = np.max(np.abs(ax.collections[0].get_paths()[0].vertices[:, 1]))
    assert band == pytest.approx(float(np.max(found.band(0.95))), rel=1e-6)
    assert "95 % confidence" in ax.get_legend().get_texts()[0].get_text()
