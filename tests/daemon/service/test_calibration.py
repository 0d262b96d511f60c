"""A calibration that a client sends is of this rig and this device, or it is refused."""

from __future__ import annotations

import hashlib
from typing import Any

import pytest
from armrig_core.rig.calibration import Calibration, Made, Potentiometer
from armrig_core.rig.description import builtin
from armrig_daemon.config import Config, RigIdentity
from armrig_daemon.service.calibration import check_calibration
from msgspec.structs import replace

RAW = b"samples"
MADE = Made(
    date="2026-11-20T08:00:00+01:00",
    rig="2",
    device_uid="abc",
    armrig="0.2.0",
    raw_sha256=hashlib.sha256(RAW).hexdigest(),
    file="/home/a/calibration-2.toml",
)
SENT = Calibration(
    theta_1=Potentiometer(zero_counts=7.5, rad_per_count=-9e-5),
    alpha=Potentiometer(wraps=False),
    made=MADE,
)
CONFIG, ARM = Config(rig=RigIdentity(id="2")), builtin("arm")


def test_an_accepted_calibration_is_unchanged_except_for_its_file() -> None:
    found = check_calibration(SENT, RAW, CONFIG, {"uid": "abc"}, ARM)

    assert found == replace(SENT, made=replace(MADE, file=""))
    assert check_calibration(SENT, RAW, CONFIG, {}, ARM) == found


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"made": replace(MADE, raw_sha256="0" * 64)}, "samples next to it are not the samples"),
        ({"made": replace(MADE, rig="1")}, "of rig 1, device abc, and this is rig 2, device abc"),
        ({"made": replace(MADE, device_uid="d")}, "of rig 2, device d, and this is rig 2, dev"),
        ({"made": replace(MADE, date="\x1b[2J")}, r"made.date: at most 80 printable characters"),
        ({"made": replace(MADE, date="2" * 81)}, r"made.date: at most 80 printable characters"),
        ({"theta_1": Potentiometer(wraps=False)}, "theta_1.wraps = false: must be true"),
        ({"alpha": Potentiometer(wraps=True)}, "alpha.wraps = true: must be false"),
    ],
)
def test_a_calibration_of_another_rig_or_device_is_refused(
    fields: dict[str, Any], said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        check_calibration(replace(SENT, **fields), RAW, CONFIG, {"uid": "abc"}, ARM)


def test_a_heater_is_not_calibrated_as_an_arm() -> None:
    with pytest.raises(ValueError, match=r"'heater'.*give zero_counts and per_count in the rig's"):
        check_calibration(SENT, RAW, CONFIG, {"uid": "abc"}, builtin("heater"))
