"""A calibration's TOML with its samples."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from armrig_core.errors import FileError
from armrig_core.rig.calibration import Calibration, Driver, Made, MeasuredValue, Potentiometer
from armrig_core.rig.calibration_file import (
    RAW_LIMIT,
    check_measured,
    raw_path,
    raw_samples,
    read_calibration,
    toml_of,
)
from msgspec.structs import replace

SAMPLES = b"samples"
MADE = Made(
    date="2026-11-20T08:00:00.123+01:00",
    rig="1",
    device_uid='a "uid"\\',
    armrig="0.1.0",
    figures={"theta_1_rad_per_count": MeasuredValue(value=-9.4e-5, std=1.5e-9)},
    recordings={"rest": "ab" * 32, "turns": "cd" * 32},
    raw_sha256=hashlib.sha256(SAMPLES).hexdigest(),
)
MEASURED = Calibration(
    theta_1=Potentiometer(zero_counts=1 / 3, rad_per_count=-9.4e-5),
    alpha=Potentiometer(zero_counts=32768.5, wraps=False),
    driver=Driver(gain=0.98, offset_v=-0.02),
    made=MADE,
)
OF_NO_DEVICE = replace(MEASURED, made=replace(MADE, device_uid="", figures={}))


def _written(folder: Path, calibration: Calibration = MEASURED) -> Path:
    path = folder / "calibration.toml"
    path.write_text(toml_of(calibration), encoding="utf-8")
    raw_path(path).write_bytes(SAMPLES)
    return path


@pytest.mark.parametrize("calibration", [MEASURED, OF_NO_DEVICE, Calibration()])
def test_a_calibration_file_is_read_back_exactly(calibration: Calibration, tmp_path: Path) -> None:
    path = _written(tmp_path, calibration)

    found = read_calibration(path)

    if calibration.made is not None:
        assert found.made is not None
        assert found.made.file == str(path)
        assert raw_samples(found) == SAMPLES
        found = replace(found, made=replace(found.made, file=""))
    assert found == calibration


@pytest.mark.parametrize(
    ("samples", "said"),
    [
        (None, "No such file"),
        (b"others", "not the samples from which calibration.toml was estimated"),
        (bytes(RAW_LIMIT + 1), "more than the 1048576 B allowed"),
    ],
)
def test_missing_or_changed_samples_of_a_calibration_are_refused(
    samples: bytes | None, said: str, tmp_path: Path
) -> None:
    path = _written(tmp_path)
    if samples is None:
        raw_path(path).unlink()
    else:
        raw_path(path).write_bytes(samples)

    with pytest.raises(FileError, match=said) as refused:
        read_calibration(path)
    assert "calibration.csv.gz" in str(refused.value)
    assert "calibrate" in str(refused.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[theta_1", "not a TOML file"),
        ("[theta_1]\nrad_per_count = 0.0", "rad_per_count=0.0 must be from 1e-08 to 0.1"),
        ("[theta_1]\nrad_per_count = inf", "rad_per_count=inf must be from 1e-08 to 0.1"),
        ("[theta_1]\nrad_per_count = -1e308", r"rad_per_count=-1e\+308 must be from 1e-08 to 0.1"),
        ("[theta_1]\nrad_per_count = 1e-308", "rad_per_count=1e-308 must be from 1e-08 to 0.1"),
        ("[alpha]\nzero_counts = 1e308", r"zero_counts=1e\+308 must be from -655360 to 655360"),
        ("[alpha]\nzero_counts = nan", "zero_counts=nan must be from -655360 to 655360"),
        ("[driver]\ngain = -1.0", "gain=-1.0 must be from 0.1 to 10"),
        ("[driver]\noffset_v = nan", "offset_v=nan must be from -5 to 5"),
        ("[beta]", "unknown field `beta`"),
    ],
)
def test_a_calibration_file_out_of_range_is_refused(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text(text)

    with pytest.raises(FileError, match=said) as refused:
        read_calibration(path)
    assert str(path) in str(refused.value)


TOO_MANY = {f"figure_{n}": MeasuredValue(value=1.0, std=0.1) for n in range(500)}


@pytest.mark.parametrize(
    ("calibration", "raw", "said"),
    [
        (replace(MEASURED, made=None), SAMPLES, "does not say how it was made"),
        (replace(MEASURED, made=replace(MADE, figures=TOO_MANY)), SAMPLES, "more than 16384 B"),
        (MEASURED, bytes(RAW_LIMIT + 1), "1048577 B; at most 1048576 B are allowed"),
        (MEASURED, b"", "not the samples from which it was estimated"),
        (
            replace(MEASURED, made=replace(MADE, raw_sha256="")),
            SAMPLES,
            "not the samples from which it was",
        ),
    ],
)
def test_a_calibration_sent_by_command_has_the_limits_of_a_file(
    calibration: Calibration, raw: bytes, said: str
) -> None:
    with pytest.raises(FileError, match=said) as refused:
        check_measured(calibration, raw)
    assert "`armrig calibrate`" in str(refused.value)


def test_a_measured_calibration_contains_its_origin() -> None:
    alone = replace(MADE, raw_sha256="")

    assert check_measured(MEASURED, SAMPLES) == MADE
    assert check_measured(replace(MEASURED, made=alone), b"") == alone
