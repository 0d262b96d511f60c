"""`armrig calibrate` on real processes: the daemon then uses the result."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path
from signal import SIGINT
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.physics.calibration import estimate
from armrig.recordings.files.container import read
from armrig.recordings.files.replay import replay
from armrig.recordings.usability import doubts_of_calibration
from armrig_core.recording_file.manifest import CALIBRATION, CALIBRATION_RAW
from armrig_core.rig.calibration_file import raw_path, read_calibration
from msgspec.structs import replace

from tests.clients.made_turns import stored_readings
from tests.integration.processes import WITHIN_S, Bench, wait_for

UNKNOWN = """
theta_1_reversed = true
theta_1_range_deg = 340.0
theta_1_zero_deg = 100.0
theta_1_low_v = 0.2
alpha_reversed = true
alpha_zero_deg = 170.0
coulomb_nm = 0.02
"""


def _calibrated(bench: Bench, output: Path) -> tuple[dict[str, Any], str]:
    """Calibrate on the command line, Enter at each question; return its output."""
    ours, theirs = os.openpty()
    os.write(ours, b"\n" * 5)
    done = subprocess.run(
        [
            *(sys.executable, "-m", "armrig", "calibrate", "--connect", bench.endpoint),
            *("--json", "--save", str(output), "--volts", "5"),
            *("--level-seconds", "5", "--rest-seconds", "0.5", "--meter", "32768=2.5"),
        ],
        stdin=theirs,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    os.close(ours)
    os.close(theirs)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found, done.stderr


@pytest.mark.exhaustive
def test_a_rig_is_calibrated_and_its_next_recording_carries_it(bench: Bench) -> None:
    bench.configure(more=UNKNOWN)
    bench.emulate()
    daemon = bench.serve()
    output = bench.folder / "calibration.toml"

    found, said = _calibrated(bench, output)
    at_once = _recorded(bench)
    with bench.rig() as rig:
        status = rig.status()
    daemon.end()
    daemon = bench.serve()
    with bench.rig() as rig:
        restarted = rig.status()
    daemon.end()
    with bench.config.open("a") as config:
        config.write('[calibration]\nfile = "calibration.toml"\n')
    bench.serve()
    by_configuration = _recorded(bench)

    scale = found["figures"]["theta_1_rad_per_count"]
    true = -np.radians(340) / ((5.0 - 0.2) / 5 * 65536)
    assert abs(scale["value"] - true) < 3 * scale["std"] < 1e-3 * abs(true)
    assert found["alpha_sign"] == -1
    assert bench.volts() == 0.0
    assert "Load the calibration into the running daemon now? [Y/n]" in said
    assert f'[calibration]\nfile = "{output}"' in said
    assert found["in_use"]
    assert "sent by `armrig calibrate`, made 20" in status.calibration
    assert restarted.calibration.startswith("none")
    written = read_calibration(output)
    assert written.made is not None
    for rec, file in ((at_once, ""), (by_configuration, str(output))):
        assert rec.calibration == replace(written, made=replace(written.made, file=file))
        shown = rec.theta_1[rec.valid]
        assert shown[-1] > shown[0] + 0.5, "a voltage turns towards positive angles"
        assert [*doubts_of_calibration(rec.calibration, rec.manifest)] == []
        assert replay(rec.path).difference == ""
        content = read(rec.path)
        assert content is not None
        samples = content.attachments[CALIBRATION_RAW]
        assert samples == raw_path(output).read_bytes()
        attached = hashlib.sha256(content.attachments[CALIBRATION]).hexdigest()
        assert rec.manifest.calibration_sha256 == attached
    assert at_once.manifest.calibration_sha256 == status.calibration_sha256
    again = estimate(**stored_readings(samples), meter=[(2.5, 2.5)])
    assert again.figures()["theta_1_rad_per_count"].value == pytest.approx(scale["value"])


def _recorded(bench: Bench) -> armrig.Recording:
    with bench.rig() as rig:
        rig.arm("a test")
        return armrig.load(rig.run(np.full(100, 1.0)))


def test_ctrl_c_during_a_calibration_leaves_the_rig_at_0_v_and_no_file(bench: Bench) -> None:
    bench.emulate()
    bench.serve()
    output = bench.folder / "calibration.toml"
    options = "--yes", "--save", str(output), "--rest-seconds", "0.5", "--volts", "3"
    asked = bench.start("armrig", "calibrate", "--connect", bench.endpoint, *options)
    wait_for(lambda: bench.volts() > 2.9)

    asked.kill(SIGINT)

    assert asked.popen.wait(WITHIN_S) == 130, asked.said
    assert "a stop (0 V) was sent" in asked.said
    wait_for(lambda: bench.volts() == 0.0)
    assert not output.exists()
