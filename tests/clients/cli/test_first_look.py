"""The commands before a model is estimated: model, plot, sampling, hints (handout 2.1 to 3.2)."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import armrig
import pytest
from armrig.cli import main
from armrig.excitation import step, telegraph
from armrig.numerics.quantities import with_std
from armrig.recordings.overview import overview

from tests.clients.made_recordings import gap, manifest, of_the_arm, recorded, turning, written

PNG = b"\x89PNG"


def facts(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> Any:
    """Return the command's JSON output."""
    assert main([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def said(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Return the command's output for a person."""
    assert main(arguments) == 0
    return capsys.readouterr().out


def test_model_says_what_the_handout_asks_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figure = tmp_path / "step.png"

    text = said(["model", "-o", str(figure)], capsys)
    handout = facts(["model"], capsys)["models"]["handout"]

    for shown in ("1.8623", "98.40", "-8.05 ± 17.08i", "-36.74", "±15.75i", "-52.84", "-947.9"):
        assert shown in text
    assert text.splitlines()[1].startswith("x' = A x + B u")
    assert handout["steady_speed"] == pytest.approx(1.8623, abs=5e-5)
    assert handout["simulated"]["speed"] == pytest.approx(handout["steady_speed"], rel=1e-6)
    assert handout["simulated"]["slope"] == pytest.approx(handout["initial_slope"], rel=1e-6)
    assert handout["A"][2] == pytest.approx([0, 700, -52.84, 0], rel=1e-4)
    assert figure.read_bytes().startswith(PNG)
    assert max(map(len, text.splitlines()[:-1])) <= 80


def test_model_says_in_its_sentence_what_its_table_says(capsys: pytest.CaptureFixture[str]) -> None:
    """The slope was 78.9 rad/s² in the sentence and 78.96 in the table."""
    slower = said(["model", "--set", "R_m=4"], capsys)
    both = said(["model", "--set", "J_1=0.0034", "--set", "K_lin=2.38"], capsys)

    assert slower.count("78.96") == 4  # twice in B
    assert re.search(r"K_lin=2.38 +both changes\n", both)
    assert "63 % time of J_1=0.0034, K_lin=2.38: the first rise" in both


def test_model_holds_changed_parameters_against_the_handouts(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Neither J_1 nor J_2 changes the steady speed (assignment 2.3)."""
    arguments = ["model", "--set", "J_1=0.0034", "--set", "J_2=0.005"]

    text = said(arguments, capsys)
    found = facts(arguments, capsys)["models"]

    assert list(found) == ["handout", "J_1=0.0034", "J_2=0.005", "both"]
    assert len({round(m["steady_speed"], 9) for m in found.values()}) == 1
    slopes = [round(m["initial_slope"], 2) for m in found.values()]
    assert slopes == [98.40, 49.20, 98.40, 49.20]
    assert "simulated with J_1=0.0034, J_2=0.005: the speed begins to rise by 49.20 rad/s²" in text
    assert max(map(len, text.splitlines()[:-1])) <= 80


@pytest.mark.parametrize(
    ("given", "expected", "code"),
    [
        (
            "J_3=1",
            "armrig: --set J_3=1: give NAME=VALUE, such as J_1=0.0017; names are J_1, J_2, N,",
            2,
        ),
        ("J_1", "--set J_1: give NAME=VALUE", 2),
        (
            "J_2=6e-3kgm2",
            "armrig: --set J_2=6e-3kgm2: give the number alone, in kg m², such as --set J_2=0.0048",
            2,
        ),
        ("J_1=0", "J_1=0.0 must be finite and > 0", 1),
    ],
)
def test_model_refuses_parameters_that_no_rig_has(
    given: str, expected: str, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["model", "--set", given]) == code

    assert expected in capsys.readouterr().err


def test_plot_draws_a_recording_and_says_what_is_wrong(
    three_recordings: tuple[Path, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figure = tmp_path / "all.png"
    arguments = ["plot", str(three_recordings[2]), "-o", str(figure)]

    text = said(arguments, capsys)
    found = facts(arguments, capsys)

    assert figure.read_bytes().startswith(PNG)
    assert found["missing"] == 5
    assert found["outliers"] == {"theta_1": [], "alpha": []}
    for name in ("velocity", "alpha"):
        drift = found["drift"][name]
        assert abs(drift["rate"]) < 3 * drift["std"]
    rows = dict(line.split("  ", 1) for line in text.splitlines())
    assert rows["missing"].strip() == "5 of 1200 samples"
    assert rows["outliers, alpha"].strip() == "none"


def test_plot_of_no_samples_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, recorded([]))

    assert main(["plot", str(path), "-o", str(tmp_path / "x.png")]) == 1

    assert "no samples, so there is nothing to draw" in capsys.readouterr().err


def test_a_part_of_a_recording_is_drawn_at_its_times(tmp_path: Path) -> None:
    samples = turning([30_000 + 100 * k for k in range(200)])
    messages = [*samples[:150], gap(150, 10, 2.5), *samples[160:]]
    about = manifest(k_first=0, samples=200)
    rec = armrig.load(written(tmp_path, recorded(messages, manifest=about)), start=1.0)

    figure = overview(rec).plot()

    assert figure.axes[0].get_xlim() == pytest.approx((1.0, 1.99))
    [shade] = [p for p in figure.axes[1].patches if p.get_alpha() == 0.35]
    box = shade.get_window_extent().transformed(figure.axes[1].transData.inverted())
    assert (box.x0, box.x1) == pytest.approx((1.495, 1.595))


def test_plot_finds_an_outlier_where_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tests.clients.made_recordings._reading", _with_outlier(at=400))
    path = written(tmp_path, of_the_arm(telegraph(800, 0.05, seed=3)))

    found = facts(["plot", str(path)], capsys)

    assert found["outliers"]["alpha"] == [pytest.approx(4.0)]
    assert (tmp_path / "plot.png").read_bytes().startswith(PNG)


def _with_outlier(at: int) -> Any:
    """Return a converter that reads alpha wrongly once."""
    from tests.clients import made_recordings

    right, calls = made_recordings._reading, iter(range(10**6))

    def reading(angle: float, pot: Any, rng: Any) -> int:
        counts = right(angle, pot, rng)
        return counts if pot.wraps or next(calls) != at else counts + 6400

    return reading


def test_plot_of_a_chassis_says_that_alpha_rests(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = recorded(
        turning([30000 + 40 * (k % 50) for k in range(200)]), manifest=manifest(samples=200)
    )
    path = written(tmp_path, data)

    found = facts(["plot", str(path), "-o", str(tmp_path / "x.png")], capsys)

    assert "alpha" not in found["outliers"]
    assert found["not_looked_at"]["alpha"].startswith("alpha is constant")


def test_plot_says_how_fast_the_chassis_turned_and_no_noise_of_the_converter(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One step of the converter in 2 ms would look like 3 rad/s."""
    counts = [32768 + 64 * (k % 2) for k in range(200)]
    data = recorded(turning(counts), manifest=manifest(samples=200, Ts=0.002))

    text = said(["plot", str(written(tmp_path, data)), "-o", str(tmp_path / "x.png")], capsys)

    [line] = [x for x in text.splitlines() if x.startswith("theta_1 ")]
    low, high = map(float, re.findall(r"at (\S+) to (\S+) rad/s over 0.1 s", line)[0])
    assert max(-low, high) < 0.1


def test_plot_of_a_step_takes_no_swing_for_outliers_or_an_integrator(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A single change of u determines no model to judge the samples by."""
    path = written(tmp_path, of_the_arm(step(600, at=100)))

    found = facts(["plot", str(path), "-o", str(tmp_path / "x.png")], capsys)

    assert found["outliers"] == {}
    assert found["not_looked_at"]["outliers"].startswith(
        "u changes 1 time; with fewer than 20 changes"
    )
    assert "look like a drift" in found["not_looked_at"]["velocity"]
    assert set(found["drift"]) == {"alpha"}
    assert abs(found["drift"]["alpha"]["rate"]) < 3 * found["drift"]["alpha"]["std"]


@pytest.mark.exhaustive
def test_sampling_recommends_a_time_with_its_method(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, of_the_arm(step(600, at=100)))
    other = written(tmp_path, of_the_arm(telegraph(1500, 0.05, seed=1)), "telegraph.mcap")
    figure = tmp_path / "sampling.png"

    text = said(["sampling", str(path), "-v", "-o", str(figure)], capsys)
    by_step, by_impulse = (facts(["sampling", str(p)], capsys) for p in (path, other))

    assert text.startswith("sampling time: ")
    assert "step analysis" in text
    assert (by_step["method"], by_impulse["method"]) == ("step", "impulse response")
    assert by_step["Ts"] in (0.002, 0.005, 0.01)
    assert by_step["Ts_transient"][0] < by_step["Ts_transient"][1]
    # Each deviation of the text, by the same digits; of an impulse response there is none.
    analysed = by_step["step"]
    assert by_step["settling_std"] == analysed["settling_std"] > 0
    assert by_impulse["settling_std"] is by_impulse.get("step") is None
    for name in ("gain", "tau", "equivalent_time", "settling"):
        assert f" {with_std(analysed[name], analysed[name + '_std'])} " in text
    assert figure.read_bytes().startswith(PNG)


@pytest.mark.exhaustive
def test_hints_motivate_the_structure_of_the_arm(
    three_recordings: tuple[Path, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Four poles, one at 1, no delay beyond the hold's; with reasons and a figure."""
    figure = tmp_path / "hints.png"
    arguments = ["hints", str(three_recordings[1])]

    text = said([*arguments, "-o", str(figure)], capsys)
    found = facts(arguments, capsys)

    assert found["orders"] == {"nb": 4, "nf": 4, "nk": 1}
    assert found["integrator"] is True
    assert len(found["reasons"]) == len(text.splitlines()) - 1
    assert figure.read_bytes().startswith(PNG)


def test_simulate_and_compare_show_the_handouts_with_the_changed_parameters(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """The rig has the handout's parameters here: they fit better than a heavier arm's (2.3)."""
    estimation, validation = map(str, three_recordings[1:])
    changed = ["--set", "J_2=0.006"]

    simulated = facts(["simulate", validation, *changed], capsys)["models"]
    compared = facts(["compare", estimation, validation, *changed], capsys)["models"]

    assert [m["model"] for m in simulated] == ["handout", "J_2=0.006"]
    assert [m["model"] for m in compared] == ["ARX", "OE", "physics", "J_2=0.006"]
    for models in (simulated, compared):
        handout, heavier = models[-2:]
        assert handout["rms_error"] < heavier["rms_error"]
