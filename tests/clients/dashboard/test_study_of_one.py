"""Description of one recording for the page."""

from __future__ import annotations

from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig.dashboard import study_of_one
from armrig.dashboard.study_of_one import curves, facts, identified
from armrig.estimation.arx import arx
from armrig.recordings.files.loading import load
from armrig.validation.residuals import residuals

from tests.clients.made_recordings import note, recorded, sample, written


@pytest.mark.parametrize(("start", "k"), [(0.995, 100), (1.999, -1), (1e6, -1)])
def test_a_part_without_a_sample_shows_the_next_or_last_sample(
    three_recordings: tuple[Path, Path, Path], start: float, k: int
) -> None:
    path = three_recordings[0]
    recording = load(path)
    shown = curves(path, start, start + 0.001)

    assert shown["u"][0] == [pytest.approx(recording.t[k])]
    assert shown["u"][1] == shown["u"][2] == [pytest.approx(recording.u[k], abs=1e-4)]


def test_an_infinite_voltage_is_not_drawn(tmp_path: Path) -> None:
    """One value of the pair would be null in JSON, and the page needs both."""
    samples = [sample(k, u_applied_v=inf if k == 70 else 1.0) for k in range(5000)]

    _, least, largest = curves(written(tmp_path, recorded(samples)), None, None)["u"]

    assert {*least, *largest} == {1.0}


def test_the_notes_of_a_recording_are_listed(tmp_path: Path) -> None:
    notes = [note(k % 20, f"<b>{k}") for k in range(150)]
    path = written(tmp_path, recorded([*(sample(k) for k in range(40)), *notes]))

    found = facts(path)

    assert len(found["notes"]) == 100
    assert found["more_notes"] == 50
    assert found["notes"][5] == (pytest.approx(0.05, abs=1e-4), "Ada", "<b>5")


@pytest.mark.parametrize(
    ("output", "judged"),
    [
        ("theta_1", "the second half of the recording"),
        ("alpha", "the second half of the recording"),
        ("alpha", "validation.mcap"),
        ("theta_1,alpha", "validation.mcap"),
    ],
)
def test_a_model_is_validated_on_data_not_used_for_estimation(
    three_recordings: tuple[Path, Path, Path],
    monkeypatch: pytest.MonkeyPatch,
    output: Any,
    judged: str,
) -> None:
    """The search for the orders and the model's long texts are left out here."""
    seen: list[list[float]] = []
    outputs = output.split(",")
    integrating = ("theta_1",) if len(outputs) > 1 else output == "theta_1"

    class Quick:
        def __init__(self, *, orders: dict[str, int], nk: int, integrator: Any, **_: Any) -> None:
            assert (orders, nk, integrator) == ({"nb": 2, "nf": 3}, 4, integrating)

        def estimated(self, data: Any) -> Any:
            seen.append(np.ravel(data.u).tolist())
            return arx(data, na=4, nb=4, nk=1)

    def hints(data: Any) -> Any:
        seen.append(np.ravel(data.u).tolist())
        orders = {"nb": 2, "nf": 3, "nk": 4, "integrator": data.output == "theta_1"}
        form = "P1I" if orders["integrator"] else ""
        return SimpleNamespace(**orders, process=form, explain=lambda: "hints")

    def tested(fit: Any, data: Any) -> Any:
        seen.append(np.ravel(data.u).tolist())
        return residuals(fit, data)

    quick = {
        "structure_hints": hints,
        "residuals": tested,
        "Request": Quick,
        "advice": lambda _: SimpleNamespace(explain=lambda: "advice"),
        "_figures": lambda *_: [("Bode", "<svg/>")],
    }
    for name, does in quick.items():
        monkeypatch.setattr(study_of_one, name, does)
    _, path, validation = three_recordings

    is_alone, recording = judged != validation.name, load(path)
    u, half = recording.u.tolist(), recording.N // 2

    found = identified(path, None if is_alone else validation, output)

    texts = dict(found["texts"])
    estimated = u[:half] if is_alone else u
    validated = u[half:] if is_alone else load(validation).u.tolist()
    assert seen == [*[estimated] * len(outputs), estimated, validated]
    assert found["judged"] == judged
    assert [name for name in texts if "constants" in name] == (
        ["the same in time constants"] if output == "theta_1" else []
    )
    assert ("PROCESS(P1I)" in texts["comparison with validation data"]) == (output == "theta_1")
    assert "Simulated on the validation data it fits " in found["answer"]
    assert texts["residuals"].startswith("residuals on validation data")
    hinted = "hints" if len(outputs) == 1 else "theta_1:\nhints\nalpha:\nhints"
    assert [texts[name] for name in ("why these orders", "advice")] == [hinted, "advice"]
    assert found["figures"] == [("Bode", "<svg/>")]
    assert [*found["simulated"]] == outputs
    for name, (t, least, largest) in found["simulated"].items():
        assert least == largest
        np.testing.assert_allclose(t, recording.t, atol=1e-6)
        measured = np.degrees(getattr(recording, name))
        known = np.isfinite(measured) & [y is not None for y in least]
        error = np.array([y for y, is_known in zip(least, known, strict=True) if is_known])
        error -= measured[known]
        assert np.std(error) < 0.5 * np.std(measured[known])
