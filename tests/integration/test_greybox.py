"""Assignment 3.5 as its users do it: collect from the chassis, load, and estimate its inertia."""

from __future__ import annotations

import json
import subprocess
import sys

import armrig
import pytest
from armrig_core.arm import ArmParameters

from tests.integration.processes import Bench

SECONDS = 6


def _collected(bench: Bench, *arguments: str) -> str:
    """Return the path that `armrig collect greybox` prints."""
    connect = f"unixsock-stream/{bench.folder}/armrig/1.sock"
    command = [sys.executable, "-m", "armrig", "collect", "greybox", "--connect", connect]
    done = subprocess.run(
        [*command, *arguments, "--json"],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        cwd=bench.folder,
    )
    assert done.returncode == 0, done.stderr
    path: str = json.loads(done.stdout)["recording"]
    return path


@pytest.mark.exhaustive
def test_collected_from_the_chassis_the_inertia_comes_back(bench: Bench) -> None:
    """Emulator, daemon and `armrig collect` are processes; J_1 is within 3 sigma."""
    bench.configure(more="arm_removed = true\nseed = 5\n[arm]\nremoved = true")
    bench.emulate()
    bench.serve()
    path = _collected(bench, "--seconds", str(SECONDS), "--Ts", "0.005", "--seed", "4")

    recording = armrig.load(path)
    fit = armrig.greybox(recording.dataset())

    truth = ArmParameters().J_1
    assert recording.manifest.experiment.startswith("greybox")
    assert fit.source == recording.sha256
    assert fit.N > 0.9 * SECONDS / 0.005
    assert fit.converged
    assert abs(fit.values["J_1"] - truth) < 3 * fit.std["J_1"] < 0.03 * truth
