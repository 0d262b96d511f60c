"""The report: complete, true to its recordings, and honest about what went wrong."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import armrig
import msgspec
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.experiments import Trend
from armrig.numerics.quantities import NBSP
from armrig.physics.systems import physical_model
from armrig.recordings.daemon_reports import Note
from armrig.recordings.files.loading import load
from armrig.report.document import report
from armrig.report.figures import write_figures
from armrig.report.model_facts import conclusions
from armrig.report.recording_facts import role, treatment
from armrig.report.sections import Contents
from armrig.report.study import Study, assess_fits, study
from armrig.report.study_sections import study_contents
from armrig.report.typesetting import latest_start as recorded_at
from armrig_core.rig.arm import ArmParameters
from armrig_core.rig.calibration import Calibration, Made
from armrig_core.rig.description import builtin
from matplotlib import figure
from matplotlib.text import Text

from tests.clients.made_recordings import of_the_arm, written
from tests.clients.models.made_fits import changed
from tests.clients.report.conftest import at_rest, section_of

NOTE = Note(t=1.5, text='#panic() *x* $y$ `#eval("1")` \\ [z] @nobody', owner="#panic() <b>")
"""Markup, which a report prints as text."""


@pytest.fixture(scope="module")
def of_three(done: Study) -> Study:
    """Give the study with a third model, which comes first."""
    armax = armrig.armax(done.estimation, na=4, nb=4, nc=1, integrator=True)
    fits = {"ARMAX": armax} | {m.name: m.model for m in done.estimated}
    recordings = tuple(
        replace(r, manifest=msgspec.structs.replace(r.manifest, run_id=f"run-{k}"), notes=(NOTE,))
        for k, r in enumerate(done.recordings, 1)
    )
    physics = physical_model(ArmParameters(), done.estimation)
    models = assess_fits(fits, physics, done.validation)
    return replace(done, recordings=recordings, **models)


@pytest.fixture(scope="module")
def made(of_three: Study, tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, Path]:
    """Give the bytes of a report of three models, and where its figures were left.

    One of two models is made in test_files_written.py.
    """
    return typeset_with_figures(of_three, tmp_path_factory.mktemp("report"))


@pytest.fixture(scope="module")
def drawn(of_three: Study) -> dict[str, figure.Figure]:
    """Give the figures of a report of three models by name: drawn, and not written to files."""
    figures: dict[str, figure.Figure] = {}
    with pytest.MonkeyPatch.context() as patch:
        keep = figures.__setitem__
        patch.setattr("armrig.report.figures.save", lambda of, path: keep(path.stem, of))
        paths = write_figures(study_contents(of_three, ()), of_three.recordings, Path())
    assert [path.stem for path in paths] == list(figures)
    return figures


def texts(of: figure.Figure) -> str:
    """Return all texts of a figure."""
    return "\n".join(text.get_text() for text in of.findobj(Text))


def typeset_with_figures(study: Study, folder: Path) -> tuple[bytes, Path]:
    """Typeset a study; return the PDF's bytes and the folder of its figures."""
    return report(study, folder / "report.pdf", figures=folder).read_bytes(), folder


def test_every_figure_names_its_recording(done: Study, drawn: dict[str, figure.Figure]) -> None:
    found = {name: texts(one) for name, one in drawn.items()}

    of_estimation = {"timing", "data", "bode", "step_poles"}
    of_validation = {"data", "compare", "velocity", "residuals"}
    assert set(found) == of_estimation | of_validation | {"step"}
    assert "@run-1" in found["step"]
    assert all("@run-2" in found[name] for name in of_estimation)
    assert all("@run-3" in found[name] for name in of_validation)
    assert not any(r.short_hash in text for r in done.recordings for text in found.values())
    assert found["data"].index("@run-2") < found["data"].index("@run-3")


def test_a_report_writes_a_copy_of_each_figure(
    done: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(_: Contents, __: Any, root: Path) -> tuple[Path, ...]:
        for name in "abc":
            (root / f"{name}.svg").write_text(name)
        return tuple(sorted(root.glob("*.svg")))

    fakes: dict[str, Any] = {"document.write_figures": write}
    fakes["typesetting.compile_pdf"] = lambda _: (b"a report", [("end", 1.0)])
    for name, fake in fakes.items():
        monkeypatch.setattr(f"armrig.report.{name}", fake)

    pdf = report(done, tmp_path / "r.pdf", figures=tmp_path, source=tmp_path / "source")

    assert {path.name: path.read_text() for path in tmp_path.glob("*.*")} == {
        **{f"{name}.svg": name for name in "abc"},
        "r.pdf": "a report",
    }
    assert pdf == tmp_path / "r.pdf"
    assert {path.name for path in (tmp_path / "source").iterdir()} == {
        *("a.svg", "b.svg", "c.svg", "report.typ", "data.json")
    }


def test_the_title_of_a_report_contains_the_title_of_the_rig(done: Study) -> None:
    titles = []
    for title in ("Arm 7", ""):
        rig = msgspec.structs.replace(builtin("arm").rig, title=title)
        described = replace(builtin("arm"), rig=rig)
        recordings = tuple(replace(r, description=described) for r in done.recordings)
        titles.append(study_contents(replace(done, recordings=recordings), ()).title)

    assert titles == ["Arm 7: black-box identification", "arm: black-box identification"]


def test_a_report_has_the_date_of_its_newest_recording(done: Study) -> None:
    def date(*started: str) -> str:
        recording = done.recordings[0]
        manifests = (msgspec.structs.replace(recording.manifest, started=at) for at in started)
        return f"{recorded_at([replace(recording, manifest=m) for m in manifests]):%Y-%m-%d %H:%M}"

    assert date("2026-01-02T00:30:00+02:00", "2026-01-01T23:00:00+00:00", "no date") == (
        "2026-01-01 23:00"
    )
    assert date("2026-01-02T00:30:00-02:00", "2026-01-01T23:00:00+00:00") == "2026-01-02 02:30"
    assert date("2026-01-02T00:30:00") == "2026-01-02 00:30"
    assert date("no date") == date() == "1970-01-01 00:00"


def test_every_step_of_treatment_is_reported_in_words(three_recordings: tuple[Path, ...]) -> None:
    step, first, second = (load(path) for path in three_recordings)

    def treat(data: Dataset) -> Dataset:
        return armrig.detrend(armrig.hampel(data)[100:])

    told = treatment(study([step, first, second], treat=treat))

    names = [sentence.partition(":")[0] for sentence in told]
    assert names == ["Estimation data"] * 4 + ["Validation data"] * 4
    assert "samples of theta_1 missing as outliers" in told[0]
    assert "took samples 100 to 1499 of 1500" in told[1]
    assert "removed the mean from u and y" in told[2]
    level = np.mean(first.dataset()[100:].u)
    assert told[3].startswith(f"Estimation data: {level:.3g}\xa0V of u and ")
    assert told[3].endswith("\xa0rad of theta_1 removed from the data.")


def test_a_removed_line_is_reported_with_its_slope(done: Study) -> None:
    trend = Trend(u_level=2.5, y_level=1.0, y_slope=-0.25)
    data = done.estimation.replaced(step="removed a straight line", trends=(trend,))

    told = treatment(replace(done, estimation=data))

    assert told[1] == (
        "Estimation data: 2.5\xa0V of u and 1\xa0rad of theta_1 rising by \u22120.25\xa0rad/s "
        "removed from the data."
    )


def test_a_treatment_that_both_data_had_is_reported_once_unless_it_removed_other_trends(
    done: Study,
) -> None:
    def treated(*trends: Trend) -> list[str]:
        each = (
            data.replaced(step="removed the mean", trends=trends[k : k + 1])
            for k, data in enumerate((done.estimation, done.validation))
        )
        estimation, validation = each
        return treatment(replace(done, estimation=estimation, validation=validation))

    assert treated() == ["Both: removed the mean."]
    assert treated(Trend(u_level=2.5, y_level=1.0), Trend(u_level=1.5, y_level=3.0)) == [
        "Estimation data: removed the mean.",
        "Estimation data: 2.5\xa0V of u and 1\xa0rad of theta_1 removed from the data.",
        "Validation data: removed the mean.",
        "Validation data: 1.5\xa0V of u and 3\xa0rad of theta_1 removed from the data.",
    ]


def test_a_step_or_a_staircase_with_a_name_is_not_identified_from(
    done: Study, three_recordings: tuple[Path, ...], tmp_path: Path
) -> None:
    stairs = of_the_arm(armrig.staircase(300), experiment="staircase-monday")
    named = written(tmp_path, stairs, "stairs.mcap")

    found = study([load(named), *(load(path) for path in three_recordings[1:])])

    assert [role(found, r) for r in found.recordings] == ["staircase", "estimation", "validation"]


def test_each_caption_names_the_run_that_its_figure_shows(of_three: Study) -> None:
    told = study_contents(of_three, ())
    shown = [part for s in told.sections for part in (*s.tables, *s.figures)]

    runs = {part.name: re.findall(r"@run-\d", part.caption) for part in shown if part.name}

    assert runs == {
        **{name: ["@run-3"] for name in ("fits", "tests", "compare", "velocity", "residuals")},
        **{name: ["@run-2"] for name in ("bode", "step_poles", "timing")},
        "data": ["@run-2", "@run-3"],
        "step": ["@run-1"],
    }
    estimation = of_three.recordings[1].manifest
    assert told.subtitle == (
        f"rig {estimation.rig}, recorded {estimation.started[:10]} {estimation.started[11:16]}"
    )


def test_a_rig_without_its_arm_is_not_compared_with_the_physics(done: Study) -> None:
    found = study([at_rest(r) for r in done.recordings])

    told = study_contents(found, ())
    titles = [s.title for s in told.sections]

    assert (found.reference, [m.name for m in found.models]) == (None, ["ARX", "OE"])
    assert titles[4] == "Frequency and step responses"
    assert "alpha is constant: the arm was removed or held" in told.sections[4].paragraphs[0]
    assert "physic" not in told.front.paragraphs[0] + str(told.sections[:4])
    texts = [text for s in told.sections for text in s.paragraphs]
    named = {part.name for s in told.sections for part in (*s.tables, *s.figures) if part.name}
    assert {name for text in texts for name in re.findall(r"<([\w-]+)>", text)} == named


def test_the_caption_of_a_step_names_the_first_step_which_the_figure_shows(
    of_three: Study,
) -> None:
    steps = tuple(
        replace(r, manifest=msgspec.structs.replace(r.manifest, experiment="step-2"))
        for r in of_three.recordings
    )

    *_, told = section_of(replace(of_three, recordings=steps), "Data").figures

    assert re.findall(r"run-\d", told.caption) == ["run-1"]


def test_only_an_arx_model_far_from_the_best_is_reported_as_biased(
    done: Study, of_three: Study
) -> None:
    def verdicts(study: Study, *errors: float) -> list[str]:
        estimated = tuple(
            replace(m, comparison=replace(m.comparison, rms_error=error))
            for m, error in zip(study.estimated, errors, strict=True)
        )
        said = conclusions(replace(study, estimated=estimated))
        return [text.partition(".")[0] for text in said if "disagree" in text]

    assert verdicts(of_three, 0.04, 0.01, 0.01) == []
    assert verdicts(of_three, 0.04, 0.04, 0.01) == ["ARX and OE disagree"]
    assert verdicts(of_three, 0.01, 0.04, 0.04) == ["ARX and ARMAX disagree"]
    assert verdicts(of_three, 0.04, 0.01, 0.04) == []
    assert verdicts(done, 0.0301, 0.01) == ["ARX and OE disagree"]
    assert verdicts(done, 0.0299, 0.01) == []


def test_untested_residuals_are_not_reported_as_coloured(done: Study) -> None:
    fit = changed(done.best.model, whiteness=float("nan"))
    untested = replace(done.best, comparison=replace(done.best.comparison, model=fit))

    said = str(section_of(replace(done, estimated=(untested,)), "Models").points)

    assert "on the estimation data, residuals not tested (too few, or all zero)." in said
    assert "coloured" not in said
    assert not fit.trusts_robust


def test_the_notes_of_a_recording_are_in_the_report(done: Study, of_three: Study) -> None:
    def notes(study: Study) -> list[str]:
        points = section_of(study, "Recordings").points
        return [text for text in points if text.startswith("Note of ")]

    told = [f"Note of @run-{k} at 1.50{NBSP}s, {NOTE.owner}: {NOTE.text}" for k in (1, 2, 3)]
    assert notes(of_three) == told
    assert notes(done) == []

    many = replace(done.recordings[0], notes=(NOTE,) * 25)
    told = notes(replace(done, recordings=(many, *done.recordings[1:])))
    assert len(told) == 21
    assert told[-1].endswith(": 5 more notes")


def test_models_are_compared_up_to_nyquist() -> None:
    """At a long sampling time Nyquist is below 100 rad/s."""
    u = np.tile([1.0, 2.0], 20)
    data = Dataset(u=u, y=np.cumsum(u), Ts=0.1, output="theta_1", unit="rad")

    found = assess_fits({}, physical_model(ArmParameters(), data), data)

    assert found["omega"][-1] == pytest.approx(np.pi / 0.1)


def test_an_uncalibrated_rig_is_reported_once(done: Study) -> None:
    made = Made(date="2026-11-20T04:00:00+01:00", rig="1", device_uid="0001", armrig="0.1.0")
    good = tuple(replace(r, calibration=Calibration(made=made)) for r in done.recordings)

    for recordings, told, when in (
        (done.recordings, 1, "no"),
        (good, 0, "2026-11-20 04:00"),
    ):
        judged = replace(done, recordings=recordings)
        assert " ".join(conclusions(judged)).count("was not calibrated") == told
        [table] = section_of(judged, "Recordings").tables
        assert ("calibrated", *[when] * len(recordings)) in table.rows


@pytest.mark.exhaustive
def test_the_same_recordings_give_the_same_bytes(
    of_three: Study, made: tuple[bytes, Path], tmp_path: Path
) -> None:
    """Report and figures bear the date of the recordings, and no time of day.

    Drawing the figures again takes more than a second, the resolution of a PDF's date.
    """
    pdf, folder = made
    again, other = typeset_with_figures(of_three, tmp_path)

    assert again == pdf
    started = datetime.fromisoformat(of_three.recordings[-1].manifest.started)
    assert f"/CreationDate(D:{started:%Y%m%d}".encode() in pdf
    assert pdf.count(b"/FontFile") >= 3
    names = sorted(path.name for path in folder.glob("*.svg"))
    assert sorted(path.name for path in other.glob("*.svg")) == names
    assert all((folder / name).read_bytes() == (other / name).read_bytes() for name in names)
