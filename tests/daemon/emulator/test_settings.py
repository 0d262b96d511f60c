"""The table [emulator]: accepted values, and the words of a refusal."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from armrig_core.errors import InputError
from armrig_daemon.emulator.settings import EmulatorSettings, load


def refusal(tmp_path: Path, text: str) -> str:
    """Return the refusal of `text` by `load`."""
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load(path)
    return str(caught.value)


def test_an_empty_table_is_the_demo(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("[rig]\nname = 'x'\n")

    settings = load(path)

    assert settings == EmulatorSettings()
    assert (settings.potentiometers, settings.adc_bits, settings.pwm_bits) == (True, 10, 10)
    assert settings.adc_noise_v > 0
    assert (settings.coulomb_nm, settings.stiffening) == (0.0, 0.0)


def test_keys_take_their_place(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("[emulator]\nadc_bits = 12\nseed = 9\n[emulator.arm]\nJ_2 = 0.005\n")

    settings = load(path)

    assert (settings.adc_bits, settings.seed) == (12, 9)
    assert settings.arm_parameters().J_2 == 0.005
    assert settings.arm_parameters().J_1 == 1.7e-3


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("seed", -1, "from 0"),
        ("boot_ms", -0.5, "from 0 to 10000"),
        ("baud", 300, "from 9600 to 4000000"),
        ("conversion_us", 3.0, "from 12 to 1000"),
        ("adc_noise_v", 0.6, "from 0 to 0.5"),
        ("clock_ppm", -501.0, "from -500 to 500"),
        ("clock_ppm", 500.5, "from -500 to 500"),
        ("coulomb_nm", -1.0, "from 0 to 10"),
        ("stiffening", -1.0, "from 0 to 1000"),
        ("theta_1_range_deg", 361.0, "from 180 to 360"),
        ("theta_1_zero_deg", 400.0, "from 0 to 360"),
        ("alpha_range_deg", 0.0, "from 10 to 3600"),
        ("alpha_zero_deg", -1.0, "from 0 to 3600"),
        ("pwm_bits", 7, "one of 0, 8"),
        ("adc_bits", 11, "one of 0, 10, 12"),
    ],
)
def test_a_value_out_of_range_is_refused(
    tmp_path: Path, key: str, value: float, allowed: str
) -> None:
    said = refusal(tmp_path, f"[emulator]\n{key} = {value}\n")

    assert "rig.toml: emulator: " in said
    assert f"{key}={value} must be {allowed}" in said


def test_a_wiper_beyond_its_track_is_refused(tmp_path: Path) -> None:
    said = refusal(tmp_path, "[emulator]\nalpha_range_deg = 90.0\nalpha_zero_deg = 91.0\n")

    assert "alpha_zero_deg=91.0 must be on the track, from 0 to alpha_range_deg=90.0" in said


def test_what_is_not_a_number_is_refused(tmp_path: Path) -> None:
    assert "adc_noise_v=nan must be from 0 to 0.5" in refusal(
        tmp_path, "[emulator]\nadc_noise_v = nan\n"
    )


def test_an_unknown_key_is_refused(tmp_path: Path) -> None:
    said = refusal(tmp_path, "[emulator]\nadc_bit = 10\n")

    assert "emulator.adc_bit = 10: no such key; allowed are seed, boot_ms" in said


def test_an_unknown_parameter_of_the_arm_is_refused(tmp_path: Path) -> None:
    said = refusal(tmp_path, "[emulator.arm]\nJ_3 = 1.0\n")

    assert "arm.J_3=1.0: no such key; allowed are J_1, J_2" in said


def test_an_impossible_parameter_of_the_arm_is_refused(tmp_path: Path) -> None:
    assert "arm.J_1=-1.0 must be finite and > 0" in refusal(
        tmp_path, "[emulator.arm]\nJ_1 = -1.0\n"
    )


def test_a_value_of_the_wrong_type_is_refused(tmp_path: Path) -> None:
    said = refusal(tmp_path, "[emulator]\nadc_bits = 'ten'\n")

    assert "emulator.adc_bits = 'ten': expected `int`, got `str`" in said


def test_a_file_that_is_no_toml_is_refused(tmp_path: Path) -> None:
    assert "rig.toml: " in refusal(tmp_path, "[emulator\n")
    with pytest.raises(InputError, match=r"absent\.toml"):
        load(tmp_path / "absent.toml")


def test_reading_settings_loads_no_scipy() -> None:
    """The daemon's loop reads them with its configuration, and knows nothing of the arm."""
    program = (
        "import sys; from armrig_daemon.emulator.settings import EmulatorSettings;"
        "EmulatorSettings(); sys.exit('scipy' in sys.modules)"
    )
    paths = os.pathsep.join(p for p in sys.path if p)

    done = subprocess.run(
        [sys.executable, "-c", program], env={**os.environ, "PYTHONPATH": paths}, check=False
    )

    assert done.returncode == 0
