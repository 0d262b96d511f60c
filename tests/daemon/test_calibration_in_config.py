"""The calibration that the configuration names, and its content in a recording."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from armrig.recordings.files.container import read
from armrig_core.commands.codes import COMPLETE
from armrig_core.commands.commands import RunRequest
from armrig_core.errors import InputError
from armrig_core.recording_file.manifest import CALIBRATION_RAW
from armrig_core.rig.calibration import Calibration, Made, Potentiometer
from armrig_core.rig.calibration_file import raw_path, toml_of
from armrig_daemon.config import Config, load
from armrig_daemon.pipe import RunStarted, State
from armrig_daemon.service.runs import Runs

from tests.daemon.service.opened_run import open_run

SAMPLES = b"samples"
MADE = Made(
    date="2026-11-20T08:00:00+00:00",
    rig="1",
    device_uid="0001",
    armrig="0.1.0",
    raw_sha256=hashlib.sha256(SAMPLES).hexdigest(),
)
MEASURED = Calibration(theta_1=Potentiometer(zero_counts=1000.0), made=MADE)


def _calibration(folder: Path) -> Path:
    path = folder / "c.toml"
    path.write_text(toml_of(MEASURED))
    raw_path(path).write_bytes(SAMPLES)
    return path


def _config(folder: Path, text: str, name: str = "armrig.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_calibration_is_named_relative_to_the_file_that_names_it(tmp_path: Path) -> None:
    path = _calibration(tmp_path)

    found = load([_config(tmp_path, '[calibration]\nfile = "c.toml"')], {}, {}).calibration

    assert found.theta_1.zero_counts == 1000.0
    assert found.made.file == str(path)


def test_environment_may_name_the_calibration(tmp_path: Path) -> None:
    below = _config(tmp_path, "[calibration.alpha]\nzero_counts = 5.0")

    variable = {"ARMRIG_CALIBRATION_FILE": str(_calibration(tmp_path))}
    found = load([below], variable, {}).calibration

    assert found.theta_1.zero_counts == 1000.0
    assert found.alpha.zero_counts == 32768.0


def test_a_value_that_overrides_a_calibration_is_not_measured(tmp_path: Path) -> None:
    """Its sentence of origin is removed."""
    _calibration(tmp_path)
    below = _config(tmp_path, '[calibration]\nfile = "c.toml"')
    above = _config(tmp_path, "[calibration.alpha]\nzero_counts = 5.0", "user.toml")

    found = load([below, above], {}, {}).calibration

    assert (found.theta_1.zero_counts, found.alpha.zero_counts) == (1000.0, 5.0)
    assert found.made is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[calibration]\nfile = "nowhere.toml"', r"nowhere\.toml: No such file"),
        ("[calibration]\nfile = 1", "calibration.file = 1: must be the path"),
        (
            '[calibration]\nfile = "c.toml"\n[calibration.alpha]\nzero_counts = 1.0',
            "calibration.alpha and calibration.file are given: give one",
        ),
        ('[calibration]\nfile = "bad.toml"', r"bad\.toml: calibration.beta = {}: no such key"),
    ],
)
def test_a_calibration_that_cannot_be_used_is_refused(text: str, said: str, tmp_path: Path) -> None:
    _calibration(tmp_path)
    _config(tmp_path, "[beta]", "bad.toml")

    with pytest.raises(InputError, match=said):
        load([_config(tmp_path, text)], {}, {})


def test_every_recording_carries_the_samples_of_its_calibration(tmp_path: Path) -> None:
    _calibration(tmp_path)
    config = load([_config(tmp_path, '[calibration]\nfile = "c.toml"')], {}, {})

    assert _attached(tmp_path, config) == SAMPLES
    assert _attached(tmp_path, Config()) is None


def _attached(folder: Path, config: Config) -> bytes | None:
    runs = Runs(config, folder, lambda: None)
    order, _ = open_run(runs, RunRequest(lease="a" * 32, n=1, u=[0.0]), 0.01)
    started = RunStarted(t_host_ns=0, run_id=order.run_id, k_first=0, count=1)
    state = State(t_host_ns=0, phase="active", reason="", owner="", ts_us=10_000, device={})
    path = runs.begin(started, state, {}, 0)
    runs.end(COMPLETE)
    assert runs.completion_line(30)[0] == "info"
    content = read(path.with_suffix("")) or read(path)
    return content.attachments.get(CALIBRATION_RAW)


@pytest.mark.parametrize(
    ("calibration", "sentence"),
    [
        (Calibration(), "none: the default values; `armrig calibrate` measures a calibration"),
        (
            Calibration(theta_1=Potentiometer(zero_counts=1.0)),
            "given in the configuration, not measured",
        ),
        (
            Calibration(made=Made(date="2026-11-20", rig="1", device_uid="7", armrig="0.2.0")),
            "given in the configuration, made 2026-11-20",
        ),
        (
            Calibration(
                made=Made(
                    date="2026-11-21", rig="1", device_uid="7", armrig="0.2.0", file="/c.toml"
                )
            ),
            "/c.toml, made 2026-11-21",
        ),
    ],
)
def test_the_configuration_reports_the_origin_of_a_calibration(
    calibration: Calibration, sentence: str
) -> None:
    assert Config(calibration=calibration).calibration_sentence == sentence
