"""Files of earlier releases are read, verified and decided again to the last bit."""

from __future__ import annotations

import json
from hashlib import sha256
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.cli.replay import replay
from armrig.recordings.calibration import decompressed, estimate
from armrig.recordings.container import read
from armrig.recordings.verification import verify
from armrig_core.calibration_file import raw_path, read_calibration
from armrig_core.codes import GapCode, OutcomeCode
from armrig_core.errors import FileError
from armrig_core.manifest import CALIBRATION_RAW
from armrig_core.volts import applied_code, volts_of
from msgspec.structs import replace

from tests.data.files_of_today import PACINGS, answers, facts

DATA = Path(__file__).parents[1] / "data"
RELEASES = sorted(path.name for path in DATA.iterdir() if (path / "facts.json").exists())
FOLDERS = pytest.mark.parametrize("folder", [DATA / r for r in RELEASES], ids=RELEASES)
SHA256 = {
    "0.1.0": {
        "bj.json": "5501009b5b40b56986e6f6282e1c1a6a7806ff31fd2326da9eba3e939a19cef5",
        "calibration.csv.gz": "a54d7d6ffccf885b9f25f629d57b3861afacec1dedf4af1e126980d66a650f1d",
        "calibration.toml": "e833f6a35dd49cbf517f1af3945a1c0e613308e25c7d968b7128b3e027278d21",
        "exchange.mcap": "70dd089abbf040b2096a08a3ce5ac8af5bb13d0a2d13ab465cabd7ecf68937ec",
        "facts.json": "ca7e2bc6932b0d5a2396b1addb42624dd76e3afbc6c4687dcabdd746b0a08773",
        "n4sid.json": "49d14bd3109c00114c4c1fdc0a7d2746d96ecf08af4c9907d8dc15f963cbe3ae",
        "scheduled.mcap": "50fed6e26e695791af96f3e904694350b0c32c9959fabffd900d165cd20298a8",
    }
}
MODELS = ("bj", "n4sid")
METER_V = volts_of(applied_code(32768, 10))
"""Voltage that a device of 10 bits makes of the one measured code."""


def _facts(folder: Path) -> dict[str, Any]:
    told: dict[str, Any] = json.loads((folder / "facts.json").read_text())
    return told


@FOLDERS
@pytest.mark.parametrize("pacing", PACINGS)
def test_a_recording_is_read_to_the_last_bit(folder: Path, pacing: str) -> None:
    """Samples, gaps, events, times and angles, as the release of the file read them."""
    recording = armrig.load(folder / f"{pacing}.mcap")

    assert facts(recording) == _facts(folder)[pacing]
    assert not recording.truncated
    assert recording.missing == sum(gap.count for gap in recording.gaps) > 0
    assert recording.outcome is not None
    assert recording.outcome.outcome == "complete"
    assert recording.outcome.code == OutcomeCode.COMPLETE  # which it does not say
    assert {gap.code for gap in recording.gaps} == {GapCode.FRAME_LOST}  # nor this


@FOLDERS
def test_no_file_of_a_release_has_changed(folder: Path) -> None:
    found = {path.name: sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}

    assert found == SHA256[folder.name]


@FOLDERS
@pytest.mark.parametrize("pacing", PACINGS)
def test_a_recording_is_verified(folder: Path, pacing: str) -> None:
    checks = {check.about: check for check in verify(folder / f"{pacing}.mcap").checks}

    assert {check.result for check in checks.values()} == {"passed"}, checks
    assert {"file", "samples", "envelope", "input", "timing", "configuration", "clock"} == {*checks}


@FOLDERS
@pytest.mark.parametrize("pacing", PACINGS)
def test_a_recording_is_decided_again_to_the_last_bit(folder: Path, pacing: str) -> None:
    """Every frame to the device and every sample in the file, through lost frames, too."""
    path = folder / f"{pacing}.mcap"

    found = replay(path)

    assert (found.difference, found.until) == ("", "")
    assert found.samples == armrig.load(path).samples.size
    assert found.frames > (40 if pacing == "scheduled" else 140)


@FOLDERS
def test_a_calibration_is_read_and_found_again_in_its_samples(folder: Path) -> None:
    path = folder / "calibration.toml"

    calibration = read_calibration(path)

    assert calibration.made is not None
    samples = decompressed(raw_path(path).read_bytes())
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
def test_a_recording_carries_its_calibration(folder: Path, pacing: str) -> None:
    path = folder / "calibration.toml"
    content = read(folder / f"{pacing}.mcap")
    assert content is not None

    carried = armrig.load(folder / f"{pacing}.mcap").calibration

    assert carried is not None
    assert carried.made is not None
    here = replace(carried, made=replace(carried.made, file=str(path)))
    assert here == read_calibration(path)
    assert content.attachments[CALIBRATION_RAW] == raw_path(path).read_bytes()


@FOLDERS
@pytest.mark.parametrize("name", MODELS)
def test_a_model_is_read_and_says_what_it_said(folder: Path, name: str, tmp_path: Path) -> None:
    path = folder / f"{name}.json"
    data = armrig.load(folder / "scheduled.mcap").dataset(output="alpha")

    fit = armrig.load_fit(path)

    told, said = _facts(folder)[name], answers(fit, data)
    for key in ("poles", "predicted"):
        np.testing.assert_allclose(said[key], told[key], rtol=1e-9, atol=1e-12)
    assert fit.source == _facts(folder)["scheduled"]["sha256"]
    assert fit.digest == data.digest
    fit.save(tmp_path / "again.json")
    again = json.loads((tmp_path / "again.json").read_text())
    first = json.loads(path.read_text())
    unknown = {"about": "", "asks": "", "level": "warning", "numbers": {}}
    newer = {"whiteness_test": "", "curvature": 0.0, "treatment": []}  # 0.1.0 wrote none of these
    newer["findings"] = [unknown] * len(first["warnings"])
    assert {**again, "armrig": ""} == {**newer, **first, "armrig": ""}
