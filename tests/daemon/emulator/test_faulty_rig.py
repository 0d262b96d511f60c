"""Faults of an emulated rig: friction, swapped wires, a loose arm, and a sensor that fails."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from armrig_core.errors import InputError
from armrig_core.rig.arm import ArmParameters
from armrig_core.rig.description import Description, builtin, path_of
from armrig_core.rig.volts import code_of
from armrig_daemon.config import load
from armrig_daemon.emulator.board import Board
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol.messages import Cause, Flag, State
from typer.testing import CliRunner

from tests.daemon.virtual_bench import Bench

RC = builtin("rc")
CENTRED = Description.of(
    b"""[rig]
name = "centred"
[input]
name = "armature"
per_volt = 4.8
offset = -12.0
rest_v = 2.5
[outputs.y]
unit = "rad/s"
zero_counts = 32768.0
per_count = 0.006
[model]
A = [[-1.0]]
B = [[14.4]]
C = [[1.0]]
"""
)
MS, SECOND = 1_000_000, 1_000_000_000
ROUND = {"adc_noise_v": 0.0, "pwm_bits": 16, "adc_bits": 0}  # no noise and no steps


def board(description: Description | None = None, **faults: object) -> Board:
    """Return a board without noise, whose run begins now."""
    settings = EmulatorSettings(**{**ROUND, **faults})
    return Board(settings, 0, np.random.default_rng(0), description=description)


def driven(rig: Board, volts: float, s: float, *, from_s: float = 0.0) -> Board:
    """Drive at a constant voltage, in steps of 1 ms, and return the board."""
    rig.latch(round(from_s * SECOND), code_of(volts), Cause.REQUEST)
    for ms in range(round(from_s * 1000), round((from_s + s) * 1000) + 1):
        rig.motion(ms * MS)
    return rig


@pytest.mark.parametrize(("volts", "moves"), [(0.11, False), (0.13, True)])
def test_the_arm_breaks_away_at_the_voltage_of_its_friction(volts: float, moves: bool) -> None:
    theta_1 = driven(board(friction_v=0.12), volts, 1.0).motion(SECOND)[0]

    assert (theta_1 > 0) == moves


def test_friction_in_volts_is_that_in_newton_metres() -> None:
    torque = 0.12 * ArmParameters().torque_per_volt

    in_volts = driven(board(friction_v=0.12), 2.0, 0.5).motion(SECOND // 2)

    assert in_volts == driven(board(coulomb_nm=torque), 2.0, 0.5).motion(SECOND // 2)


def test_friction_of_a_described_rig_is_a_dead_zone_around_its_rest() -> None:
    assert driven(board(RC, friction_v=0.5), 0.4, 1.0).motion(SECOND) == (0.0, 0.0)
    less = driven(board(RC, friction_v=0.5), 2.5, 1.0).motion(SECOND)
    assert less == pytest.approx(driven(board(RC), 2.0, 1.0).motion(SECOND), rel=1e-3)

    rest_v = CENTRED.input.rest_v
    assert not any(driven(board(CENTRED, friction_v=0.5), rest_v + 0.4, 1.0).motion(SECOND))


def test_swapped_wires_turn_the_motor_backwards() -> None:
    forward = driven(board(), 2.0, 0.5).motion(SECOND // 2)
    backward = driven(board(motor_reversed=True), 2.0, 0.5).motion(SECOND // 2)

    assert backward == pytest.approx([-x for x in forward])


def test_swapped_wires_of_a_rig_with_a_centred_input_mirror_it_at_its_rest() -> None:
    rest_v = CENTRED.input.rest_v
    up = driven(board(CENTRED), rest_v + 0.5, 1.0).motion(SECOND)
    down = driven(board(CENTRED, motor_reversed=True), rest_v - 0.5, 1.0).motion(SECOND)

    assert any(up)
    assert down == pytest.approx(up, rel=1e-3)


def test_a_loose_arm_swings_at_the_frequency_of_its_weaker_spring() -> None:
    weak = ArmParameters().K_lin / 4

    loose = driven(board(loose_arm=0.25), 2.0, 0.5).motion(SECOND // 2)

    assert loose == driven(board(arm={"K_lin": weak}), 2.0, 0.5).motion(SECOND // 2)


def test_a_fault_begins_its_time_after_the_start_of_each_run() -> None:
    """Before it the rig moves as an intact one, and at the end of the run it is repaired."""
    rig, intact = board(motor_reversed=True, fault_s=1.0), board()

    assert driven(rig, 2.0, 0.999).motion(999 * MS) == driven(intact, 2.0, 0.999).motion(999 * MS)
    driven(rig, 2.0, 2.0, from_s=1.0)
    assert rig.motion(3 * SECOND)[2] < -1
    rig.release(3 * SECOND, State.IDLE, Cause.REQUEST)
    rig.motion(4 * SECOND)
    assert driven(rig, 2.0, 0.9, from_s=4.0).motion(4900 * MS)[2] > 1


def test_a_stuck_sensor_keeps_its_value_while_the_rig_moves_on() -> None:
    rig = driven(board(faulty_sensor="alpha", sensor_fault="stuck", fault_s=0.1), 3.0, 0.099)
    before, held = rig.reading(1, 99 * MS), {rig.reading(1, ms * MS) for ms in range(101, 500)}

    assert len(held) == 1
    assert abs(held.pop() - before) < 655  # 1 % of the range
    assert rig.motion(500 * MS)[0] > 0.1


def test_a_sensor_that_sticks_when_moving_does_not_stick_at_rest() -> None:
    rig = board(RC, faulty_sensor="y", sensor_fault="stuck_when_moving")
    rest = rig.reading(0, 0)
    rig.motion(SECOND)
    assert rig.reading(0, SECOND) == rest

    rig.latch(SECOND, code_of(3.0), Cause.REQUEST)
    readings = [rig.reading(0, SECOND + ms * MS) for ms in range(1000)]

    assert 655 < readings[-1] - rest < 3 * 655
    assert len(set(readings[-800:])) == 1


@pytest.mark.parametrize(("fault", "codes"), [("low", {0}), ("high", {65535 << 6 & 0xFFFF})])
def test_a_railed_sensor_reads_an_end_of_its_range_in_spite_of_noise(
    fault: str, codes: set[int]
) -> None:
    rig = board(RC, faulty_sensor="y", sensor_fault=fault, adc_noise_v=0.01, adc_bits=10)

    assert {rig.reading(0, ms * MS) for ms in range(200)} == codes


def test_a_reversed_sensor_falls_as_its_output_rises() -> None:
    rig, intact = board(RC, faulty_sensor="y", sensor_fault="reversed"), board(RC)

    for each in (rig, intact):
        driven(each, 3.0, 0.5)

    assert rig.reading(0, SECOND // 2) + intact.reading(0, SECOND // 2) == pytest.approx(
        65536, abs=1
    )


def test_only_the_named_sensor_fails() -> None:
    rig, intact = board(faulty_sensor="theta_1", sensor_fault="low"), board()

    assert (rig.reading(0, MS), rig.reading(1, MS)) == (0, intact.reading(1, MS))


@pytest.mark.parametrize(
    ("keys", "description", "part"),
    [
        ({"loose_arm": 0.5}, "heater", "rig heater has no arm: omit the key"),
        ({"loose_arm": 0.5}, "chassis", "rig chassis has no arm"),
        ({"faulty_sensor": "T3", "sensor_fault": "low"}, "heater", "rig heater has only T1, T2"),
        ({"faulty_sensor": "T1"}, "heater", "give both keys, or neither"),
        ({"sensor_fault": "gone", "faulty_sensor": "alpha"}, "arm", "'gone'"),
    ],
)
def test_a_fault_that_does_not_fit_the_rig_is_refused(
    keys: dict[str, object], description: str, part: str
) -> None:
    with pytest.raises(InputError) as err:
        load([], {}, {"rig": {"file": str(path_of(Path(description)))}, "emulator": keys})

    assert part in str(err.value)


def test_an_intact_rig_has_no_key_of_a_fault_in_its_recordings() -> None:
    """The attached configuration, and with it each recording, keeps its bytes."""
    assert not EmulatorSettings().has_faults
    assert b"fault" not in msgspec.json.encode(EmulatorSettings())


def test_a_fault_of_the_configuration_reaches_virtual_time() -> None:
    rig = Bench(
        adc_noise_v=0.0, faulty_sensor="theta_1", sensor_fault="stuck_when_moving", fault_s=0.3
    )
    rig.play([3.0] * 150)
    rig.run_for(1700)

    counts = [s.counts_0 for s in rig.samples if s.flags & Flag.RUN][-100:]
    assert len(set(counts)) == 1
    assert rig.ports.device.board.motion(rig.ports.now)[0] > 1


def test_a_fault_of_the_configuration_reaches_the_emulator_in_real_time(tmp_path: Path) -> None:
    """The emulator's own process refuses a sensor that its rig has not."""
    from armrig_daemon.command_line import app

    file = tmp_path / "rig.toml"
    file.write_text('[emulator]\nfaulty_sensor = "x"\nsensor_fault = "low"\n')

    result = CliRunner().invoke(
        app, ["emulate", "--port", f"unix:{tmp_path}/line", "--config", str(file)]
    )

    assert result.exit_code != 0
    assert "faulty_sensor = 'x': rig arm has only theta_1, alpha" in result.output
