"""A model goes through a file, into a report and into a notebook."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.finding import warning
from armrig.data.merging import merge
from armrig.estimation.arx import arx
from armrig.estimation.bj import bj
from armrig.models.estimate import Start
from armrig.models.fit import Fit
from armrig.models.model_file import fit_of, load_fit
from armrig.models.model_writing import model_text
from armrig.models.structure import FreeResponse
from armrig.numerics.polynomial import filtered
from armrig.validation.residuals import residuals
from armrig_core.errors import FileError


def data(seed: int) -> Dataset:
    """Return y = B/F u + C/D e, as from a recording."""
    u, e = np.random.default_rng(seed).standard_normal((2, 400))
    y = filtered([0, 1.0, 0.5], [1, -1.2, 0.6], u) + 0.3 * filtered([1, 0.5], [1, -0.7], e)
    history = ("detrend(order=0)",)
    return Dataset(u=u, y=y, Ts=0.1, output="θ<1>", unit="rad", source="ab12", history=history)


@pytest.fixture(scope="module")
def fit() -> Fit:
    return bj(merge(data(1).split(2)), nb=2, nc=1, nd=1, nf=2, starts="few")


def test_a_saved_model_is_loaded_exactly(fit: Fit, tmp_path: Path) -> None:
    for saved in (fit, arx(data(2), na=1, nb=1), replace(fit, whiteness=float("nan"))):
        saved.save(tmp_path / "model.json")
        loaded = load_fit(tmp_path / "model.json")

        for f in fields(Fit):
            np.testing.assert_array_equal(getattr(loaded, f.name), getattr(saved, f.name), f.name)
        assert repr(loaded) == repr(saved)
        assert loaded.source == "ab12"
        assert type(loaded.starts) is tuple
    tested = residuals(loaded, merge(data(1).split(2)))
    assert tested.on_estimation_data
    np.testing.assert_array_equal(tested.e, residuals(fit, merge(data(1).split(2))).e)


def test_a_model_file_is_plain_json(fit: Fit, tmp_path: Path) -> None:
    """JSON has no NaN."""
    replace(fit, whiteness=float("nan"), fit_percent=-np.inf).save(tmp_path / "model.json")
    text = (tmp_path / "model.json").read_text(encoding="utf-8")

    content = json.loads(text, parse_constant=lambda name: pytest.fail(name))

    assert content["format"] == "armrig model"
    assert content["whiteness"] == "nan"
    assert content["fit_percent"] == "-inf"
    assert content["output"] == "θ<1>"
    assert "θ" in text


def test_the_keys_of_a_model_file_equal_the_stored_keys(fit: Fit, tmp_path: Path) -> None:
    fit.save(tmp_path / "model.json")

    keys = set(json.loads((tmp_path / "model.json").read_text(encoding="utf-8")))

    assert keys == {
        *("format", "version", "armrig", "structure", "A", "B", "C", "D", "F", "nk"),
        *("integrator", "offset", "covariance", "covariance_robust", "noise_variance", "loss"),
        *("N", "Ts", "fit_percent", "whiteness", "whiteness_test", "converged", "starts"),
        *("agreed", "curvature", "free"),
        *("output", "unit", "input_unit", "source", "history", "digest"),
        *("findings", "treatment"),
    }


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": "other"}, "is no model"),
        ({"B": "x"}, "is a damaged model"),
        ({"A": None}, "is a damaged model"),
        ({"starts": [{}]}, "is a damaged model"),
    ],
)
def test_a_damaged_model_file_is_refused(
    fit: Fit, tmp_path: Path, change: dict[str, Any], said: str
) -> None:
    path = tmp_path / "model.json"
    fit.save(path)
    path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8")) | change))

    with pytest.raises(FileError, match=f"model.json .*{said}"):
        load_fit(path)


def test_a_file_that_is_cut_off_is_refused(fit: Fit, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    fit.save(path)
    text = path.read_text(encoding="utf-8")
    for content in (text[: len(text) // 2], "", "[]", "3", "\0"):
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


def test_free_responses_and_starts_are_loaded_unchanged(fit: Fit) -> None:
    changed = replace(
        fit,
        free=(
            FreeResponse(transients=(0.5, -1.5), level=2.5, offset=-3.5),
            FreeResponse(transients=(), level=float("nan"), offset=float("inf")),
        ),
        starts=(
            Start(name="IV", loss=float("inf"), iterations=7, converged=False),
            Start(name="ARX", loss=0.5, iterations=2, converged=True),
        ),
        agreed=False,
        converged=False,
        curvature=0.75,
        noise_variance=0.25,
        offset=True,
        fit_percent=-np.inf,
    )

    loaded = fit_of(model_text(changed), "m.json")

    assert loaded.free[0] == changed.free[0]
    assert np.isnan(loaded.free[1].level)
    assert loaded.free[1].offset == np.inf
    assert loaded.starts == changed.starts
    for name in ("agreed", "converged", "curvature", "noise_variance", "offset", "fit_percent"):
        assert getattr(loaded, name) == getattr(changed, name)


def test_a_saved_finding_keeps_all_its_fields(fit: Fit) -> None:
    """Numbers that are not finite, too."""
    findings = (
        warning("overlap", "first", start=1.5, stop=float("inf")),
        warning("reflected", "second", "order"),
    )

    text = model_text(replace(fit, findings=findings))

    assert fit_of(text, "m.json").findings == findings
    content = json.loads(text)
    assert [f["text"] for f in content["findings"]] == ["first", "second"]
    assert [f["asks"] for f in content["findings"]] == ["", "order"]
    assert content["findings"][0]["numbers"] == {"start": 1.5, "stop": "inf"}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('{"quality": []}', "model of several signals; here give a model of one output"),
        ('{"version": 1}', "is no model file"),
        ("[1]", "is no model file"),
        ('{"format": "armrig model", "version": 3, "armrig": "9.9"}', "version 3.* armrig 9.9"),
    ],
)
def test_a_file_that_is_not_a_model_is_refused_with_its_kind(content: str, said: str) -> None:
    with pytest.raises(FileError, match=f"m.json .*{said}"):
        fit_of(content, "m.json")


@pytest.mark.parametrize("name", ["covariance", "covariance_robust"])
def test_a_covariance_of_the_wrong_size_is_refused_as_damage(fit: Fit, name: str) -> None:
    content = json.loads(model_text(fit)) | {name: [[1.0, 0.0], [0.0, 1.0]]}

    with pytest.raises(FileError, match="damaged model: it has 6 parameters, and covariances of"):
        fit_of(json.dumps(content), "m.json")
