"""A model goes through a file, into a report and into a notebook."""

from __future__ import annotations

import json
from dataclasses import fields as dataclass_fields
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.finding import warning
from armrig.data.merging import merge
from armrig.data.step import MEAN, Step, codes_of
from armrig.estimation.polynomial_structures import bj
from armrig.models.estimate import Minimisation, PastProjection, Start
from armrig.models.fit import Fit
from armrig.models.model_file import fit_of, load_fit
from armrig.models.model_writing import model_text
from armrig.models.structure import FreeResponse
from armrig.numerics.polynomial import apply_filter
from armrig.validation.residuals import residuals
from armrig_core.errors import FileError

from tests.clients.models.made_fits import FORMS, apart, changed, fit_of_form, matrices


def data(seed: int) -> Dataset:
    """Return y = B/F u + C/D e, as from a recording."""
    u, e = np.random.default_rng(seed).standard_normal((2, 400))
    y = apply_filter([0, 1.0, 0.5], [1, -1.2, 0.6], u) + 0.3 * apply_filter([1, 0.5], [1, -0.7], e)
    history = ("detrend(order=0)",)
    return Dataset(u=u, y=y, Ts=0.1, output="θ<1>", unit="rad", source="ab12", history=history)


@pytest.fixture(scope="module")
def fit() -> Fit:
    return bj(merge(data(1).split(2)), nb=2, nc=1, nd=1, nf=2, starts="few")


def filled(fit: Fit) -> Fit:
    """Return a model with a value in each field that an estimation may fill."""
    numbers = warning("overlap", "first", start=1.5, stop=float("inf"))
    return replace(
        fit,
        offset=True,
        shared=True,
        output_weights=(1.5, 2.5),
        search=Minimisation(
            converged=False,
            agreed=False,
            curvature=0.75,
            starts=(
                Start(name="IV", loss=float("inf"), iterations=7, converged=False),
                Start(name="ARX", loss=0.5, iterations=2, converged=True),
            ),
        ),
        free=(
            FreeResponse(transients=(0.5, -1.5), level=2.5, offset=-3.5),
            FreeResponse(transients=(), level=0.5, offset=float("inf")),
        ),
        projection=PastProjection(
            weights="cva",
            horizon=14,
            suggested_order=3,
            singular_values=np.array([3.0, 1 / 3]),
            canonical_correlations=np.array([0.9, 1 / 7]),
        ),
        findings=(numbers, warning("reflected", "second", "order")),
        source="ab12",
        history=(Step("removed the mean", MEAN), "weighed"),
        digest="cd34",
    )


@pytest.mark.parametrize("name", [*FORMS, "one channel", "IV, untested"])
def test_a_saved_model_is_loaded_exactly(fit: Fit, name: str, tmp_path: Path) -> None:
    of_one = {"one channel": fit, "IV, untested": changed(fit, whiteness=float("nan"))}
    saved = filled(of_one[name] if name in of_one else fit_of_form(FORMS[name]()))
    saved.save(tmp_path / "model.json")

    loaded = load_fit(tmp_path / "model.json")

    for field in dataclass_fields(Fit):
        if field.name not in ("form", "quality", "projection"):
            found, known = getattr(loaded, field.name), getattr(saved, field.name)
            np.testing.assert_array_equal(found, known, field.name)
            assert type(found) is type(known)
    for field in dataclass_fields(PastProjection):
        found, known = (getattr(fit.projection, field.name) for fit in (loaded, saved))
        np.testing.assert_array_equal(found, known, field.name)
    assert loaded.findings == saved.findings
    assert codes_of(loaded.history) == [MEAN, ""]
    np.testing.assert_array_equal(loaded.theta, saved.theta)
    assert loaded.form.nk == saved.form.nk
    assert loaded.form.integrators == saved.form.integrators
    for found, known in zip(loaded.quality, saved.quality, strict=True):
        assert (found.loss, found.N, found.fit_percent) == (known.loss, known.N, known.fit_percent)
        np.testing.assert_equal(found.white.p_value, known.white.p_value)
        assert found.white.test == known.white.test
    assert repr(loaded) == repr(saved)
    assert model_text(loaded) == model_text(saved)


def test_a_loaded_model_recognises_its_estimation_data(fit: Fit, tmp_path: Path) -> None:
    fit.save(tmp_path / "model.json")

    tested = residuals(load_fit(tmp_path / "model.json"), merge(data(1).split(2)))

    assert tested.on_estimation_data
    np.testing.assert_array_equal(tested.e, residuals(fit, merge(data(1).split(2))).e)


def test_a_model_file_is_plain_json(fit: Fit, tmp_path: Path) -> None:
    """JSON has no NaN."""
    saved = changed(filled(fit), whiteness=float("nan"), fit_percent=-np.inf)
    saved.save(tmp_path / "model.json")
    text = (tmp_path / "model.json").read_text(encoding="utf-8")

    content = json.loads(text, parse_constant=lambda name: pytest.fail(name))

    assert content["format"] == "armrig model"
    (quality,) = content["quality"]
    assert quality["white"]["p_value"] == "nan"
    assert quality["fit_percent"] == "-inf"
    assert content["outputs"] == ["θ<1>"]
    assert [f["text"] for f in content["findings"]] == ["first", "second"]
    assert [f["remedy"] for f in content["findings"]] == ["", "order"]
    assert content["findings"][0]["numbers"] == {"start": 1.5, "stop": "inf"}
    assert "θ" in text


def test_the_keys_of_a_model_file_equal_the_stored_keys(fit: Fit, tmp_path: Path) -> None:
    fit.save(tmp_path / "model.json")

    keys = set(json.loads((tmp_path / "model.json").read_text(encoding="utf-8")))

    assert keys == {
        *("format", "version", "armrig", "structure", "form", "specification", "shared"),
        *("offset", "covariance", "covariance_robust", "noise_covariance", "output_weights"),
        *("quality", "Ts", "converged", "starts", "agreed", "curvature", "free"),
        *("weights", "horizon", "singular_values", "canonical_correlations", "suggested_order"),
        *("outputs", "units", "inputs", "input_units", "source", "history", "digest"),
        *("findings", "treatment"),
    }


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": "other"}, "is no model file"),
        ({"version": 3, "armrig": "9.9"}, "format version 3, this armrig reads 2.* armrig 9.9"),
        ({"version": "2"}, "format version '2', this armrig reads 2"),
        ({"form": {"kind": "polynomials"}}, "form: Object missing required field `A`"),
        ({"form": {"kind": "matrices"}}, "form: Object missing required field `A`"),
        ({"form": None}, "form: Expected the kind matrices or polynomials or .*, got None"),
        ({"covariance": "x"}, "covariance: could not convert string to float: 'x'"),
        ({"covariance": [[1.0]]}, "it has .* parameters, and covariances of another size"),
        ({"covariance_robust": [[1.0]]}, "it has .* parameters, and covariances of another size"),
        ({"noise_covariance": [[-1.0]]}, "noise_covariance does not have . variances"),
        ({"Ts": "nan"}, "a parameter or Ts is no finite number"),
        ({"Ts": None}, "Ts: Expected `float`, got `null`"),
        ({"quality": [{}]}, r"quality: Object missing required field `loss` - at `\$\[0\]`"),
        ({"starts": [{}]}, r"starts: Object missing required field `name` - at `\$\[0\]`"),
    ],
)
def test_a_damaged_model_file_is_refused(
    fit: Fit, tmp_path: Path, change: dict[str, Any], said: str
) -> None:
    path = tmp_path / "model.json"
    for saved in (fit, fit_of_form(apart()), fit_of_form(matrices())):
        saved.save(path)
        content = json.loads(path.read_text(encoding="utf-8"))
        path.write_text(json.dumps(content | change))

        with pytest.raises(FileError, match=f"model.json .*{said}"):
            load_fit(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"F": [[[0.0, -1.3, 0.6]]]}, "A, C, D or F does not begin with 1"),
        ({"A": [[[2.0]]]}, "A, C, D or F does not begin with 1"),
        ({"B": [[[0.0, "nan", 1.0]]]}, "a parameter or Ts is no finite number"),
        ({"B": [[[1.0, 1.0, 1.0]]]}, "B has coefficients before the lag nk"),
    ],
)
def test_a_model_file_of_impossible_polynomials_is_refused(
    fit: Fit, change: dict[str, Any], said: str
) -> None:
    content = json.loads(model_text(fit))

    with pytest.raises(FileError, match=f"m.json is a damaged model: .*{said}"):
        fit_of(json.dumps(content | {"form": content["form"] | change}), "m.json")


def test_a_model_file_without_a_key_is_refused(fit: Fit) -> None:
    content = json.loads(model_text(fit))
    for key in ("form", "covariance", "noise_covariance", "Ts", "starts", "findings", "treatment"):
        lacking = {name: value for name, value in content.items() if name != key}

        with pytest.raises(FileError, match=f"is a damaged model: {key} is missing; save the"):
            fit_of(json.dumps(lacking), "m.json")


def test_a_file_needs_the_quality_of_each_of_several_outputs() -> None:
    content = json.loads(model_text(fit_of_form(apart())))

    with pytest.raises(FileError, match="damaged model: its fields do not match each other"):
        fit_of(json.dumps(content | {"quality": content["quality"][:1]}), "m.json")


def test_a_file_that_is_cut_off_is_refused(fit: Fit, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    fit.save(path)
    text = path.read_text(encoding="utf-8")
    for content in (text[: len(text) // 2], "", "{}", '{"version": 1}', "[]", "[1]", "3", "\0"):
        path.write_text(content, encoding="utf-8")

        with pytest.raises(FileError):
            load_fit(path)


def test_a_model_of_a_windows_editor_is_read(fit: Fit, tmp_path: Path) -> None:
    """A Windows editor writes a byte order mark before the text."""
    path = tmp_path / "model.json"
    fit.save(path)
    path.write_text(path.read_text(encoding="utf-8"), encoding="utf-8-sig")

    assert repr(load_fit(path)) == repr(fit)
    path.write_text(path.read_text(encoding="utf-8-sig"), encoding="utf-16")
    with pytest.raises(
        FileError, match=r"json: it is saved as UTF-16: save it as UTF-8; a model is"
    ):
        load_fit(path)
