"""The configuration is checked key by key, and layered."""

from __future__ import annotations

import os
from dataclasses import replace
from math import tau
from pathlib import Path

import numpy as np
import pytest
from armrig_core.errors import InputError
from armrig_core.rig.arm import ArmParameters
from armrig_core.rig.calibration import Calibration, Potentiometer
from armrig_core.rig.description import builtin
from armrig_core.rig.volts import code_of
from armrig_daemon.config import (
    ArmSettings,
    Config,
    Limits,
    description_of,
    load,
    load_installed,
)
from armrig_daemon.decisions.state import Rules


def _load(tmp_path: Path, text: str, environ: dict[str, str] | None = None) -> Config:
    path = tmp_path / "armrig.toml"
    path.write_text(text)
    return load([path], environ or {}, {})


def test_an_empty_file_is_the_default(tmp_path: Path) -> None:
    assert _load(tmp_path, "") == Config()


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[timing]\nTz = 1", r"timing\.Tz = 1: no such key; allowed are Ts, priority"),
        ("[timng]\nTs = 1", r"timng = .*: no such key; allowed are rig, device"),
        ("[timing]\nTs = '10 ms'", r"timing\.Ts = '10 ms': expected `float`, got `str`"),
        ("[timing]\nTs = 0.0100001", r"Ts = 0.0100001 must be a whole number of microseconds"),
        (
            "[timing]\nTs = 0.001",
            r"Ts=0.001 s cannot be carried at 500000 baud",
        ),
        ("[limits]\nu_max_v = 6", r"limits\.u_max_v = 6: expected `float` <= 5"),
        ("[limits]\nu_max_v = nan", r"limits\.u_max_v = nan"),
        ("[limits]\nu_min_v = 4\nu_max_v = 3", r"limits: u_min_v = 4.0 must not be above"),
        ("[limits]\nu_min_v = 4\nu_min_v = 3", r"line 3: u_min_v = 3: given twice; .* once"),
        ("[limits]\nu_min_v = 4\n[rig]\n[limits]\n", r"line 4: \[limits\]: given twice"),
        ("limits = {u_min_v = 4, u_min_v = 3}", r"line 1: .*u_min_v = 3}: given twice"),
        ("[limits]\nu_min_v 4", "not a TOML file"),
        ("[limits]\nrevolutions = 0.004", r"revolutions = 0\.004 must be a whole number of hund"),
        ("[limits]\nalpha_rad = true", r"limits\.alpha_rad = True: expected `float`, got `bool`"),
        ("[device]\noversampling = 0", r"device\.oversampling = 0: expected `int` >= 1"),
        ("[device]\noversampling = 256", r"device\.oversampling = 256: expected `int` <= 255"),
        ("[device]\nrail_ticks = -1", r"device\.rail_ticks = -1: expected `int` >= 0"),
        ("[device]\nrail_ticks = 65536", r"device\.rail_ticks = 65536: expected `int` <= 65535"),
        (
            "[timing]\nTs = 0.004\n[device]\noversampling = 16",
            r"exchange mode with \[device\] oversampling = 16: at least 0\.004368 s, or a higher "
            "baud rate, or less oversampling$",
        ),
        (
            "[device]\nport = '/dev/tty\x9b'",
            r"device: port = '/dev/tty\\x9b' must have only print",
        ),
        ('[device]\nport = "\\u001b[2J"', r"device: port = '\\x1b\[2J' must have only printable"),
        (
            f"[device]\nport = 'unix:/{'a' * 107}'",
            r"device: unix:/a+: the path has 108 B; .* 1 to 107 B; choose a shorter folder",
        ),
        (
            "[device]\nport = 'unix:'",
            r"device: unix:: the path has 0 B; .*; name a socket in your own folder",
        ),
        ("[rig]\nid = '../1'", r"rig id '\.\./1': use 1 to 40 characters, each a-z, 0-9 or -"),
        ("[emulator]\nbaud = 1", r"emulator.baud = 1: expected `int` >= 9600"),
        ("[calibration.theta_1]\nrad_per_count = 0.0", r"calibration\.theta_1: rad_per_count=0\.0"),
    ],
)
def test_a_forbidden_configuration_value_is_refused(
    tmp_path: Path, text: str, complaint: str
) -> None:
    with pytest.raises(InputError, match=complaint) as refusal:
        _load(tmp_path, text)

    assert "armrig.toml" in str(refusal.value) or "[timing]" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_missing_configuration_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.toml: there is no such file"):
        load([tmp_path / "nowhere.toml"], {}, {})


def test_the_later_layer_wins_key_by_key(tmp_path: Path) -> None:
    system, user = tmp_path / "system.toml", tmp_path / "user.toml"
    system.write_text("[timing]\nTs = 0.02\npriority = 10\n[limits]\nu_max_v = 3.0")
    user.write_text("[timing]\nTs = 0.03\nspin_us = 5")
    environ = {"ARMRIG_TIMING_SPIN_US": "6", "ARMRIG_DEVICE_PORT": "/dev/x", "HOME": "/"}

    config = load([system, user], environ, {"device": {"port": "/dev/y"}})

    assert (config.timing.priority, config.timing.Ts, config.timing.spin_us) == (10, 0.03, 6)
    assert (config.limits.u_max_v, config.device.port) == (3.0, "/dev/y")


def test_defaults_of_a_command_have_the_lowest_precedence(tmp_path: Path) -> None:
    user, below = tmp_path / "user.toml", {"device": {"watchdog_ms": 250}}
    user.write_text("[device]\nwatchdog_ms = 100\nbaud = 115200")

    assert load([], {}, {}).device.watchdog_ms == 100
    assert load([], {}, {}, below=below).device.watchdog_ms == 250
    assert load([user], {}, {}, below=below).device.watchdog_ms == 100
    environ = {"ARMRIG_DEVICE_WATCHDOG_MS": "60"}
    assert load([user], environ, {}, below=below).device.watchdog_ms == 60
    overrides = {"device": {"watchdog_ms": 50}}
    assert load([user], environ, overrides, below=below).device.watchdog_ms == 50


@pytest.mark.parametrize(
    ("name", "text", "complaint"),
    [
        ("ARMRIG_DEVCE_PORT", "/dev/x", "must be ARMRIG_<TABLE>_<KEY>; tables: rig, device"),
        ("ARMRIG_DEVICE_PROT", "/dev/x", "device.prot = '/dev/x': no such key; allowed are port"),
        ("ARMRIG_DEVICE_BAUD", "fast", "device.baud = 'fast': expected `int`"),
    ],
)
def test_a_mistyped_variable_is_refused(name: str, text: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint) as refusal:
        load([], {name: text}, {})

    assert str(refusal.value).startswith("environment: ")


def test_a_documented_variable_that_is_not_a_key_is_ignored() -> None:
    """docs/firmware.md names ARMRIG_FIL, which may be set permanently."""
    named = {"ARMRIG_FIL": "/opt/fil", "ARMRIG_CLIENT_CONNECT": "tls/lab.example.edu:7447"}

    assert load([], named | {"ARMRIG_DEVICE_BAUD": "250000"}, {}).device.baud == 250_000


def test_a_variable_that_is_given_twice_is_refused() -> None:
    environ = {"ARMRIG_TIMING_TS": "0.01", "ARMRIG_TIMING_Ts": "0.02"}

    with pytest.raises(InputError, match=r"ARMRIG_TIMING_Ts='0.02': timing.Ts is given twice"):
        load([], environ, {})


def test_the_rehearsed_rig_has_the_handout_s_parameters_unless_configured(
    tmp_path: Path,
) -> None:
    config = _load(tmp_path, "[arm]\nJ_2 = 0.005\nremoved = true")

    assert Config().arm.parameters() == ArmParameters()
    assert config.arm.parameters() == replace(ArmParameters(), J_2=0.005)
    assert config.arm.removed
    assert Config().arm.turns_per_volt_s == pytest.approx(1.8623 / tau, rel=1e-4)  # the handout's
    assert ArmSettings(N=32.0).turns_per_volt_s == pytest.approx(2 * 1.8623 / tau, rel=1e-4)


@pytest.mark.parametrize("key", ["oversampling = 255", "rail_ticks = 65535"])
def test_limits_of_the_wire_are_accepted(tmp_path: Path, key: str) -> None:
    """The ends of the fields on the wire; 255 conversions take 53 ms."""
    device = _load(tmp_path, f"[timing]\nTs = 0.1\n[device]\n{key}").device

    assert f"{key.split()[0]}={key.split()[2]}" in repr(device)


def test_each_key_of_the_core_s_rules_reaches_them(tmp_path: Path) -> None:
    rules = _load(
        tmp_path,
        "[timing]\nTs = 0.02\nstop_after = 3\n"
        "[device]\nbaud = 115200\nwatchdog_ms = 60\noversampling = 4\nrail_ticks = 30\n"
        "[limits]\nu_min_v = 0.5\nu_max_v = 4.0\nslew_v = 2.0\nrevolutions = 1.25\n"
        "[calibration.theta_1]\nzero_counts = 7.5\n",
    ).rules()

    assert rules == Rules(
        code_min=6554,
        code_max=52428,
        slew=26215,
        ts_us=20_000,
        watchdog_ms=60,
        baud=115_200,
        stop_after=3,
        turns=125,
        rail_ticks=30,
        oversampling=4,
        calibration=Calibration(theta_1=Potentiometer(zero_counts=7.5)),
    )


@pytest.mark.parametrize(("slew_v", "codes"), [(0.2, 2622), (1.0, 13108), (5.0, 65535)])
def test_the_slew_limit_in_codes_allows_every_step_of_the_slew_voltage(
    slew_v: float, codes: int
) -> None:
    """The rounding of both ends may add one code."""
    rules = Config(limits=Limits(slew_v=slew_v)).rules()

    steps = [code_of(low + slew_v) - code_of(low) for low in np.linspace(0, 5 - slew_v, 99)]

    assert rules.slew == codes
    assert all(rules.allows(0, step) for step in steps)


def test_a_file_of_a_windows_editor_is_read(tmp_path: Path) -> None:
    path = tmp_path / "armrig.toml"
    text = "[timing]\r\nTs = 0.02\r\n"
    path.write_text(text, encoding="utf-8-sig")

    assert load([path], {}, {}).timing.Ts == 0.02
    path.write_text(text, encoding="utf-16")
    with pytest.raises(InputError, match=r"toml: it is saved as UTF-16: save it as UTF-8$"):
        load([path], {}, {})


def test_configuration_file_must_be_a_regular_file(tmp_path: Path) -> None:
    path = tmp_path / "armrig.toml"
    os.mkfifo(path)

    with pytest.raises(InputError, match=r"armrig\.toml: not a regular file$"):
        load([path], {}, {})


def test_the_file_of_a_rig_has_precedence_over_that_of_all(machine: Path, tmp_path: Path) -> None:
    (machine / "armrig.toml").write_text("[limits]\nu_max_v = 4.5\nu_min_v = 0.1\nslew_v = 1")
    (machine / "2.toml").write_text("[limits]\nu_min_v = 0.2\nslew_v = 2")
    (tmp_path / "user" / "armrig").mkdir(parents=True)
    (tmp_path / "user" / "armrig" / "armrig.toml").write_text("[limits]\nslew_v = 3")

    of_2 = load_installed({}, {"rig": {"id": "2"}}).limits
    of_1 = load_installed({}, {}).limits

    assert (of_2.u_max_v, of_2.u_min_v, of_2.slew_v) == (4.5, 0.2, 3)
    assert (of_1.u_max_v, of_1.u_min_v, of_1.slew_v) == (4.5, 0.1, 3)


def test_a_service_reads_only_the_files_of_the_machine(machine: Path, tmp_path: Path) -> None:
    """A file that its own user can write must not widen its limits."""
    (machine / "1.toml").write_text("[limits]\nslew_v = 2")
    (tmp_path / "user" / "armrig").mkdir(parents=True)
    (tmp_path / "user" / "armrig" / "armrig.toml").write_text("[limits]\nslew_v = 3")

    assert load_installed({}, {}, system=True).limits.slew_v == 2


def test_a_service_whose_rig_has_no_file_is_refused(machine: Path) -> None:
    """A name with a typing error must not start on the port of another rig."""
    with pytest.raises(InputError, match=rf"^{machine}/l\.toml: there is no such file; write it"):
        load_installed({}, {"rig": {"id": "l"}}, system=True)


def test_the_file_of_another_rig_is_refused(machine: Path) -> None:
    (machine / "2.toml").write_text("[rig]\nid = '1'")

    with pytest.raises(InputError, match=r"2\.toml: rig\.id = '1': the file belongs to rig '2'"):
        load_installed({"ARMRIG_RIG_ID": "2"}, {})


@pytest.mark.parametrize("name", ["arm", "chassis", "rc"])
def test_the_highest_voltage_of_a_description_is_in_force_for_each_rig(
    name: str, tmp_path: Path
) -> None:
    """A description of the arm lost it without a word."""
    (tmp_path / "own.toml").write_bytes(builtin(name).text + b"\n[input]\nu_max_v = 2.0\n")

    config = load([], {}, {"rig": {"file": str(tmp_path / "own.toml")}})

    assert config.limits.u_max_v == 2.0
    assert config.arm.removed == (name == "chassis")


NARROW = b"""
[rig]
name = "narrow"

[input]
u_max_v = 2.0

[outputs.theta_1]
unit = "rad"
per_count = 9.37e-05
turning = true
turns = 1.5

[outputs.alpha]
unit = "rad"
zero_counts = 32768.0
per_count = 9.37e-05
low = -0.5
high = 0.4
"""


def _of_narrow_rig(tmp_path: Path, limits: str) -> Path:
    (tmp_path / "narrow.toml").write_bytes(NARROW)
    (tmp_path / "lab.toml").write_text(f'[rig]\nfile = "narrow.toml"\n[limits]\n{limits}\n')
    return tmp_path / "lab.toml"


@pytest.mark.parametrize(
    ("key", "wider", "widest", "name"),
    [
        ("u_max_v", 2.01, 2.0, "input.u_max_v"),
        ("revolutions", 1.51, 1.5, "turns of theta_1"),
        ("alpha_rad", 0.51, 0.5, "low and high of alpha"),
    ],
)
def test_a_limit_cannot_be_wider_than_that_of_the_description(
    key: str, wider: float, widest: float, name: str, tmp_path: Path
) -> None:
    """`[limits] u_max_v = 5` let a shield of 1.25 V have 5 V."""
    file = _of_narrow_rig(tmp_path, f"{key} = {wider}")
    said = (
        rf"limits\.{key} = {wider}: expected at most {widest:g}, as {name} in the description of "
    )

    with pytest.raises(InputError, match=rf"^{file}: {said}rig narrow; .* leave the key out$"):
        load([file], {}, {})
    _of_narrow_rig(tmp_path, f"{key} = {widest}")
    assert getattr(load([file], {}, {}).limits, key) == widest
    with pytest.raises(InputError, match=f"^environment: {said}"):
        load([file], {f"ARMRIG_LIMITS_{key.upper()}": str(wider)}, {})
    with pytest.raises(InputError, match=f"^command line: {said}"):
        load([file], {}, {"limits": {key: wider}})
    _of_narrow_rig(tmp_path, "")
    with pytest.raises(InputError, match=f"^defaults: {said}"):
        load([file], {}, {}, below={"limits": {key: wider}})


def test_without_a_key_the_limits_of_the_description_are_in_force(tmp_path: Path) -> None:
    """0 adds no limit, and so removes none; `u_max_v` = 0 allows 0 V only."""
    for limits in ("", "revolutions = 0\nalpha_rad = 0\nslew_v = 0\nu_min_v = 0"):
        config = load([_of_narrow_rig(tmp_path, limits)], {}, {})
        rig = config.narrow_description(description_of(config))

        assert config.limits.u_max_v == 2.0
        assert (rig.outputs["theta_1"].turns, config.rules(rig).turns) == (1.5, 150)
        assert (rig.outputs["alpha"].low, rig.outputs["alpha"].high) == (-0.5, 0.4)
    assert load([_of_narrow_rig(tmp_path, "u_max_v = 0")], {}, {}).limits.u_max_v == 0.0
    with pytest.raises(InputError, match=r"u_min_v = 3.0 must not be above u_max_v = 2.0"):
        load([_of_narrow_rig(tmp_path, "u_min_v = 3")], {}, {})


def test_a_narrower_limit_narrows_each_end_of_a_range(tmp_path: Path) -> None:
    limits = "u_max_v = 1.5\nu_min_v = 0.5\nslew_v = 5\nrevolutions = 1\nalpha_rad = 0.45"
    config = load([_of_narrow_rig(tmp_path, limits)], {}, {})
    rig = config.narrow_description(description_of(config))

    assert (config.limits.u_min_v, config.limits.u_max_v) == (0.5, 1.5)
    assert rig.outputs["theta_1"].turns == 1.0
    assert (rig.outputs["alpha"].low, rig.outputs["alpha"].high) == (-0.45, 0.4)


def test_the_description_of_a_rig_may_be_a_shipped_one(tmp_path: Path) -> None:
    """A file of this name in the folder of the configuration has precedence."""
    own = tmp_path / "armrig.toml"
    own.write_text('[rig]\nfile = "rc"\n')

    shipped_one = description_of(load([own], {}, {}))
    (tmp_path / "rc").write_bytes(builtin("heater").text)
    beside = description_of(load([own], {}, {}))

    assert (shipped_one.rig.name, beside.rig.name) == ("rc", "heater")
