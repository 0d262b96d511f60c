"""Texts of models made by hand, word for word: each number is where it belongs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typst
from armrig.models import characteristics
from armrig.models.characteristics import model_characteristics
from armrig.models.equation import (
    form,
    gain_unit,
    input_and_output,
    labels_of,
    left_out,
    sources_of,
    whiteness_sentence,
)
from armrig.models.estimate import Minimisation, Start
from armrig.models.summary import summary
from armrig.models.uncertainty import Draws

from tests.clients.models.made_fits import made


@pytest.fixture(autouse=True)
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw as often as a range needs at least, not four times."""
    monkeypatch.setattr(characteristics, "DRAWS", 100)


@pytest.mark.parametrize(("agreed", "converged"), [(True, False), (False, True), (True, True)])
def test_agreement_and_convergence_are_reported_separately(agreed: bool, converged: bool) -> None:
    start = Start(name="IV", loss=0.5, iterations=1, converged=converged)
    search = Minimisation(starts=(start,), agreed=agreed, converged=converged)
    said = repr(made(search=search))

    how = "agree" if agreed else "DISAGREE, the best one was used"
    assert f"starts {how}: IV 0.5{'' if converged else ' (NOT CONVERGED)'}" in said.splitlines()[-1]


@pytest.mark.parametrize(
    ("orders", "expected"),
    [
        ({"A": (1, -0.5)}, "A(q) y(t) = B(q) u(t) + e(t)"),
        ({"A": (1, -0.5), "C": (1, 0.2)}, "A(q) y(t) = B(q) u(t) + C(q) e(t)"),
        ({"A": (1, -0.5), "D": (1, 0.2)}, "A(q) y(t) = B(q) u(t) + 1/D(q) e(t)"),
        ({"F": (1, -0.5), "D": (1, 0.2)}, "y(t) = B(q)/F(q) u(t) + 1/D(q) e(t)"),
        ({"F": (1, -0.5), "structure": "channel"}, "y(t) = B(q)/F(q) u(t) + v(t)"),
        ({"A": (1, -0.5), "structure": "iv4"}, "A(q) y(t) = B(q) u(t) + v(t)"),
    ],
)
def test_each_structure_has_its_equation(orders: dict[str, Any], expected: str) -> None:
    assert form(made(**orders)) == expected


def test_the_text_names_the_trustworthy_deviations() -> None:
    said = {
        whiteness_sentence(
            made(structure=structure, whiteness=p, search=Minimisation(curvature=curvature)),
            "s",
            "r",
        )
        for structure, p, curvature in (
            ("iv4", 0.5, 0.0),
            ("oe", 0.5, 0.31),
            ("oe", 0.5, 0.3),
            ("oe", 0.001, 0.3),
            ("oe", 0.001, 0.31),
        )
    }

    assert said == {
        "IV4's prewhitened residuals white (p = 0.500, portmanteau test): trust s",
        "residuals white (p = 0.500, portmanteau test): trust neither s nor r",
        "residuals white (p = 0.500, portmanteau test): trust s",
        "residuals coloured (p = 0.001, portmanteau test): trust r, not s",
        "residuals coloured (p = 0.001, portmanteau test): trust neither s nor r",
    }
    assert "trust" not in whiteness_sentence(made(whiteness=float("nan")))
    assert input_and_output(made(unit="", Ts=0.25)) == "u [V] to alpha, Ts 0.25 s"


def test_typst_compiles_the_equations(tmp_path: Path) -> None:
    """All five polynomials, an unknown deviation, and powers of ten."""
    polynomials: dict[str, Any] = {"A": (1, -0.5), "C": (1, 0.3), "D": (1, -0.7), "F": (1, -0.6)}
    whole = made(**polynomials, std=[0.1] * 5)
    powers = made(B=(0.5, 1e-7, -3e8), nk=0, std=(np.nan, 1e-9, 2e12))
    source = tmp_path / "equations.typ"
    source.write_text(f"{whole.typst()}\n\n{powers.typst()}", encoding="utf-8")

    assert typst.compile(str(source)).startswith(b"%PDF")


def test_a_summary_has_the_ranges_of_linear_deviations() -> None:
    """The gain is 1.5/(0.5 · 0.1); the relative variances of B(1), A(1) and F(1) add up."""
    fit = made(
        A=(1, -0.5), B=(0, 1, 0.5), C=(1, 0.2), F=(1, -0.9), std=(0.01, 0.1, 0.2, 0.3, 0.002)
    )
    found = summary(fit)
    relative = np.sqrt((0.1**2 + 0.2**2) / 1.5**2 + 0.02**2 + 0.02**2)
    low, high = 30 * (1 - 1.96 * relative), 30 * (1 + 1.96 * relative)

    lines = repr(found).splitlines()

    assert lines[:5] == [
        "95 % ranges, classic covariance; * by draws, as the linearisation is poor",
        "  pole            0.5000 (0.4804 … 0.5196)",
        "  pole            0.9000 (0.8961 … 0.9039)",
        "  zero            −0.50 (−0.90 … −0.10)",
        f"  gain            30.0 ({low:.1f} … {high:.1f}) rad/V",
    ]
    assert lines[-1] == "  checked by 1000 draws of the parameters"
    assert [line.rpartition(" ")[2] for line in lines[7:12]] == ["rad/s", "s", "s", "s", "%"]
    facts = found.facts()
    assert facts["figures"]["gain"]["low"] == pytest.approx(low, rel=1e-4)
    assert facts["figures"]["resonance"]["value"] is None
    assert facts["poles"][1]["real"] == pytest.approx([0.9 - 0.00392, 0.9 + 0.00392], abs=1e-6)
    assert facts["draws"] == {"made": 1000, "unstable": 0, "degenerate": 0}
    robust = summary(made(F=(1, -0.9), std=(0.1, 0.002), whiteness=1e-4))
    assert repr(robust).startswith("95 % ranges, robust covariance")
    assert "0.9000 (0.8922 … 0.9078)" in repr(robust)
    assert robust.facts()["covariance"] == "robust"


def test_a_summary_of_a_complex_pair_has_both_signs_in_its_facts() -> None:
    """z² - 1.2 z + 0.52: the pair 0.6 ± 0.4i moves by df1/2 and df2/(2 · 0.4)."""
    fit = made(F=(1, -1.2, 0.52), std=(0.1, 1e-3, 2e-3))
    found = summary(fit)
    deviations = np.array([0.5e-3, np.hypot(0.6 * 0.5e-3 / 0.4, 1e-3 / 0.4)])

    facts = found.facts()["poles"]

    assert sorted(pole["value"][1] for pole in facts) == pytest.approx([-0.4, 0.4])
    for pole in facts:
        widths = [np.diff(pole[name])[0] for name in ("real", "imaginary_magnitude")]
        assert widths == pytest.approx(2 * 1.96 * deviations, rel=1e-3)
        assert np.mean(pole["imaginary_magnitude"]) == pytest.approx(0.4)
    assert sum(line.startswith("  pole") for line in repr(found).splitlines()) == 1


def test_a_pair_that_cancels_is_in_the_summary() -> None:
    fit = made(B=(0, 1, -0.801), F=(1, -0.8), std=(0.1, 0.05, 0.05))

    found = summary(fit)

    assert "  cancel: pole 0.800 and zero 0.801 cannot be distinguished" in repr(found)
    [pair] = found.facts()["cancelling"]
    assert (pair["pole"], pair["zero"]) == (pytest.approx([0.8, 0]), pytest.approx([0.801, 0]))
    assert pair["p"] == pytest.approx(overlap_p(0.001, np.hypot(0.0500, 0.05)), abs=0.02)


def overlap_p(distance: float, std: float) -> float:
    """Return the two-sided p value of a distance that is normal."""
    from scipy.stats import norm

    return float(2 * norm.sf(distance / std))


def test_the_labels_of_a_figure_come_from_the_first_model_that_has_them() -> None:
    nameless, plain = made(unit=""), made(unit="°", input_unit="mV", source="ab12")
    system = type("System", (), {"name": "G1"})()

    assert gain_unit([system, nameless, plain]) == "°/mV"
    assert gain_unit([plain], rate=True) == "°/s/mV"
    assert gain_unit([nameless]) == "–"
    assert labels_of([plain, system, object()], None) == ["PEM[0 1 0 0 0 1]", "G1", "model"]
    assert labels_of([plain], ("mine",)) == ["mine"]
    assert sources_of([system, plain]) == ["", "ab12"]


def test_rejected_draws_are_counted_by_their_reason_and_model() -> None:
    some = Draws(theta=np.zeros((1, 1)), asked=200, unstable=3, degenerate=7)
    none = Draws(theta=np.zeros((1, 1)), asked=200, unstable=0, degenerate=0)
    said = "3 of 200 unstable, 7 of 200 degenerate"

    assert left_out({"a": some}, models=1) == [f"draws left out: {said}"]
    assert left_out({"a": none, "b": some, "c": None}, models=3) == [f"draws left out: b: {said}"]
    assert left_out({"b": some}, models=2) == [f"draws left out: b: {said}"]
    assert left_out({"a": none, "c": None}, models=2) == []


def test_a_model_with_an_unknown_covariance_has_no_deviations() -> None:
    t = model_characteristics(made(F=(1, -0.8), std=(np.nan, 0.1)))

    assert np.isnan([*t.std.values()]).all()
    assert t.draws is None
    known = model_characteristics(made(F=(1, -0.8)))
    assert set(known.std.values()) == {0.0}
