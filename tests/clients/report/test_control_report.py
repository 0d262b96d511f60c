"""The report of a run in control."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig.report.control_sections import ControlStudy, control_contents, control_study
from armrig_core.commands.commands import ControlRequest
from armrig_core.errors import InputError
from armrig_daemon.config import Config
from armrig_daemon.service.virtual_service import LEASE, VirtualService
from msgspec import structs


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the file of a model of both outputs of the arm."""
    path = tmp_path_factory.mktemp("model") / "arm.json"
    signals = armrig.example_recording().signals()
    fit = armrig.oe(signals, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
    fit.save(path)
    return path


@pytest.fixture(scope="module")
def run(model: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a run in control under a law of this model."""
    law = armrig.control.place(armrig.load_fit(model), [-18 + 18j, -18 - 18j, -42])
    service = VirtualService(Config(), tmp_path_factory.mktemp("run"), seed=1)
    reference = [2.0] * 150 + [4.0] * 150
    return service.record(ControlRequest(lease=LEASE, n=0, law=law, reference=reference))


@pytest.fixture(scope="module")
def study(run: Path, model: Path) -> ControlStudy:
    return control_study(armrig.load(run), armrig.load_fit(model))


def test_a_report_has_the_prediction_beside_the_run(study: ControlStudy) -> None:
    contents = control_contents(study)

    requirement, result, _, design, robustness, recording = contents.sections
    assert requirement.paragraphs == (
        "The file of the law has no requirement on a step.",
        "The design asked for poles of the loop at -18 ± 18i, -42 rad/s.",
    )
    [step] = result.tables[0].rows
    assert step[:2] == ("2 to 4 rad/s", "1.5 s")
    assert abs(float(step[2].split()[0]) - float(step[3].split()[0])) <= 3
    assert "by its prediction" not in contents.front.paragraphs[0]
    assert "velocity deviates from its prediction" in contents.front.paragraphs[0]
    assert contents.front.warnings[-1].startswith("In doubt: the model was not validated")
    facts = dict(design.tables[0].rows)
    assert (facts["method"], facts["states"]) == ("place", "5")
    assert robustness.tables[0].rows[0][0] == "model"
    assert result.points[0].startswith("The law may command 0 to 5 V. It commanded ")
    hashed = " ".join(recording.points)
    for sha256 in (
        study.comparison.law.sha256,
        study.comparison.model_sha256,
        study.model.source,
        study.run.sha256,
        study.run.manifest.input_sha256,
    ):
        assert f"`{sha256}`" in hashed


def test_a_law_without_a_monitor_is_a_warning(study: ControlStudy) -> None:
    fields = {name: getattr(study.comparison, name) for name in study.comparison.__slots__}
    law = {name: getattr(fields["law"], name) for name in fields["law"].__struct_fields__}
    bare = armrig.control.ControlLaw(**law | {"monitor": None})
    other = type(study.comparison)(**fields | {"law": bare, "prelude": 0})

    contents = control_contents(
        ControlStudy(
            recordings=study.recordings, model=study.model, comparison=other, check=study.check
        )
    )

    assert contents.front.warnings[-1] == "The law has no monitor."
    assert "The law has no prelude." in contents.sections[1].paragraphs[0]


@pytest.mark.parametrize(
    ("design", "aim"),
    [
        ({"time_constant": 0.5}, "a time constant of 0.5 s"),
        ({"ms": 1.6}, "the largest integral gain with Ms at most 1.6"),
        ({"effort": 0.1}, "squares of error and voltage, with an effort of 0.1"),
        ({}, ""),
    ],
)
def test_the_requirement_names_the_aim_of_the_design(
    study: ControlStudy, design: dict[str, float], aim: str
) -> None:
    law = structs.replace(study.comparison.law, design=design | {"requirement": {"settling": 1.0}})
    comparison = replace(study.comparison, law=law)

    requirement = control_contents(replace(study, comparison=comparison)).sections[0]

    assert requirement.tables[0].rows[0][:2] == ("5 % settling", "1 s")
    assert requirement.paragraphs[0].startswith("The run meets the requirement")
    assert " ".join(requirement.paragraphs[1:]).endswith(f"{aim}." if aim else "")
    assert len(requirement.paragraphs) == 1 + bool(aim)


def test_the_command_writes_a_report_of_at_most_six_pages(
    run: Path, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pdf = tmp_path / "loop.pdf"

    assert main(["report", str(run), "--model", str(model), "-o", str(pdf)]) == 0

    text = pdf.read_bytes()
    assert text.startswith(b"%PDF")
    assert re.search(rb"/Type/Pages/Count [1-6]\b", text)
    assert str(model) in capsys.readouterr().err


def test_the_command_needs_a_model_that_the_law_does_not_name(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(run), "-o", str(tmp_path / "loop.pdf")]) == 1

    assert "the law does not name its model: give --model" in capsys.readouterr().err


def test_a_model_of_other_recordings_is_refused(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(armrig.example_recording().path)

    assert main(["report", file, "--model", str(model), "-o", str(tmp_path / "x.pdf")]) == 1

    assert "give one recording of a run in control" in capsys.readouterr().err


def test_a_model_of_another_output_is_refused(run: Path) -> None:
    fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)

    with pytest.raises(InputError, match="the law uses theta_1"):
        control_study(armrig.load(run), fit)


def test_numbers_that_are_not_reached_are_words(study: ControlStudy) -> None:
    fields = {name: getattr(study.comparison, name) for name in study.comparison.__slots__}
    never = np.linspace(0.0, 9.0, study.comparison.r.size)
    other = type(study.comparison)(**fields | {"predicted": never[None], "z": never})

    [(measured, model)] = other.steps()

    assert np.isinf(measured.settling)
    assert np.isinf(model.settling)
    assert "not reached" in other.verdict
