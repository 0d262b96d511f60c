"""The bench reports what shows why a test failed."""

from __future__ import annotations

import signal

from tests.integration.processes import Bench, freeze


def test_the_phase_and_the_threads_of_each_program_are_reported(bench: Bench) -> None:
    bench.emulate()
    bench.serve()

    report = bench.report()

    assert report["Phase of the daemon"] == "safe"
    for log, said in (("log0", "an emulated rig is at"), ("log1", "rig 1 at")):
        text = report[f"Printed by {log}"]
        assert said in text
        assert "Current thread" in text
        assert "most recent call first" in text


def test_a_frozen_program_does_not_keep_the_report_waiting(bench: Bench) -> None:
    emulator = bench.emulate()
    freeze(emulator.popen.pid)

    assert "Current thread" not in bench.report()["Printed by log0"]
    emulator.kill(signal.SIGCONT)
