"""The handout's report: each assignment, in its order, in ten pages, with any recordings."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from armrig.models.characteristics import model_characteristics
from armrig.numerics.quantities import NBSP
from armrig.recordings.files.loading import load
from armrig.recordings.recording import Recording
from armrig.report.answers import QUESTIONS, Answers, Student
from armrig.report.document import MOST_PAGES, check_length, handout_report
from armrig.report.handout_study import HandoutStudy, handout_study
from armrig.report.identification_sections import identification_sections
from armrig.report.physical_sections import numerical_sections, physical_sections
from armrig.report.recording_facts import run_name
from armrig.report.sections import Contents, Section, plain
from armrig.report.typesetting import TEMPLATE, compile_pdf, typeset
from armrig_core.errors import OperationError
from armrig_core.recording_file.manifest import Outcome
from armrig_core.rig.arm import ArmParameters

from tests.clients.made_recordings import of_the_arm, written
from tests.clients.report.conftest import at_rest

ASSIGNMENTS = [
    *("2.1", "2.2", "2.3"),
    *(f"3.{i}" for i in range(1, 9)),
    *(f"4.{i}" for i in range(1, 5)),
]


def sections(study: HandoutStudy, chapters: str = "234") -> dict[str, Section]:
    """Return the sections of some chapters by number, in their order."""
    of = {"2": physical_sections, "3": identification_sections, "4": numerical_sections}
    return {number: s for chapter in chapters for number, s in of[chapter](study).items()}


def pages(path: Path) -> int:
    """Return the number of pages of a PDF."""
    found = re.search(rb"/Type/Pages/Count (\d+)", path.read_bytes())
    assert found is not None
    return int(found[1])


@pytest.fixture(scope="module", autouse=True)
def _characteristics_once() -> Iterator[None]:
    """Compute the characteristics of each model once for all sections of this module."""
    with pytest.MonkeyPatch.context() as patch:
        once = cache(model_characteristics)
        patch.setattr("armrig.validation.comparison.model_characteristics", once)
        yield


@pytest.fixture(scope="module")
def three(three_recordings: tuple[Path, Path, Path]) -> list[Recording]:
    """Give a step and two telegraphs."""
    return [load(path) for path in three_recordings]


@pytest.fixture(scope="module")
def without() -> HandoutStudy:
    """Give the study of no recording."""
    return handout_study()


@pytest.fixture(scope="module")
def done(three: list[Recording]) -> HandoutStudy:
    """Give the study of a step and two telegraphs."""
    return handout_study(three)


@pytest.fixture(scope="module")
def typeset_once(without: HandoutStudy, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the report of no recording as a PDF, its source in the folder `source` next to it."""
    folder = tmp_path_factory.mktemp("report")
    return handout_report(without, folder / "1.pdf", source=folder / "source")


@pytest.fixture
def only_values(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not draw the figures nor typeset the report; write its values alone."""
    fakes: dict[str, Any] = {
        "document.write_figures": lambda *_: (),
        "typesetting.compile_pdf": lambda _: (b"", [("end", 1.0)]),
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(f"armrig.report.{name}", fake)


def test_every_assignment_has_its_section_in_order(
    without: HandoutStudy, done: HandoutStudy
) -> None:
    for study in (without, done):
        found = sections(study)
        assert list(found) == ASSIGNMENTS
        assert all(bool(s.paragraphs) != bool(s.lack) for s in found.values())
    assert list(QUESTIONS) == ASSIGNMENTS


def test_a_section_without_recordings_names_the_command(without: HandoutStudy) -> None:
    fill = {number: s.lack.split("`")[1] for number, s in sections(without, "3").items() if s.lack}

    blackbox, greybox = "armrig collect blackbox --validation", "armrig collect greybox"
    assert fill == {
        "3.1": "armrig collect step",
        **dict.fromkeys(("3.2", "3.3", "3.4", "3.7", "3.8"), blackbox),
        **dict.fromkeys(("3.5", "3.6"), greybox),
    }


def test_recordings_fill_the_sections_that_they_support(done: HandoutStudy) -> None:
    lacking = [number for number, s in sections(done, "3").items() if s.lack]

    assert lacking == ["3.5", "3.6"]
    assert done.sampling is not None
    assert done.sampling.from_step
    assert done.refused == {}


def test_an_insignificant_extreme_of_a_spectrum_is_not_reported(done: HandoutStudy) -> None:
    assert done.hints is not None
    hints = replace(done.hints, resonances=(31.0, 62.0), antiresonances=())

    found = sections(replace(done, hints=hints), "3")["3.2"].paragraphs[1]

    assert "two poles each: 31, 62 rad/s;" in found
    assert "two zeros each: none." in found


def test_models_of_other_orders_or_of_a_rig_without_its_arm_are_annotated(
    done: HandoutStudy,
) -> None:
    assert done.black is not None
    assert done.hints is not None
    *others, last = done.black.recordings
    bare = replace(
        done.black,
        recordings=(*others, at_rest(last)),
        reference=None,
        estimated=tuple(replace(m, deviation=None) for m in done.black.estimated),
    )
    two = replace(done.hints, structures=(replace(done.hints.structures[0], nb=2, nf=2),))

    with_arm, without_arm = sections(done, "3"), sections(replace(done, black=bare, hints=two), "3")

    resting = f"In {run_name(last)} alpha is constant: the arm was removed or held. The models are "
    assert resting in without_arm["3.4"].paragraphs[0]
    assert [row[0] for row in without_arm["3.4"].tables[0].rows] == ["OE", "ARX"]
    assert "It has nb = 4 and nf = 4, not the orders of 3.2" in without_arm["3.3"].paragraphs[0]
    assert "alpha" not in with_arm["3.4"].paragraphs[0]
    assert "not the orders" not in with_arm["3.3"].paragraphs[0]


@pytest.mark.parametrize(
    ("arx", "oe", "physics", "said"),
    [
        (0.02, 0.004, 0.03, f"OE is closest, with an rms error of 4{NBSP}mrad."),
        (0.02, 0.03, 0.005, f"the physical model is closest, with an rms error of 5{NBSP}mrad."),
        (0.006, 0.03, 0.006, "ARX and the physical model are equally close, with an rms error "),
    ],
)
def test_the_answer_names_the_closest_of_all_models(
    done: HandoutStudy, arx: float, oe: float, physics: float, said: str
) -> None:
    assert done.black is not None

    errors = {"ARX": arx, "OE": oe}
    estimated = tuple(
        replace(m, comparison=replace(m.comparison, rms_error=errors[m.name]))
        for m in done.black.estimated
    )
    assert done.black.reference is not None
    reference = replace(done.black.reference, rms_error=physics)
    black = replace(done.black, estimated=estimated, reference=reference)

    found = sections(replace(done, black=black), "3")["3.4"].paragraphs[0]

    assert found.startswith(f"On the validation data {said}")


def test_data_without_information_are_reported_in_their_section(tmp_path: Path) -> None:
    short = written(tmp_path, of_the_arm(np.full(60, 2.0)), "short.mcap")

    study = handout_study([load(short)])

    found = sections(study, "3")
    assert study.black is None
    assert found["3.3"].lack.startswith(f"No result: {study.refused['black']}. Record it with `")


@pytest.mark.exhaustive
def test_the_report_has_at_most_ten_pages(
    typeset_once: Path, without: HandoutStudy, tmp_path: Path
) -> None:
    """With every recording that the handout requires it is made in test_tutorial_page.py."""
    again = handout_report(without, tmp_path / "2.pdf")

    assert 3 <= pages(typeset_once) <= MOST_PAGES
    assert again.read_bytes() == typeset_once.read_bytes()


def test_more_than_ten_pages_are_refused_with_the_longest_sections() -> None:
    fits = [("cover", 1.0), ("2.1", 2.0), ("3.3", 5.0), ("end", 10.9)]
    check_length(fits)

    with pytest.raises(OperationError, match=r"11 pages.*allows 10.*3\.3 \(6\.2\), 2\.1 \(3\.0\)"):
        check_length([*fits[:-1], ("end", 11.2)])


def test_changed_parameters_and_the_sinusoid_are_those_given() -> None:
    cases = {"handout": ArmParameters(), "R_m=6.42": ArmParameters(R_m=6.42)}

    found = sections(handout_study(cases=cases, amplitude=1.5, omega=25.0), "24")

    assert found["2.3"].paragraphs[0] == (
        "R_m=6.42 multiplies the slope by 0.5, does not change the steady speed and moves the "
        "swing's poles from −8.05 ± 17.08i to −9.11 ± 26.75i 1/s."
    )
    [table] = found["2.3"].tables
    assert [row[0] for row in table.rows] == list(cases)
    assert "$u = 1.5 sin(25 t)$ V" in found["4.2"].paragraphs[0]


@pytest.mark.usefixtures("only_values")
def test_an_emulated_rig_is_named_on_the_cover(
    done: HandoutStudy, without: HandoutStudy, tmp_path: Path
) -> None:
    emulated = msgspec.structs.replace(done.recordings[0].manifest, host={"port": "emulated"})
    first = replace(done.recordings[0], manifest=emulated)
    others = done.recordings[1:]

    def remarks(*recordings: Recording) -> list[str]:
        source = tmp_path / f"source-{len(list(tmp_path.iterdir()))}"
        study = replace(without, recordings=recordings)
        handout_report(study, tmp_path / "report.pdf", source=source)
        found: list[str] = json.loads((source / "data.json").read_text())["front"]["points"]
        return [text for text in found if "emulated" in text]

    assert remarks() == remarks(*others) == []
    assert remarks(first) == ["The rig was emulated: these are not measurements of a real rig."]
    assert remarks(first, *others) == [
        f"The rig was emulated in {first.path.name}: these are not measurements of a real rig."
    ]


@pytest.mark.parametrize("text", ["K_m", "x_hat_1", "K__", "a_b_c.mcap"])
def test_names_of_others_are_typeset_as_text(text: str, tmp_path: Path) -> None:
    others = (plain(f"$panic()$ <{text}>"), plain("<b>$"))
    front = Section(paragraphs=others, points=(text, f"#panic() $panic()$ <b> {text}"))
    contents = Contents(title="A report", front=front, sections=())

    _, places = typeset(tmp_path, contents, datetime(2026, 1, 1, tzinfo=UTC))

    assert places


def test_a_folder_with_files_is_refused_for_a_source(without: HandoutStudy, tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")

    with pytest.raises(OperationError, match="contains files already; name a new folder"):
        handout_report(without, tmp_path / "1.pdf", source=tmp_path)

    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


@pytest.mark.usefixtures("only_values")
def test_the_values_of_the_report_contain_names_and_reasons(
    three: list[Recording], without: HandoutStudy, tmp_path: Path
) -> None:
    step = three[0]
    given = Answers(
        students=(Student(name="Ada", registration_number="1"), Student(name="Bo")),
        reasons={"2.1": "why\nnot\n \t\n\nfor  all\n", "3.5": "none", "4.4": "so"},
    )
    source = tmp_path / "source"

    study = replace(without, recordings=(step,))
    handout_report(study, tmp_path / "report.pdf", answers=given, source=source)

    told = json.loads((source / "data.json").read_text())
    reasons = {s["number"]: s["reasons"] for s in told["sections"] if s["reasons"]}
    assert reasons == {"2.1": ["why not", "for all"], "3.5": ["none"], "4.4": ["so"]}
    assert [s["number"] for s in told["sections"] if s["level"] == 2] == ASSIGNMENTS
    assert [text for _, text in told["cover"]["fields"]] == ["Ada", "1", "Bo", "", ""]
    about = [f"200 at 10{NBSP}ms", "0", str(step.hidden), step.short_hash]
    assert told["front"]["tables"][0]["rows"] == [[step.path.name, run_name(step), *about]]


@pytest.mark.usefixtures("only_values")
def test_complete_recordings_come_before_those_that_ended_early(
    three: list[Recording], without: HandoutStudy, tmp_path: Path
) -> None:
    whole = replace(
        three[0], manifest=msgspec.structs.replace(three[0].manifest, experiment="calibrate")
    )
    early, unknown = (
        replace(whole, outcome=Outcome(outcome="stopped by root", samples=9, missing=0)),
        replace(whole, outcome=None),
    )

    found = handout_study([early, whole, unknown, whole])
    study = replace(without, recordings=found.recordings)
    handout_report(study, tmp_path / "report.pdf", source=tmp_path / "source")

    assert found.recordings == (whole, whole, early, unknown)
    remarks = json.loads((tmp_path / "source" / "data.json").read_text())["front"]["points"]
    n, of = early.samples.size, early.manifest.samples
    said = f"{early.path.name} ended early, after {n} of {of} samples: stopped by root."
    assert said in remarks


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("lines", "reasons"),
    [(27, ["One line."]), (11, ["A line of many words. " * 100, "One line."])],
)
def test_no_line_of_reasons_is_alone_on_the_last_page(
    lines: int, reasons: list[str], without: HandoutStudy, tmp_path: Path
) -> None:
    handout_report(without, tmp_path / "report.pdf", source=tmp_path / "source")
    values = json.loads((tmp_path / "source" / "data.json").read_text())
    *_, before, last = values["sections"]
    before["reasons"], last["reasons"] = ["One line."] * lines, reasons
    values["sections"] = [before, last]
    (tmp_path / "source" / "data.json").write_text(json.dumps(values))

    *_, (name, end) = compile_pdf(tmp_path / "source" / TEMPLATE)[1]

    assert (name, int(end)) == ("end", 3)
    assert end % 1 > 0.2
