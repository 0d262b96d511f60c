"""The pages of both reports: order, numbers, sizes of the texts, and no page half empty."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
import typst
from armrig.excitation import telegraph
from armrig.recordings.files.loading import load
from armrig.recordings.recording import Recording
from armrig.report.document import handout_report, report
from armrig.report.figures import MIN_SIZE, STYLE, save, write_figures
from armrig.report.handout_study import handout_study
from armrig.report.sections import Contents, Section
from armrig.report.study import Study, best_first, study
from armrig.report.study_sections import study_contents
from armrig.report.typesetting import TEMPLATE, typeset
from armrig_core.rig.description import builtin
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tests.clients import pdf_text
from tests.clients.described_rig import record_all
from tests.clients.pages import script
from tests.clients.report.conftest import section_of

HEIGHT_PT, MARGIN_PT = 842.0, 62.0
PROBE = """
#context [#metadata((
  headings: query(heading).map(h => (repr(h.body), h.location().page())),
  figures: query(figure).map(f => (
    kind: repr(f.kind),
    number: counter(figure.where(kind: f.kind)).at(f.location()).first(),
    page: f.location().page(),
    y: f.location().position().y.pt(),
    label: str(f.at("label", default: <none>)),
  )),
  images: query(image).len(),
  tables: query(table).len(),
  references: query(ref).map(r => str(r.target)),
)) <probe>]
"""
"""Typst's own account of a document, appended to its template."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Made:
    """A report, its values, and Typst's account of it."""

    pages: list[list[pdf_text.Text]]
    values: dict[str, Any]
    account: dict[str, Any]


def made(make: Callable[..., Path], folder: Path) -> Made:
    """Typeset a report, and ask Typst about its source."""
    pdf = make(folder / "report.pdf", source=folder / "source")
    source = folder / "source" / TEMPLATE
    source.write_text(source.read_text() + PROBE)
    compiler = typst.Compiler(str(source), root=str(source.parent))
    [account] = json.loads(compiler.query("<probe>", field="value"))
    values = json.loads(source.with_name("data.json").read_text())
    return Made(pages=pdf_text.pages(pdf), values=values, account=account)


@pytest.fixture(scope="module")
def of_study(done: Study, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Give the report of a step and two telegraphs."""
    folder = tmp_path_factory.mktemp("report")
    return made(lambda *a, **k: report(done, *a, **k), folder)


@pytest.fixture(scope="module")
def of_circuit(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Give the report of a described rig, which has three models."""
    folder, rc = tmp_path_factory.mktemp("circuit"), builtin("rc")
    lengths = {"first": (3.0, 0.01), "random": (10.0, 0.01)}
    recorded = record_all(folder, rc, "rc", plant=rc, **lengths)
    found = study([load(path) for path in recorded])
    return made(lambda *a, **k: report(found, *a, **k), folder)


@pytest.fixture(scope="module")
def of_handout(done: Study, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Give the handout's report with every recording that it can have."""
    folder = tmp_path_factory.mktemp("handout")
    u = telegraph(1500, 0.05, seed=3)
    script("experiments.py").record(folder / "c.mcap", u, 0.01, "greybox", 3, arm_removed=True)
    found = handout_study([*done.recordings, load(folder / "c.mcap")])
    return made(lambda *a, **k: handout_report(found, *a, **k), folder)


@pytest.fixture(
    params=[
        "of_study",
        "of_circuit",
        pytest.param("of_handout", marks=pytest.mark.exhaustive),
    ]
)
def either(request: pytest.FixtureRequest) -> Made:
    """Give each report."""
    found = request.getfixturevalue(request.param)
    assert isinstance(found, Made)
    return found


def test_no_text_is_smaller_than_seven_points(either: Made) -> None:
    """Also in the figures, in the indices of formulas, and in the line at the foot."""
    sizes = [text.size for page in either.pages for text in page]

    assert min(sizes) >= 7 - 1e-2


def test_no_page_but_the_last_is_half_empty(either: Made) -> None:
    for page in either.pages[:-1]:
        inside = {text.y for text in page if MARGIN_PT < text.y < HEIGHT_PT - MARGIN_PT}
        places = sorted({MARGIN_PT, HEIGHT_PT - MARGIN_PT, *inside})
        assert max(above - below for below, above in pairwise(places)) < HEIGHT_PT / 2


def test_figures_and_tables_are_numbered_in_their_order_and_mentioned(either: Made) -> None:
    account = either.account

    kinds = {"image": account["images"], "table": account["tables"]}
    for kind, n in kinds.items():
        numbers = [f["number"] for f in account["figures"] if f["kind"] == kind]
        assert numbers == list(range(1, n + 1))
        places = [(f["page"], f["y"]) for f in account["figures"] if f["kind"] == kind]
        assert places == sorted(places)
    labels = {f["label"] for f in account["figures"]} - {"none"}
    assert len(labels) >= kinds["image"]
    assert labels <= {*account["references"]}


def test_no_figure_of_a_study_overtakes_the_figure_before_it(of_circuit: Made) -> None:
    """A figure that moves to the next page would be overtaken by a figure that does not move."""
    sections = of_circuit.values["sections"]

    floats = [figure["floats"] for section in sections for figure in section["figures"]]

    assert floats == sorted(floats)


def test_no_point_of_a_list_is_on_two_pages(tmp_path: Path) -> None:
    """Each page has whole points: here each has six lines."""
    points = ("word " * 110,) * 20
    contents = Contents(title="", front=Section(), sections=(Section(points=points),))

    pdf, _ = typeset(tmp_path, contents, datetime(2000, 1, 1, tzinfo=UTC))

    (tmp_path / "a.pdf").write_bytes(pdf)
    inside = [{t.y for t in page if t.y > MARGIN_PT} for page in pdf_text.pages(tmp_path / "a.pdf")]
    lines = [len(heights) for heights in inside]
    assert sum(lines) == 6 * len(points)
    assert all(n % 6 == 0 for n in lines)


def test_the_results_are_on_the_first_page_and_the_device_in_the_appendix(of_study: Made) -> None:
    account, values = of_study.account, of_study.values

    assert 3 <= len(of_study.pages) <= 6
    headings = {text.strip("[]"): page for text, page in account["headings"]}
    assert list(headings) == [
        *("Results", "Data", "Models", "Validation", "Comparison with the physics"),
        *("Recordings", "Sampling time"),
    ]
    first = {f["kind"]: f["page"] for f in account["figures"] if f["number"] == 1}
    assert first == {"table": 1, "image": 1}
    [fits] = values["sections"][0]["tables"]
    assert [row[0] for row in fits["rows"]] == ["OE", "ARX", "physics"]
    assert headings["Data"] <= 2
    assert headings["Recordings"] > headings["Comparison with the physics"]


def test_the_text_of_a_figure_is_enlarged_to_seven_points(tmp_path: Path) -> None:
    figure = Figure()
    figure.add_subplot().set_xlabel("$K_{lin}$", fontsize=8)

    with mpl.rc_context(STYLE):
        save(figure, tmp_path / "a.svg")

    sizes = set(pdf_text.svg_sizes(tmp_path / "a.svg"))
    assert min(sizes) == MIN_SIZE
    assert 8.0 in sizes


def punctual(recording: Recording, **late: int) -> Recording:
    """Return a recording with equal intervals and a constant lateness, but for one sample."""
    samples = recording.samples.copy()
    step = round(1e6 * recording.Ts)
    samples["t_device_us"] = step * np.arange(samples.size)
    samples["t_host_ns"] = samples["t_sched_ns"] + 800_000
    for name, by in late.items():
        samples[name][-1] += by
    return replace(recording, samples=samples)


@pytest.mark.parametrize(
    ("late", "panels", "caption"),
    [
        ({}, 0, None),
        ({"t_device_us": 9}, 1, "Histogram of jitter of the sampling instants in the"),
        ({"t_host_ns": 9_000}, 1, "Histogram of lateness at the host in the"),
        (
            {"t_device_us": 9, "t_host_ns": 9_000},
            2,
            "Histogram of jitter of the sampling instants and of lateness at the host in the",
        ),
    ],
)
def test_constant_times_have_no_panel(
    done: Study,
    late: dict[str, int],
    panels: int,
    caption: str | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recordings = tuple(punctual(r, **late) for r in done.recordings)
    found = replace(done, recordings=recordings)

    figures = drawn_by(found, monkeypatch)

    assert len(figures.get("timing", [])) == panels
    assert all(ax.has_data() for axes in figures.values() for ax in axes)
    told = [f.caption for f in section_of(found, "Sampling time").figures]
    assert told == [] if caption is None else told[0].startswith(caption)


def drawn_by(found: Study, monkeypatch: pytest.MonkeyPatch) -> dict[str, list[Axes]]:
    """Return the panels of each figure of a report."""
    panels: dict[str, list[Axes]] = {}
    monkeypatch.setattr(
        "armrig.report.figures.save", lambda of, path: panels.update({path.stem: of.axes})
    )
    write_figures(study_contents(found, ()), found.recordings, Path())
    return panels


def test_the_best_model_has_the_widest_line(done: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    """ARX is estimated first, and OE simulates best."""
    panels = drawn_by(best_first(done), monkeypatch)

    assert [m.name for m in best_first(done).estimated] == ["OE", "ARX"]
    for name in ("compare", "velocity", "bode", "step_poles"):
        widths = {
            model: line.get_linewidth()
            for line in panels[name][0].get_lines()
            for model in ("OE", "ARX", "physics")
            if str(line.get_label()).startswith(model)
        }
        assert max(widths, key=lambda model: widths[model]) == "OE", name


@pytest.mark.parametrize("output", ["theta_1", "alpha"])
def test_a_caption_names_the_quantity_on_the_axis(
    output: Any, three_recordings: tuple[Path, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An angle that grows is drawn without its ramp, and its step response as a rate."""
    found = study([load(path) for path in three_recordings[1:]], outputs=(output,))
    grows = output == "theta_1"

    panels = drawn_by(found, monkeypatch)

    titles = ("Results", "Data", "Comparison with the physics")
    captions = {f.name: f.caption for title in titles for f in section_of(found, title).figures}
    axis = {name: panels[name][0].get_ylabel() for name in ("data", "compare", "step_poles")}
    assert ("$t$" in axis["data"], "$t$" in axis["compare"]) == (grows, grows)
    assert ["minus the ramp" in captions[name] for name in ("data", "compare")] == [grows] * 2
    assert (r"\dot" in axis["step_poles"]) == grows
    assert captions["step_poles"].startswith("(a) Rate of" if grows else "(a) Response of")
