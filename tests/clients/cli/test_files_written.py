"""Reports and figures: paths of the written files, and files that are never replaced."""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import armrig
import pytest
from armrig.cli import main
from armrig.cli.results import name_runs, write_plot
from armrig.plots.captions import sign
from armrig.report.answers import read_answers
from armrig.report.typesetting import compile_pdf
from matplotlib.figure import Figure
from matplotlib.image import imread

from tests.clients.made_recordings import manifest, recorded, sample, written
from tests.clients.told import told


def test_a_figure_of_a_saved_model_has_the_run_that_its_data_validate(tmp_path: Path) -> None:
    """The model names its recording by hash, and `armrig ls` knows no hash."""
    of, drawn = "0000000b", Figure().add_subplot()
    estimation = written(tmp_path, recorded([sample(0)]), f"1-blackbox-20260101T131100-{of}.mcap")
    about = manifest(run_id="0000000c", details={"validation_of": of})
    validation = written(tmp_path, recorded([sample(0)], manifest=about))
    source = armrig.load(estimation).sha256

    name_runs(armrig.load(validation))
    write_plot(tmp_path / "a.svg", model=lambda ax: sign(drawn, source))

    assert drawn.get_title("right") == "recording @0000000b"


def test_a_report_names_its_file_its_recordings_and_a_validation_on_its_own_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path, pdf = written(tmp_path, recorded([sample(0)])), tmp_path / "r.pdf"
    data = SimpleNamespace(digest="ab")
    remarks: list[list[str]] = []
    fakes: dict[str, Any] = {
        "study.study": lambda *_, **__: SimpleNamespace(estimation=data, validation=data),
        "document.report": lambda *_, **how: remarks.append(how["remarks"]),
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(f"armrig.report.{name}", fake)
    monkeypatch.chdir(tmp_path)

    assert main(["report", str(path), "-o", str(pdf)]) == 0
    said = capsys.readouterr()
    assert main(["report", str(path), "-o", str(pdf), "--json"]) == 0

    assert said.out == f"{pdf}\n"
    assert "judged on their own estimation data" in said.err
    assert "judged on their own estimation data" in remarks[0][0]
    goes_on = f"next: armrig report --handout {path} --questions reasons.toml"
    assert said.err.splitlines()[-1] == goes_on
    hashes = [armrig.load(path).sha256]
    assert json.loads(capsys.readouterr().out) == {"report": str(pdf), "recordings": hashes}


@pytest.mark.parametrize("name", ["estimation.mcap", "other.mcap", "other.pdf", "r.txt", "."])
def test_a_report_never_replaces_another_kind_of_file(
    name: str,
    three_recordings: tuple[Path, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A recording cannot be made again."""
    for path in three_recordings:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    for other in ("other.mcap", "other.pdf"):
        (tmp_path / other).write_bytes(three_recordings[0].read_bytes())
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    files = [str(tmp_path / path.name) for path in three_recordings]

    assert main(["report", *files, "-o", str(tmp_path / name)]) == 1

    assert f"-o {tmp_path / name}: " in told(capsys)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("there", [True, False])
def test_a_folder_gets_a_figure_for_each_subject_and_replaced_figures_are_named(
    there: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "figures"
    files = [folder / "step.png", folder / "sensitivities.png"]
    if there:
        folder.mkdir()
        files[0].touch()

    assert main(["model", "-o", f"{folder}{'' if there else '/'}"]) == 0

    assert sorted(folder.iterdir()) == sorted(files)
    replaced = f"; replaced: {files[0]}" if there else ""
    assert f"figures: {files[0]}, {files[1]}{replaced}\n" in capsys.readouterr().err


@pytest.mark.parametrize(("n", "height"), [(1, 7.0), (2, 3.6), (5, 3.6)])
def test_a_figure_with_many_panels_fits_a_screen(n: int, height: float, tmp_path: Path) -> None:
    """At most 1600 pixels high: more subjects take more columns."""
    drawn: dict[str, Any] = {f"panel_{k}": lambda ax: ax.plot(0, 0) for k in range(n)}

    [path] = write_plot(tmp_path / "a.png", height=height, **drawn)
    [grid] = write_plot(tmp_path / "grid.png", 4.5, columns=2, **drawn)

    pixels = imread(path)
    assert pixels.shape[0] <= 1600
    assert pixels.shape[1] in {1260, 2520, 3780}
    assert imread(grid).shape[:2] == {1: (720, 900), 2: (720, 1800), 5: (2160, 1800)}[n]


def test_a_figure_in_a_folder_never_replaces_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "b.png"
    path.write_bytes(b"\x89MCAP0\r\n")
    drawn: dict[str, Any] = {name: lambda ax: ax.plot(0, 0) for name in "ab"}

    with pytest.raises(ValueError, match=r"b\.png: is a recording, which would be overwritten"):
        write_plot(tmp_path / "*.png", **drawn)

    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.parametrize("link", ["symlink_to", "hardlink_to"])
def test_an_input_path_is_recognised_under_another_name(
    link: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, other = tmp_path / "data.csv", tmp_path / "other.csv"
    data.write_text("u,y\n" + "1.0,2.0\n" * 50)
    getattr(other, link)(data)
    before = data.read_bytes()

    assert main(["identify", str(data), "--structure", "arx", "--save", str(other)]) == 1

    assert f"{other}: is an input file, which would be overwritten" in told(capsys)
    assert data.read_bytes() == before


@pytest.mark.exhaustive
def test_a_report_with_names_and_reasons_leaves_its_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    report = ["report", "--handout"]

    assert main([*report, "--questions", "reasons.toml"]) == 0
    questions = Path("reasons.toml")
    questions.write_text(questions.read_text().replace('name = ""', 'name = "Ada"', 1))
    assert main([*report, "--answers", "reasons.toml", "--source", "source"]) == 0

    assert capsys.readouterr().out == "reasons.toml\nreport.pdf\n"
    assert compile_pdf(Path("source/report.typ"))[0] == Path("report.pdf").read_bytes()
    assert json.loads(Path("source/data.json").read_text())["cover"]["fields"][0][1] == "Ada"


def test_the_questions_are_text_under_any_file_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names = ["a\nb.toml", os.fsdecode(b"a\xff.toml")]

    codes = [main(["report", "--handout", "--questions", name]) for name in names]

    assert codes == [0, 0]
    assert all(read_answers(Path(name)).reasons == {} for name in names)


def test_a_saved_model_replaces_a_model_in_words_and_no_control_law(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{k % 7 // 3},{k % 5}\n" for k in range(80))
    Path("data.csv").write_text(f"u,y\n{rows}")
    line = ["identify", "data.csv", "--Ts", "1", "--structure", "arx", "--na", "1", "--nb", "1"]

    assert main([*line, "--save", "model.json"]) == 0
    assert "replaced" not in capsys.readouterr().err
    assert main([*line, "--save", "model.json"]) == 0
    assert "replaced: model.json" in capsys.readouterr().err
    Path("law.json").write_text('{\n  "format": "armrig control law"}')
    assert main([*line, "--save", "law.json"]) == 1
    assert "--save law.json: is a control law, which would be overwritten" in told(capsys)
