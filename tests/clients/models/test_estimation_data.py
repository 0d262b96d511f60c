"""Findings about models that are compared with data which they were estimated from."""

from __future__ import annotations

from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig.data.dataset import Dataset, Signals
from armrig.data.finding import Finding
from armrig.models.fit import Fit


def dataset(source: str = "a") -> Dataset:
    """Return 400 samples of a first-order system at 10 Hz."""
    rng = np.random.default_rng(1)
    u = rng.standard_normal(400)
    y = np.zeros(400)
    for k in range(1, 400):
        y[k] = 0.8 * y[k - 1] + u[k - 1] + 0.1 * rng.standard_normal()
    return Dataset(u=u, y=y, Ts=0.1, source=source)


def signals() -> Signals:
    data = dataset()
    y = np.column_stack([data.y, data.y + np.roll(data.y, 1)])
    return Signals(u=data.u[:, None], y=y, Ts=data.Ts, source=data.source)


def found(data: Dataset, fit: Fit) -> list[Finding]:
    """Return the findings of a comparison; the residual tests have the same overlaps."""
    table, tests = armrig.compare(data, fit), armrig.residuals(fit, data)
    assert tests.findings == tuple(f for f in table.findings if f.about == "overlap")
    return list(table.findings)


def test_an_overlap_has_a_code_and_its_times() -> None:
    data = dataset()
    fit = armrig.arx(data[:200], na=1, nb=1)

    [finding] = found(data[150:], fit)

    assert (finding.about, finding.level) == ("overlap", "warning")
    assert finding.numbers == pytest.approx({"start": 15.0, "stop": 20.0})
    assert "15 to 20 s of the same file" in finding.text
    assert finding.text in repr(armrig.residuals(fit, data[150:]))
    assert found(data[200:], fit) == []


def test_the_times_of_a_part_of_a_part_refer_to_the_file() -> None:
    data = dataset()
    fit = armrig.arx(data[100:][50:200], na=1, nb=1)

    [finding] = found(data[120:][60:], fit)

    assert finding.numbers == pytest.approx({"start": 18.0, "stop": 30.0})
    assert found(data[:150], fit) == []


def test_a_treatment_does_not_hide_the_overlap() -> None:
    data = dataset()
    fit = armrig.arx(data, na=1, nb=1)

    for part, times in ((data[100:300], (10.0, 30.0)), (data, (0.0, 40.0))):
        [finding] = found(armrig.detrend(part), fit)

        assert finding.numbers == pytest.approx(dict(zip(("start", "stop"), times, strict=True)))


def test_models_of_identical_and_overlapping_data_have_separate_findings() -> None:
    """Each overlap has its model's name and its own times; the end is that of the shorter."""
    data = dataset()
    own, first, last = (armrig.arx(part, na=1, nb=1) for part in (data, data[:50], data[390:]))

    for labels, models in (("abc", (own, first, last)), ("cba", (last, first, own))):
        findings = armrig.compare(data, *models, labels=tuple(labels)).findings

        assert [f.about for f in findings] == ["own data", "overlap", "overlap"]
        times = {f.text[0]: (f.numbers["start"], f.numbers["stop"]) for f in findings[1:]}
        names = dict(zip(models, labels, strict=True))
        assert times[names[first]] == pytest.approx((0.0, 5.0))
        assert times[names[last]] == pytest.approx((39.0, 40.0))
    inner = armrig.compare(data[100:200], own, labels=("a",)).findings
    assert [(f.numbers["start"], f.numbers["stop"]) for f in inner] == [pytest.approx((10.0, 20.0))]


def test_data_of_another_file_or_of_merged_parts_have_no_finding() -> None:
    data = dataset()
    fit = armrig.arx(armrig.merge([data[:100], data[300:]]), na=1, nb=1)

    assert found(data[100:300], fit) == []
    assert found(dataset(source="b"), armrig.arx(data[:200], na=1, nb=1)) == []
    assert found(dataset(source=""), armrig.arx(dataset(source="")[:200], na=1, nb=1)) == []


def test_several_signals_have_the_same_findings(tmp_path: Path) -> None:
    data = signals()
    armrig.arx(data[:200], na=[[1, 0], [0, 1]], nb=1).save(tmp_path / "m.json")
    fit = armrig.load_fit(tmp_path / "m.json")

    assert isinstance(fit, Fit)
    for part, times in ((data[150:], [15.0, 20.0]), (data[200:], [])):
        table, tests = armrig.compare(part, fit), armrig.residuals(fit, part)
        numbers = [x for f in table.findings for x in f.numbers.values()]
        assert numbers == pytest.approx(times)
        assert tests.findings == table.findings
