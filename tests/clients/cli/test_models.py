"""`armrig identify` and `armrig compare`: their statements about a model."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig.cli.model_output import coefficients, lags_outside
from armrig.cli.spinner import estimating
from armrig.models.structure_table import users
from armrig.numerics.whiteness import Whiteness
from armrig.validation.answer import tests_sentence as sentence

from tests.clients.made_recordings import recorded, sample, written
from tests.clients.told import told
from tests.sampling import sampled


@pytest.mark.parametrize(
    ("samples", "said"),
    [
        (
            5,
            "5 samples are too few for a model: record longer, at least 180 samples for na=9, nb=9",
        ),
        (50, "na=9, nb=9: 18 parameters from 50 samples; at most 5"),
    ],
)
def test_orders_too_high_for_the_data_are_reported_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], samples: int, said: str
) -> None:
    path = written(tmp_path, recorded([sample(k) for k in range(samples)]))

    assert main(["identify", str(path), "--structure", "arx", "--na", "9", "--nb", "9"]) == 1

    assert f"armrig: {said}" in told(capsys)


def test_identify_gives_the_model_and_its_uncertainty(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["identify", str(three_recordings[1]), "--structure", "oe", "--integrator"]
    arguments += ["--validate", str(three_recordings[2])]

    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert main([*arguments, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)

    assert "OE(nb=4, nf=4, nk=1)" in text
    assert "Simulated on the validation data it fits to" in text
    assert facts["orders"] == {"nb": 4, "nf": 4, "nk": 1}
    assert set(facts["parameters"]["f1"]) == {"value", "std", "std_robust"}
    assert facts["validation"]["rms_error"] < 0.006
    assert facts["recording"] != facts["validation"]["recording"]


@pytest.mark.exhaustive
def test_compare_puts_the_models_and_the_physics_side_by_side(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    files = [str(path) for path in three_recordings[1:]]

    assert main(["compare", *files]) == 0
    text = capsys.readouterr().out
    assert main(["compare", *files, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)

    assert [m["model"] for m in facts["models"]] == ["ARX", "OE", "physics"]
    assert all(f"{m['rms_error']:.4g}" in text for m in facts["models"])
    assert all(f"velocity fit {m['velocity_fit_percent']:7.2f} %" in text for m in facts["models"])


@pytest.mark.exhaustive
def test_a_model_that_is_estimated_here_anyway_is_shown_once(
    three_recordings: tuple[Path, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, estimation, validation = map(str, three_recordings)
    saved = []
    for n in ("4", "3"):
        saved += ["--model", str(tmp_path / f"of-{n}.json")]
        orders = ["--structure", "oe", "--nb", n, "--nf", n, "--integrator"]
        assert main(["identify", estimation, *orders, "--save", saved[-1]]) == 0
    capsys.readouterr()

    assert main(["compare", estimation, validation, *saved, "--json"]) == 0

    said = capsys.readouterr()
    assert [m["model"] for m in json.loads(said.out)["models"]] == ["ARX", "OE", "physics", "of-3"]
    assert "the model of-4 equals the OE model estimated here; it is shown once" in said.err


def test_the_coefficients_are_a_table_with_both_standard_deviations(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["identify", str(three_recordings[1]), "--structure", "arx"]

    assert main([*arguments, "--validate", str(three_recordings[2]), "--verbose"]) == 0

    text = capsys.readouterr().out
    assert ["coefficient", "estimate", "σ", "σ", "robust"] in [x.split() for x in text.splitlines()]
    assert [x.split()[:2] for x in text.splitlines()[6:14:7]] == [["a1", "q^-1"], ["b4", "q^-4"]]
    assert " rad², FPE " in text
    assert "residuals coloured (p < 0.001, " in text
    assert " test): trust σ robust, not σ" in text
    assert "no dynamics missing: p" in text
    assert "no feedback seen: p" in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["arx", "--nf", "3"],
            "--nf 3 goes with --structure oe or bj; an ARX model has na, nb and nk",
        ),
        (
            ["oe", "--na", "3"],
            f"goes with --structure {' or '.join(users('na'))}; an OE model has nb, nf and nk",
        ),
        (
            ["OE"],
            "--structure: 'OE' is not one of 'arx', 'armax', 'oe', 'bj', 'iv4', 'n4sid'",
        ),
        (["arx", "--na", "two"], "--na two: must be an integer; see"),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, list) else "",
)
def test_an_option_that_does_not_apply_is_refused(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", "f.mcap", "--structure", *arguments]) == 2

    assert said in told(capsys)


@pytest.mark.parametrize("command", [["identify", "--structure", "oe"], ["compare"], ["report"]])
def test_orders_absurd_for_the_data_are_refused_with_what_is_allowed(
    command: list[str], three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """Each parameter needs ten samples."""
    files = [str(path) for path in three_recordings[1 : 2 if command[0] == "identify" else 3]]

    assert main([*command, *files, "--nb", "100", "--nf", "100"]) == 1

    said = told(capsys)
    assert "from 1459 samples; at most 145 parameters, one for each 10 samples" in said


def test_numerics_that_give_up_are_reported_as_orders_too_high() -> None:
    def give_up() -> None:
        with estimating("nb and nf"):
            np.sqrt(np.array([-1.0]))
            np.linalg.svd(np.full((2, 2), np.nan))

    with pytest.raises(ValueError, match="too high for these data: lower nb and nf"):
        give_up()


@pytest.mark.exhaustive
def test_an_integrator_is_hinted_at_where_it_belongs(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """The angle integrates, the velocity does not."""
    path = str(three_recordings[1])

    assert main(["identify", path, "--structure", "oe"]) == 0
    angle = capsys.readouterr().err
    arguments = ["--structure", "oe", "--integrator", "--signal", "velocity"]
    assert main(["identify", path, *arguments]) == 0
    velocity = capsys.readouterr().err

    assert "the angle theta_1 integrates: try --integrator" in angle
    assert "--integrator: the rig has no pole at 1 for velocity" in velocity


def test_a_model_judged_on_its_own_data_is_reported(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(three_recordings[1])

    assert main(["compare", path, path]) == 0

    assert "judged on their own estimation data" in capsys.readouterr().err


def test_an_estimate_has_two_digits_of_its_standard_deviation() -> None:
    u = np.random.default_rng(1).standard_normal(100)
    fit = armrig.arx(armrig.Dataset(u=u, y=np.append(0.0, u[:-1]) + 0.1 * u, Ts=1.0), na=1, nb=1)
    fit = replace(fit, covariance=np.eye(2) * 0.03**2, covariance_robust=np.eye(2) * 0.2**2)

    rows = [line.split() for line in coefficients(fit)[1:]]

    assert [row[2] for row in rows] == [f"{value:.3f}" for value in fit.theta]


@pytest.mark.parametrize(
    ("horizon", "how"),
    sampled([([], "simulated"), (["--horizon", "3"], "predicted 3 samples ahead")]),
)
def test_compare_says_how_and_on_which_recording_it_validates(
    three_recordings: tuple[Path, ...],
    capsys: pytest.CaptureFixture[str],
    horizon: list[str],
    how: str,
) -> None:
    assert main(["compare", str(three_recordings[1]), str(three_recordings[0]), *horizon]) == 0

    assert f"\n{how} on {three_recordings[1]}, its second half" in capsys.readouterr().out


def test_lags_outside_the_band_are_explained_where_the_joint_test_accepts() -> None:
    tests: Any = SimpleNamespace(
        whiteness=0.5,
        autocorrelation=np.array([1.0, 0.2, 0.0]),
        autocorrelation_band=0.1,
        missing_dynamics=0.001,
        feedback=0.5,
        cross_lags=np.arange(-2, 3),
        cross_correlation=np.array([0.0, 0.2, 0.2, 0.2, 0.2]),
        cross_std=np.full(5, 0.04),
    )

    text = lags_outside(tests)
    tests.feedback = tests.whiteness = 0.001

    assert text.startswith("2 of 4 lags are outside the 99 % band although their joint test")
    assert lags_outside(tests) == ""


@pytest.mark.parametrize(
    ("white", "dynamics", "feedback", "powerless", "said"),
    [
        (
            0.5,
            0.5,
            0.5,
            "",
            "Its residuals pass: white (p = 0.500), no dynamics missing (p = 0.500), no feedback",
        ),
        (0.001, 0.5, 0.5, "", "do not pass: they are coloured (p = 0.001): look at the noise"),
        (
            0.5,
            0.001,
            0.001,
            "",
            "do not pass: dynamics are missing (p = 0.001): look at the orders",
        ),
        (0.5, 0.5, 0.001, "", "do not pass: there is feedback (p = 0.001): look at the experi"),
        (0.5, 0.5, 0.5, "u is constant", "The tests of its residuals have no power: u is constant"),
        (0.5, np.nan, 0.5, "", "Residuals white (p = 0.500); too few samples"),
    ],
)
def test_a_sentence_says_which_test_the_residuals_fail(
    white: float, dynamics: float, feedback: float, powerless: str, said: str
) -> None:
    tests: Any = SimpleNamespace(
        white=Whiteness(p_value=white, test=""),
        missing_dynamics=dynamics,
        feedback=feedback,
        powerless=powerless,
    )

    text = sentence(tests)

    assert said in text
    assert powerless or np.isnan(dynamics) or text.count("p = ") == 3
    assert powerless or np.isnan(dynamics) or text.endswith("; a p below 0.01 rejects")
    assert ("dynamics are missing" in text) + ("there is feedback" in text) < 2
