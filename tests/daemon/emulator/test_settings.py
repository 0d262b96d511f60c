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


def test_an_empty_table_gives_the_settings_of_the_demo(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("[rig]\nid = 'x'\n")

    settings, described = load(path)

    assert (settings, described) == (EmulatorSettings(), None)
    assert (settings.potentiometers, settings.adc_bits, settings.pwm_bits) == (True, 10, 10)
    assert settings.adc_noise_v > 0
    assert (settings.coulomb_nm, settings.stiffening) == (0.0, 0.0)


def test_settings_of_the_file_replace_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    text = "[rig]\nfile = 'led.toml'\n[emulator]\nadc_bits = 12\nseed = 9\narm.J_2 = 0.005\n"
    path.write_text(text)

    settings, described = load(path)

    assert (described, settings.adc_bits, settings.seed) == (tmp_path / "led.toml", 12, 9)
    assert settings.arm_parameters().J_2 == 0.005
    assert settings.arm_parameters().J_1 == 1.7e-3


@pytest.mark.parametrize(
    ("text", "refused"),
    [
        ("[emulator]\nclock_ppm = -501.0", "emulator.clock_ppm = -501.0: expected `float` >= -500"),
        ("[emulator]\nadc_noise_v = nan", "adc_noise_v = nan: expected `float` >= 0.0"),
        ("[emulator]\npwm_bits = 7", "pwm_bits = 7: allowed are 0, 8"),
        ("[emulator]\nadc_bits = 11", "adc_bits = 11: allowed are 0, 10, 12"),
        ("[emulator]\nadc_bits = 'ten'", "emulator.adc_bits = 'ten': allowed are 0, 10, 12"),
        ("[emulator]\nadc_bit = 10", "emulator.adc_bit = 10: no such key; allowed are seed, boot"),
        ("[emulator.arm]\nJ_3 = 1.0", "arm.J_3=1.0: no such key; allowed are J_1, J_2"),
        ("[emulator.arm]\nJ_1 = -1.0", "arm.J_1=-1.0 must be finite and > 0"),
        (
            "[emulator]\nalpha_range_deg = 90.0\nalpha_zero_deg = 91.0",
            "alpha_zero_deg=91.0 must be on the track, from 0 to alpha_range_deg=90.0",
        ),
    ],
)
def test_a_value_that_is_not_allowed_is_refused(tmp_path: Path, text: str, refused: str) -> None:
    said = refusal(tmp_path, text)

    assert said.startswith(str(tmp_path / "rig.toml"))
    assert refused in said


def test_a_file_that_is_not_toml_is_refused(tmp_path: Path) -> None:
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
