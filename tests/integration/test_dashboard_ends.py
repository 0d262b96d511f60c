"""Ctrl-C ends `armrig dashboard` at once while its modules are loaded."""

from __future__ import annotations

import signal
import subprocess
import sys

from tests.integration.processes import WITHIN_S

# The import of the server takes 30 s. A single call that waits could begin after the signal.
PROGRAM = """
import sys, time
class Slow:
    def find_spec(self, name, *_):
        if name == "armrig.dashboard.serving":
            print("loading", flush=True)
            for _ in range(3000):
                time.sleep(0.01)
sys.meta_path.insert(0, Slow())
from armrig.__main__ import main
sys.argv = ["armrig", "dashboard", "--json"]
sys.exit(main())
"""


def test_ctrl_c_ends_a_dashboard_that_is_still_importing() -> None:
    pipe = subprocess.PIPE
    command = [sys.executable, "-c", PROGRAM]
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as loading:
        try:
            assert loading.stdout is not None
            assert loading.stdout.readline() == "loading\n"
            loading.send_signal(signal.SIGINT)
            code = loading.wait(WITHIN_S)
            assert loading.stderr is not None
            assert (code, loading.stderr.read()) == (130, "armrig: interrupted\n")
        finally:
            loading.kill()
