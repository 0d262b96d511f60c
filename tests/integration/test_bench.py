"""The bench reports what shows why a test failed."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.integration.processes import Bench, freeze

FAILS = """
import pytest

@pytest.fixture
def rig(bench):
    bench.emulate()
    {in_fixture}
    yield
    {in_teardown}

def test_of_a_rig(rig):
    pass
"""


def test_phase_threads_and_processes_are_reported(bench: Bench) -> None:
    bench.emulate()
    daemon = bench.serve()

    report = bench.report()

    assert report["Phase of the daemon"] == "safe"
    assert "test_bench.py" in report["Threads of the tests"]
    (line,) = re.findall(rf"^{daemon.popen.pid} . (.*?): ", report["Processes"], re.M)
    assert re.fullmatch(r"ran \d+\.\d s, waited \d+\.\d s for a processor", line)
    for log, said in (("log0", "an emulated rig is at"), ("log1", "rig 1 at")):
        text = report[f"Printed by {log}"]
        assert said in text
        assert "Current thread" in text
        assert text.endswith(" in <module>\n")


def test_a_frozen_program_does_not_keep_the_report_waiting(bench: Bench) -> None:
    emulator = bench.emulate()
    freeze(emulator.popen.pid)

    assert "Current thread" not in bench.report()["Printed by log0"]
    emulator.kill(signal.SIGCONT)


@pytest.mark.parametrize("when", ["in_fixture", "in_teardown"])
def test_a_fixture_that_fails_shows_what_the_programs_printed(tmp_path: Path, when: str) -> None:
    parts = {"in_fixture": "pass", "in_teardown": "pass", when: "raise RuntimeError"}
    (tmp_path / "test_it.py").write_text(FAILS.format(**parts))
    options = ["-q", "-p", "tests.integration.conftest", "-c", str(tmp_path / "no.ini")]
    (tmp_path / "no.ini").write_text("[pytest]\n")

    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, str(tmp_path)],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 1, done.stdout
    assert "Printed by log0" in done.stdout
    assert "an emulated rig is at" in done.stdout
    # After the teardown of `rig`, that of `bench` has ended the program.
    assert ("in _become" in done.stdout) == (when == "in_fixture")
