"""Files of releases are read, verified and replayed to the last bit."""

from __future__ import annotations

import json
from hashlib import sha256
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.models.model_writing import model_text
from armrig.physics.calibration import estimate
from armrig.recordings.files.container import read
from armrig.recordings.files.replay import replay
from armrig.recordings.files.verification import verify
from armrig_core.commands.codes import GapCode, OutcomeCode
from armrig_core.errors import FileError
from armrig_core.recording_file.manifest import CALIBRATION_RAW
from armrig_core.rig.calibration_file import raw_path, read_calibration
from armrig_core.rig.volts import device_code, volts_of
from msgspec.structs import replace

from tests.clients.made_turns import stored_readings
from tests.data.files_of_today import PACINGS, answers, facts

DATA = Path(__file__).parents[1] / "data"
RELEASES = sorted(path.name for path in DATA.iterdir() if (path / "facts.json").exists())
FOLDERS = pytest.mark.parametrize("folder", [DATA / r for r in RELEASES], ids=RELEASES)
SHA256 = {"0.2.0": "d86e145ae184bc65dab6057eb4f821d5d7cac99a3e260542f810ca894f8b1746"}
"""Hash of the names and the contents of a release's files."""
MODELS = sorted(path.stem for path in (DATA / "0.2.0").glob("*.json") if path.stem != "facts")
MOVED = ("nk", "integrator", "output", "unit", "input_unit", "noise_variance", "loss", "N")
MOVED += ("fit_percent", "whiteness", "whiteness_test")
"""Keys at the top of a file of version 1 that are parts of other values today."""
METER_V = volts_of(device_code(32768, 10))
"""Voltage that a device of 10 bits makes of the one measured code."""


def _facts(folder: Path) -> dict[str, Any]:
    stored: dict[str, Any] = json.loads((folder / "facts.json").read_text())
    return stored


@FOLDERS
@pytest.mark.parametrize("pacing", PACINGS)
def test_a_recording_of_a_release_has_the_stored_content(folder: Path, pacing: str) -> None:
    """Samples, gaps, events, times and angles, as the release of the file read them."""
    recording = armrig.load(folder / f"{pacing}.mcap")

    assert facts(recording) == _facts(folder)[pacing]
    assert not recording.truncated
    assert recording.missing == sum(gap.count for gap in recording.gaps) > 0
    assert recording.outcome is not None
    assert recording.outcome.outcome == "complete"
    assert recording.outcome.code == OutcomeCode.COMPLETE
    assert {gap.code for gap in recording.gaps} == {GapCode.FRAME_LOST}


@FOLDERS
def test_no_file_of_a_release_has_changed(folder: Path) -> None:
    files = b"".join(p.name.encode() + p.read_bytes() for p in sorted(folder.iterdir()))

    assert sha256(files).hexdigest() == SHA256[folder.name]


@FOLDERS
@pytest.mark.parametrize("pacing", PACINGS)
def test_a_recording_of_a_release_passes_all_checks(folder: Path, pacing: str) -> None:
    checks = {check.about: check for check in verify(folder / f"{pacing}.mcap").checks}

    attachments = checks.pop("attachments")  # release 0.2.0 wrote two hashes only
    assert attachments.level == ("warning" if folder.name == "0.2.0" else "good")
    assert {check.level for check in checks.values()} == {"good"}, checks
    assert {"file", "samples", "envelope", "input", "timing", "configuration", "clock"} == {*checks}


@FOLDERS
@pytest.mark.parametrize("pacing", PACINGS)
def test_a_replay_of_a_recording_makes_the_same_decisions(folder: Path, pacing: str) -> None:
    """Every frame to the device and every sample in the file, through lost frames, too."""
    path = folder / f"{pacing}.mcap"

    found = replay(path)

    assert (found.difference, found.until) == ("", "")
    assert found.samples == armrig.load(path).samples.size
    assert found.frames > (40 if pacing == "scheduled" else 140)


@FOLDERS
def test_a_calibration_is_estimated_again_from_its_samples(folder: Path) -> None:
    path = folder / "calibration.toml"

    calibration = read_calibration(path)

    assert calibration.made is not None
    samples = stored_readings(raw_path(path).read_bytes())
    found = estimate(**samples, meter=[(METER_V, 2.5)]).figures()
    assert found.keys() == calibration.made.figures.keys()
    for name, figure in calibration.made.figures.items():
        assert found[name].value == pytest.approx(figure.value, rel=1e-9), name
        assert found[name].std == pytest.approx(figure.std, rel=1e-6), name


@FOLDERS
def test_a_calibration_with_other_samples_is_refused(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    path.write_bytes((folder / path.name).read_bytes())
    samples = bytearray(raw_path(folder / path.name).read_bytes())
    samples[-1] ^= 1
    raw_path(path).write_bytes(samples)

    with pytest.raises(FileError):
        read_calibration(path)


@FOLDERS
@pytest.mark.parametrize("pacing", PACINGS)
def test_a_recording_contains_its_calibration(folder: Path, pacing: str) -> None:
    path = folder / "calibration.toml"
    content = read(folder / f"{pacing}.mcap")
    assert content is not None

    carried = armrig.load(folder / f"{pacing}.mcap").calibration

    assert carried is not None
    assert carried.made is not None
    here = replace(carried, made=replace(carried.made, file=str(path)))
    assert here == read_calibration(path)
    assert content.attachments[CALIBRATION_RAW] == raw_path(path).read_bytes()


LAST_BEFORE_THE_GAP = {
    "ararx": [-0.17921556568512947],
    "armax": [-0.1978313386642119],
    "arx_of_two": [1.6914740969450552, 0.14914257970785139],
    "bj": [-0.1812242735764473],
    "n4sid": [-0.18597638665435903],
    "pem": [-0.18785575183545508],
    "ss_of_two": [1.7036901976439363, 0.12222284889061903],
}
"""Prediction of the last alpha before the first missing one, by models with C or D.

A Kalman filter predicts after a gap today, so that the stored predictions after it are not today's.
"""


@FOLDERS
@pytest.mark.parametrize("name", MODELS)
def test_a_model_gives_the_stored_answers_and_is_saved_with_the_same_numbers(
    folder: Path, name: str, tmp_path: Path
) -> None:
    path = folder / f"{name}.json"
    recording = armrig.load(folder / "scheduled.mcap")

    fit = armrig.load_fit(path)

    stored, found = _facts(folder)[name], answers(fit, recording)
    np.testing.assert_allclose(found["poles"], stored["poles"], rtol=1e-9, atol=1e-12)
    if name in LAST_BEFORE_THE_GAP:
        data = recording.signals(fit.outputs)
        last = fit.predict(data[: int(np.argmin(data.valid.all(axis=1)))])[-1]
        np.testing.assert_allclose(np.atleast_1d(last), LAST_BEFORE_THE_GAP[name], rtol=1e-9)
    else:
        np.testing.assert_allclose(found["predicted"], stored["predicted"], rtol=1e-9, atol=1e-12)
    assert fit.source == _facts(folder)["scheduled"]["sha256"]
    fit.save(tmp_path / "again.json")
    again, old = (json.loads(p.read_text()) for p in (tmp_path / "again.json", path))
    old["findings"] = [f | {"remedy": f.pop("asks")} for f in old["findings"]]
    same = again.keys() & old.keys() - {"armrig", "format", "version", "quality"}
    assert {key: again[key] for key in same} == {key: old[key] for key in same}
    if fit.ny == 1:
        moved = {*old} - {*again}
        assert moved == {*"ABCDF", *MOVED}
        for key in moved:
            np.testing.assert_array_equal(getattr(fit, key), old[key], key)
    else:
        assert {*old} - {*again} == {"orders"}
        assert fit.specification == old["orders"]
        for q, known in zip(fit.quality, old["quality"], strict=True):
            values = {"loss": q.loss, "N": q.N, "fit_percent": q.fit_percent}
            white = {"whiteness": q.white.p_value, "whiteness_test": q.white.test}
            assert values | white == known
    assert model_text(armrig.load_fit(tmp_path / "again.json")) == model_text(fit)
