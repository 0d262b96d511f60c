"""Models from the command line: every structure, the search, models in files and their tests."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig.cli.model_output import advice_lines, to_act_on
from armrig.cli.next_step import CHECK, options_after, options_of
from armrig.data.finding import warning
from armrig.estimation.oe import oe
from armrig.estimation.request import Request
from scipy.signal import lfilter


@pytest.fixture(scope="module")
def model(three_recordings: tuple[Path, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of an OE model of the second recording."""
    path = tmp_path_factory.mktemp("models") / "oe.json"
    arguments = ["identify", str(three_recordings[1]), "--structure", "oe", "--integrator"]
    assert main([*arguments, "--save", str(path), "--json"]) == 0
    return path


@pytest.mark.parametrize(
    ("arguments", "heading", "equation"),
    [
        (["armax", "--nc", "2"], "ARMAX(na=4, nb=4, nc=2, nk=1)", "A(q) y(t) = B(q) u(t) + C(q)"),
        (
            ["bj", "--nd", "0", "--integrator"],
            "BJ(nb=4, nc=1, nd=0, nf=4, nk=1)",
            "y(t) = B(q)/F(q) u(t) + C(q) e(t); one root of F is 1 by construction",
        ),
        (["iv4", "--nk", "2"], "IV4(na=4, nb=4, nk=2)", "A(q) y(t) = B(q) u(t) + v(t)"),
        (
            ["n4sid", "--order", "4", "--weights", "moesp", "--integrator"],
            "N4SID(order=4, nk=1)",
            "C(q) e(t); one root of A is 1 by construction",
        ),
    ],
    ids=lambda x: x[0] if isinstance(x, list) else "",
)
def test_identify_has_every_structure_with_its_equation(
    arguments: list[str],
    heading: str,
    equation: str,
    three_recordings: tuple[Path, ...],
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["identify", str(three_recordings[1]), "--structure", *arguments]) == 0

    text = capsys.readouterr().out
    assert text.startswith(f"{heading} fits theta_1 to ")
    assert "u [V] to theta_1 [rad]" in text
    assert equation in text


def test_a_saved_model_is_the_estimated_one(
    three_recordings: tuple[Path, ...], model: Path
) -> None:
    data = armrig.load(three_recordings[1]).dataset("theta_1")

    fit = armrig.load_fit(model)

    np.testing.assert_array_equal(
        fit.theta, oe(data, nb=4, nf=4, integrator=True).theta, strict=True
    )


def test_a_recording_is_not_overwritten_by_a_model(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(three_recordings[1])
    before = three_recordings[1].read_bytes()

    assert main(["identify", path, "--structure", "arx", "--save", path]) == 1

    assert "would be lost" in capsys.readouterr().err
    assert three_recordings[1].read_bytes() == before


def test_validate_judges_a_model_from_a_file(
    three_recordings: tuple[Path, ...],
    model: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = ["validate", str(three_recordings[2]), "--model", str(model)]
    figure = tmp_path / "v.png"

    assert main([*arguments, "--horizon", "1", "--horizon", "20", "-v", "--plot", str(figure)]) == 0
    text = capsys.readouterr().out
    assert main([*arguments, "--horizon", "1", "--horizon", "20", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)

    assert "Predicted 1 and 20 ahead, it fits equally well" in text
    assert "no dynamics missing: p" in text
    assert facts["rms_error"] < 0.006
    assert [x["horizon"] for x in facts["ahead"]] == [1, 20]
    assert facts["on_estimation_data"] is False
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_validating_on_the_estimation_data_is_reported(
    three_recordings: tuple[Path, ...], model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["validate", str(three_recordings[1]), "--model", str(model)]) == 0

    said = capsys.readouterr()
    assert "judged on their own estimation data" in said.err
    assert "on its estimation data" in said.out


@pytest.mark.exhaustive
def test_compare_takes_models_from_files_in_addition_to_its_own(
    three_recordings: tuple[Path, ...], model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, two = (str(path) for path in three_recordings[1:])

    assert main(["compare", one, two, "--model", str(model), "--json"]) == 0
    both = json.loads(capsys.readouterr().out)["models"]
    assert main(["compare", two, "--model", str(model), "--json"]) == 0
    alone = json.loads(capsys.readouterr().out)["models"]

    assert [m["model"] for m in both] == ["ARX", "OE", "physics"]
    assert [m["model"] for m in alone] == ["oe"]
    assert alone[0]["rms_error"] == pytest.approx(both[1]["rms_error"], rel=1e-6)


def test_a_search_says_what_it_chose_and_why(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """The arm has four poles; one more is no better, one less is not enough."""
    arguments = ["identify", str(three_recordings[1]), "--search", "--structure", "oe"]
    arguments += ["--validate", str(three_recordings[2])]

    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert main([*arguments, "--jobs", "2", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)

    assert "OE[4 4 1]" in next(x for x in text.splitlines() if "<- chosen" in x)
    assert "fewer parameters are not enough: OE[3 3 1]" in text
    assert [m["model"] for m in facts["search"]["models"] if m["chosen"]] == ["OE[4 4 1]"]
    assert facts["orders"] == {"nb": 4, "nf": 4, "nk": 1}


def test_what_speaks_against_a_model_is_said_once_and_with_one_name(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    two, three = (str(path) for path in three_recordings[1:])
    arguments = ["identify", two, "--search", "--structure", "oe", "--max-order", "2"]

    assert main([*arguments, "--validate", three]) == 0
    text = capsys.readouterr().out

    assert "std_robust" not in text
    assert text.count("trust σ robust, not σ") == 1
    assert text.count("warning: the residuals") == 0


def test_a_file_that_is_no_model_is_reported_in_one_line(
    three_recordings: tuple[Path, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.json"
    path.write_text("{}")

    assert main(["validate", str(three_recordings[1]), "--model", str(path)]) == 1

    assert capsys.readouterr().err == (
        f"armrig: {path} is no model file; `armrig identify --save` and fit.save(path) write "
        "model files\n"
    )


@pytest.mark.exhaustive
def test_identify_says_roots_and_advice(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["identify", str(three_recordings[1]), "--structure", "oe", "--integrator"]

    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert main([*arguments, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)

    assert main([*arguments, "-v"]) == 0
    whole = capsys.readouterr().out
    assert text.splitlines()[0].endswith("trust σ.")
    assert "A p below 0.01 rejects; --validate F2 tests" in text.splitlines()[1]
    [poles] = re.findall(r"^  poles  1 \(fixed\), (.+)$", text, re.MULTILINE)
    assert re.fullmatch(r"0\.9\d+ ± 0\.1\d+i \(σ \S+, \S+\), 0\.6\d+ ± \S+", poles)
    assert re.search(r"^  zeros  -0\.\d+ ± ", text, re.MULTILINE)
    rows = [line.split() for line in whole.splitlines() if line.startswith(("  pole", "  zero"))]
    assert ["pole", "1.00000", "fixed"] in rows
    [pair] = [row for row in rows if row[0] == "pole" and "±" in row]
    assert len(pair) == 6
    assert all(0 < float(std) < 0.01 for std in pair[4:])
    assert text.endswith("\nnothing to act on\n")
    assert {f["level"] for f in found["advice"]} == {"good"}


def test_the_figure_of_a_search_has_a_point_for_each_model(
    three_recordings: tuple[Path, ...], tmp_path: Path
) -> None:
    from armrig.validation.figures import plot_search
    from armrig.validation.model_search import search

    first, second = (armrig.load(path).dataset() for path in three_recordings[1:])
    found = search(first, second, families=("arx", "oe"), orders=range(1, 5), nk=1)
    ax = plot_search(found)

    marked = [line.get_xydata() for line in ax.lines if line.get_label().startswith("_child")]
    shown = np.concatenate([points for points in marked if len(points)])
    i = found.chosen_index
    [ring] = [line for line in ax.lines if line.get_markersize() == 12]
    for one, rms in zip(found.ranked, found.rms, strict=True):
        if rms < 10 * found.rms.min():  # others are left out
            assert [one.parameters, rms] in shown.tolist()
    assert ring.get_xydata().tolist() == [[found.ranked[i].parameters, found.rms[i]]]


def test_a_short_answer_has_each_coefficient_with_the_deviation_to_trust(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    recording = str(three_recordings[1])

    assert main(["identify", recording, "--structure", "arx", "--na", "2", "--nb", "2"]) == 0
    text = capsys.readouterr().out

    fit = armrig.arx(armrig.load(recording), na=2, nb=2)
    assert fit.trusts_robust
    assert "below, ± is σ robust" in text
    for letter in "ab":
        [shown] = re.findall(rf"^  {letter}1 …   (.+)$", text, re.MULTILINE)
        pairs = [[float(x) for x in pair.split(" ± ")] for pair in shown.split(", ")]
        where = [i for i, name in enumerate(fit.names) if name[0] == letter]
        assert [value for value, _ in pairs] == pytest.approx(fit.theta[where], rel=0.1)
        assert [std for _, std in pairs] == pytest.approx(fit.std_robust[where], rel=0.06)


def next_of(fit: armrig.Fit, *, searched: bool = False, detrended: bool = False) -> str:
    """Return the options that are typed after a model."""
    about = to_act_on(fit, [])
    return options_after(fit, same(fit), about, searched=searched, detrended=detrended)


def same(fit: armrig.Fit) -> Request:
    """Return what estimates a model again."""
    return Request(structure=fit.structure, orders={}).of_fit(fit)  # type: ignore[arg-type]


def test_what_an_estimate_found_decides_by_its_code_and_not_by_its_words() -> None:
    u = np.random.default_rng(4).choice([-1.0, 1.0], 400)
    fit = oe(armrig.Dataset(u=u, y=lfilter([0, 1.0], [1, -0.5], u), Ts=0.1), nb=1, nf=1)
    wrong = replace(fit, findings=(warning("outliers", "of other words"),))
    other = replace(fit, findings=(warning("gaps", "2 samples look wrong; lower the orders"),))
    unsteady = replace(fit, findings=(warning("unstable", "of other words", "structure"),))

    lines = advice_lines(other, [])

    assert to_act_on(wrong, []) - to_act_on(fit, []) == {"outliers"}
    assert to_act_on(other, []) == to_act_on(fit, [])
    assert "! 2 samples look wrong; lower the orders" in lines
    assert to_act_on(unsteady, []) - to_act_on(fit, []) == {"structure"}


def test_the_next_line_lowers_what_the_advice_says_to_lower() -> None:
    rng = np.random.default_rng(3)
    u = rng.choice([-1.0, 1.0], 3000)
    y = lfilter([0, 1, 0.5], [1, -1.5, 0.7], u) + 0.1 * rng.standard_normal(u.size)
    data = armrig.Dataset(u=u, y=y, Ts=0.1)
    high = armrig.oe(data, nb=3, nf=3, starts="few")

    assert "order" in to_act_on(high, [])
    assert next_of(high, searched=True) == "--structure oe --nb 2 --nf 2 --nk 1"
    right = armrig.oe(data, nb=2, nf=2)
    assert next_of(right) == options_of(same(right)) == "--structure oe --nb 2 --nf 2 --nk 1"
    lost = replace(right, converged=False)
    assert next_of(lost) == "--structure oe --nb 1 --nf 1 --nk 1"


def test_the_next_line_searches_where_residuals_are_coloured_and_nothing_says_why() -> None:
    rng = np.random.default_rng(3)
    u = rng.choice([-1.0, 1.0], 2000)
    y = lfilter([0, 1, 0.5], [1, -1.5, 0.7], u) + lfilter([1], [1, -0.8], rng.standard_normal(2000))
    fit = armrig.oe(armrig.Dataset(u=u, y=y, Ts=0.1), nb=2, nf=2)

    assert to_act_on(fit, []) == {"residuals"}
    assert next_of(fit) == "--structure oe --search"
    assert next_of(fit, searched=True) == options_of(same(fit))


@pytest.mark.parametrize(
    ("about", "options"),
    [
        ("level", "--structure arx --na 2 --nb 2 --nk 1 --detrend"),
        ("outliers", "--structure arx --na 2 --nb 2 --nk 1 --hampel"),
        ("structure", "--structure oe --nb 2 --nf 2 --nk 1 --integrator"),
        ("feedback", CHECK),
        ("search", "--structure arx --na 2 --nb 2 --nk 1"),
    ],
)
def test_the_next_line_does_what_is_said_of_the_data(about: str, options: str) -> None:
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 1.0], 300)
    y = lfilter([0, 1, 0.5], [1, -1.5, 0.7], u) + lfilter(
        [1], [1, -1.5, 0.7], 0.1 * rng.standard_normal(300)
    )
    fit = armrig.arx(armrig.Dataset(u=u, y=y, Ts=0.1), na=2, nb=2)

    assert options_after(fit, same(fit), {about}, searched=False, detrended=False) == options


def test_the_next_line_estimates_a_level_along_before_it_fixes_a_pole() -> None:
    """A level of y that u does not cause looks like an integrator until it is estimated."""
    rng = np.random.default_rng(1)
    u = rng.choice([1.0, 2.0], 1000)
    y = 20 + lfilter([0, 0.2], [1, -0.95], u) + 0.05 * rng.standard_normal(1000)
    data = armrig.Dataset(u=u, y=y, Ts=0.5)
    fit, along = armrig.oe(data, nb=1, nf=1), armrig.oe(data, nb=1, nf=1, offset=True)

    assert "level" in to_act_on(fit, [])
    assert next_of(fit).endswith("--nk 1 --offset")
    repeated = options_of(same(along))
    assert next_of(along) == repeated == "--structure oe --nb 1 --nf 1 --nk 1 --offset"
    again = options_after(along, same(along), {"level"}, searched=False, detrended=False)
    assert again == repeated  # one pole is the least


def test_the_next_line_does_what_the_advice_says(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", str(three_recordings[1]), "--structure", "oe"]) == 0
    said = capsys.readouterr()

    assert "! integrator: " in said.out
    [line] = [line for line in said.err.splitlines() if line.startswith("next: ")]
    assert "--structure oe --nb 4 --nf 4 --nk 1 --integrator" in line
