"""The report of both outputs of the rig: models of both, with results for each output."""

from __future__ import annotations

from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig.recordings.files.loading import load
from armrig.report.model_facts import conclusions
from armrig.report.study import Orders, Study, each_output, study
from armrig.report.study_sections import study_contents
from armrig.validation import answer
from armrig_core.errors import InputError

from tests.clients.report.conftest import section_of


@pytest.fixture(scope="module")
def both(three_recordings: tuple[Path, Path, Path]) -> Study:
    """Give the study of both outputs."""
    return study([load(path) for path in three_recordings], outputs=("theta_1", "alpha"))


def test_both_outputs_have_the_poles_of_one_model(both: Study) -> None:
    theta_1, alpha = (one.estimated[1].model for one in each_output(both))

    np.testing.assert_allclose(theta_1.F, np.convolve([1.0, -1.0], alpha.F), atol=1e-12)
    assert [one.output for one in each_output(both)] == ["theta_1", "alpha"]


def test_a_model_of_both_outputs_has_smaller_deviations_of_its_poles(
    both: Study, done: Study
) -> None:
    pair = [np.sort(x.best.model.poles().std)[1] for x in (both, done)]

    assert pair[0] < 0.7 * pair[1]


def test_the_numbers_of_each_output_are_those_of_the_model_of_both(
    both: Study, three_recordings: tuple[Path, Path, Path]
) -> None:
    first, other = (armrig.load(path).signals() for path in three_recordings[1:])
    oe = armrig.oe(first, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
    arx = armrig.arx(first, na=[[4, 0], [0, 3]], nb=[[4], [3]])

    for i, fit in enumerate((arx, oe)):
        table = armrig.compare(other, fit)
        rms = [one.estimated[i].comparison.rms_error for one in each_output(both)]
        np.testing.assert_allclose(rms, [row.rms_error for row in table], rtol=1e-3)
    tests = armrig.residuals(oe, other)
    together = both.estimated[1].together
    assert together is not None
    assert together.white.p_value == pytest.approx(tests.white.p_value)
    assert together.missing_dynamics == pytest.approx(tests.missing_dynamics)
    assert f"OE, all outputs together, on the validation data. {answer.tests_sentence(tests)}." in (
        conclusions(both)
    )


def test_each_table_has_rows_for_each_output(both: Study) -> None:
    [fits], [tests] = (section_of(both, title).tables for title in ("Results", "Validation"))
    assert [row[0] for row in fits.rows] == ["θ₁", "", "", "α", "", ""]
    assert [row[1] for row in fits.rows] == ["ARX", "OE", "physics"] * 2
    assert [row[4] == "–" for row in fits.rows] == [False] * 3 + [True] * 3
    assert [row[1] for row in tests.rows] == ["together", "θ₁", "α"] * 3
    assert all(len(row) == len(table.header) for table in (fits, tests) for row in table.rows)
    models = section_of(both, "Models")
    names = [table.header[0] for table in models.tables]
    assert names == ["ARX of θ₁", "OE of θ₁", "ARX of α", "OE of α"]
    assert [f.name for f in section_of(both, "Results").figures] == ["compare", "compare-alpha"]
    assert models.paragraphs[0].startswith(
        "The orders are na = 4, nb = 4, nk = 1 (ARX of θ₁); nb = 4, nf = 4, nk = 1 (OE of θ₁); na "
    )


def test_a_report_may_have_only_the_output_alpha(three_recordings: tuple[Path, Path, Path]) -> None:
    found = study([load(path) for path in three_recordings], outputs=("alpha",))

    assert found.best.model.orders == {"nb": 3, "nf": 3, "nk": 1}
    assert np.median(found.best.deviation) < 0.02
    [fits] = section_of(found, "Results").tables
    assert fits.header == ("model", "fit of the angle", "rms error")
    assert "to the arm angle α were estimated" in study_contents(found, ()).front.paragraphs[0]
    assert "never negative" not in section_of(found, "Data").paragraphs[0]


@pytest.mark.parametrize(
    ("outputs", "orders", "match"),
    [
        (("velocity",), Orders(), "velocity: the models of a report have the output theta_1 or"),
        (("theta_1", "theta_1"), Orders(), "theta_1, theta_1: the models of a report"),
        (("theta_1", "alpha"), Orders(nb=1), "nb=1, nf=4: the models of alpha have one"),
    ],
)
def test_outputs_and_orders_without_a_report_are_refused(
    outputs: tuple[str, ...],
    orders: Orders,
    match: str,
    three_recordings: tuple[Path, Path, Path],
) -> None:
    with pytest.raises(InputError, match=match):
        study([load(three_recordings[1])], orders=orders, outputs=outputs)  # type: ignore[arg-type]
