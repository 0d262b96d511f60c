"""The report: complete, true to its recordings, and honest about what went wrong."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from armrig.dataset import Dataset
from armrig.recording import RecordingError, load
from armrig.report import content, report, role
from armrig.report_figures import write_figures
from armrig.study import Orders, Study, physical_model, study
from armrig.verdict import verdict
from armrig_core.arm import ArmParameters, arm_matrices, zero_order_hold
from recordings import recorded, sample, written


@pytest.fixture(scope="module")
def done(three_recordings: tuple[Path, Path, Path]) -> Study:
    """Give a study of a step, a telegraph and a telegraph for validation."""
    return study([load(path) for path in three_recordings])


def test_the_report_is_a_pdf_of_three_to_six_pages(done: Study, tmp_path: Path) -> None:
    """Typeset without a network, with its fonts inside."""
    path = report(done, tmp_path / "report.pdf")

    pdf = path.read_bytes()
    assert pdf.startswith(b"%PDF-")
    pages = re.search(rb"/Type/Pages/Count (\d+)", pdf)
    assert pages is not None
    assert 3 <= int(pages[1]) <= 6
    assert pdf.count(b"/FontFile") >= 3


def test_every_figure_names_its_recording(done: Study, tmp_path: Path) -> None:
    """As text in the SVG, so that it can be searched for."""
    figures = {path.stem: path.read_text() for path in write_figures(done, tmp_path)}

    hashes = {r.manifest.experiment: r.short_hash for r in done.recordings[:1]}
    of_estimation = {"timing", "data", "bode", "step_poles"}
    of_validation = {"data", "compare", "velocity", "residuals"}
    assert set(figures) == of_estimation | of_validation | {"step"}
    assert hashes["step"] in figures["step"]
    assert all(done.estimation.source[:12] in figures[name] for name in of_estimation)
    assert all(done.validation.source[:12] in figures[name] for name in of_validation)


def test_recordings_get_the_roles_that_their_order_says(done: Study) -> None:
    """The first that is no step estimates, the next validates."""
    assert [role(done, r) for r in done.recordings] == ["step", "estimation", "validation"]


def test_one_recording_is_cut_in_two(three_recordings: tuple[Path, ...]) -> None:
    """A model is never judged by the data that it was made from."""
    halved = study([load(three_recordings[1])])

    assert halved.halves
    assert halved.estimation.N + halved.validation.N == 1500
    assert not any(row.on_estimation_data for row in halved.table.rows)
    assert role(halved, halved.recordings[0]) == "estimation and validation"


def test_a_step_alone_is_nothing_to_identify_from(three_recordings: tuple[Path, ...]) -> None:
    """It says what to record."""
    with pytest.raises(RecordingError, match="armrig collect blackbox"):
        study([load(three_recordings[0])])


def test_orders_too_high_for_the_data_are_refused(tmp_path: Path) -> None:
    """What came, and what so many samples allow."""
    short = load(written(tmp_path, recorded([sample(k) for k in range(20)])))

    with pytest.raises(ValueError, match="na=4, nb=4: 8 parameters from 10 samples; at most 1"):
        study([short])
    with pytest.raises(ValueError, match="nb=0"):
        study([short], orders=Orders(nb=0))


def test_the_physics_as_a_model_is_the_physics() -> None:
    """Its impulse response is C Phi^(k-1) Gamma, its F has the root 1."""
    A, B, C = arm_matrices(ArmParameters())
    data = study_data()
    Phi, Gamma = zero_order_hold(A, B, data.Ts)
    fit = physical_model(ArmParameters(), data)
    pulse = np.zeros(50)
    pulse[0] = 1.0

    expected = [0.0]
    x = Gamma[:, 0]
    for _ in range(49):
        expected.append(float(C[0] @ x))
        x = Phi @ x

    np.testing.assert_allclose(fit.simulate(pulse), expected, rtol=1e-9, atol=1e-15)
    assert abs(np.polyval(fit.F, 1.0)) < 1e-12


def test_the_oe_model_meets_the_physics(done: Study) -> None:
    """Through recording, unwrapping and estimation: median deviation below one per cent."""
    assert np.median(done.deviation[1]) < 0.01
    assert done.table.rows[1].rms_error < 0.006  # one step of ten bits


def test_the_verdict_says_what_came_out(done: Study) -> None:
    """ARX and OE disagree on this rig, and samples are missing: both are said."""
    said = " ".join(verdict(done))

    assert "For simulation and for control use the OE model" in said
    assert "5 samples are missing" in said
    assert "\n" not in said


def test_the_verdict_changes_with_the_facts(done: Study) -> None:
    """Where the models agree it does not say that they disagree."""
    arx, oe, physics = done.table.rows
    agreeing = replace(done.table, rows=(replace(arx, rms_error=oe.rms_error), oe, physics))

    assert "disagree" not in " ".join(verdict(replace(done, table=agreeing)))


def test_the_report_says_where_the_models_leave_the_physics(done: Study) -> None:
    """Computed from these data: another deviation is said to lie elsewhere."""
    deviation = np.full_like(done.deviation, 0.01)
    deviation[0, 20], deviation[1, 150] = 0.5, 0.25

    said = str(content(replace(done, deviation=deviation), ())["physics"])

    oe, arx = said.split("; the ARX model")
    assert oe.endswith(f"at most 25\u00a0%, at {done.omega[150]:.3g} rad/s")
    assert arx.endswith(f"and 50\u00a0%, at {done.omega[20]:.3g} rad/s.")


def test_the_sample_after_the_dead_band_is_counted_and_named(done: Study) -> None:
    """It shows no angle either, and the row says that it is among them."""
    rows = {name: values for name, *values in content(done, ())["facts"]}

    hidden = [np.count_nonzero(r.present & ~r.valid) for r in done.recordings]
    assert rows["in the dead band, or just after"] == [str(n) for n in hidden]


def test_a_truncated_recording_is_named_in_the_report(
    three_recordings: tuple[Path, ...], tmp_path: Path
) -> None:
    """A cut file is used for what it holds, and the reader is told."""
    whole = three_recordings[1].read_bytes()
    cut = load(written(tmp_path, whole[: len(whole) * 3 // 4], "cut.mcap"))
    done = study([cut, load(three_recordings[2])])

    assert cut.truncated
    assert "cut.mcap is not whole" in " ".join(content(done, ())["remarks"])


def study_data() -> Dataset:
    """Return two samples at 100 Hz."""
    return Dataset(u=np.zeros(2), y=np.zeros(2), Ts=0.01, output="theta_1", unit="rad")
