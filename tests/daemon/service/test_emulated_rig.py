"""The emulator that a daemon starts."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

WITHIN_S = 30.0
_DAEMON = """
import os, subprocess, sys
from pathlib import Path
from armrig_daemon.config import Config
from armrig_daemon.service import emulated_rig

class Killed(subprocess.Popen):
    def __init__(self, *given, **how):
        super().__init__(*given, **how)
        os._exit(9)

subprocess.Popen = Killed
with emulated_rig.emulated(Config(), Path(sys.argv[1])):
    pass
"""


def test_an_emulator_does_not_outlive_a_daemon_that_dies_while_it_loads(tmp_path: Path) -> None:
    paths = os.pathsep.join(path for path in sys.path if path)

    # It has the same standard output: this is at its end once both have ended.
    done = subprocess.run(
        [sys.executable, "-c", _DAEMON, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": paths},
        stdout=subprocess.PIPE,
        timeout=WITHIN_S,
    )

    assert done.returncode == 9
    assert list(tmp_path.iterdir()) == []
