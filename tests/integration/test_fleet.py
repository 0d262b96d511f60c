"""A lab's router, its rigs, and one recorder for all: nothing is lost, and no rig harms another."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from armrig.cli import main
from armrig.rig.client import Rig

from tests.integration.fleet_lab import (
    RIGS,
    WITHIN_S,
    FleetLab,
    Publisher,
    connected,
    publish,
    recorded_k,
)
from tests.integration.processes import Bench, newest, wait_for


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FleetLab:
    """Return a lab in which we are bob, who may watch."""
    lab = FleetLab(tmp_path)
    monkeypatch.setenv("ARMRIG_CLIENT_CERTIFICATE", str(lab.made / "bob.pem"))
    return lab


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    """Give a stack that ends everything that a test has begun."""
    with ExitStack() as stack:
        yield stack


def test_a_restart_of_the_router_loses_no_sample(lab: FleetLab, stack: ExitStack) -> None:
    router = lab.router()
    daemons = [stack.enter_context(lab.daemon(rig)) for rig in RIGS]
    told: list[str] = []
    with Publisher(*daemons) as published, lab.recorder(told.append) as recorder:
        recorder.has_begun(*RIGS)
        router.close()
        published.wait_for_more(100)
        stack.enter_context(lab.router())
        connected(*daemons)
        published.wait_for_more(100)
        before = published.k
        files = [lab.folder / "files" / f"{rig}.mcap.active" for rig in RIGS]
        wait_for(lambda: all(newest(file, "k") >= before - 1 for file in files), WITHIN_S)

    for rig in RIGS:
        [file] = recorder.recorded[rig].files
        ks = recorded_k(file.path)
        assert ks == list(range(len(ks)))
        assert len(ks) >= before
    assert not any("lost" in line for line in told)


def test_a_rig_that_starts_later_is_recorded_too(lab: FleetLab, stack: ExitStack) -> None:
    stack.enter_context(lab.router())
    first = stack.enter_context(lab.daemon("1"))
    publish([first], range(100))
    with lab.recorder(lambda _: None) as recorder:
        recorder.has_begun("1")
        with lab.daemon("2") as second:
            publish([second], range(50))
            file = lab.folder / "files" / "2.mcap.active"
            wait_for(lambda: newest(file, "k") == 49, WITHIN_S)
        publish([first], range(100, 200))

    files = {rig: one.files[0].path for rig, one in recorder.recorded.items()}
    assert {rig: recorded_k(path) for rig, path in files.items()} == {
        "1": list(range(200)),
        "2": list(range(50)),
    }
    assert {one.why for one in recorder.recorded.values()} == {""}


def test_a_rig_that_sends_invalid_messages_ends_only_its_recording(
    lab: FleetLab, stack: ExitStack
) -> None:
    stack.enter_context(lab.router())
    daemons = [stack.enter_context(lab.daemon(rig)) for rig in RIGS]
    publish(daemons, range(50))
    told: list[str] = []
    with lab.recorder(told.append) as recorder:
        recorder.has_begun(*RIGS)
        daemons[1].put("sample", b"\xff" * 87)
        wait_for(lambda: any("rig 2: its recording ended" in line for line in told), WITHIN_S)
        publish([daemons[0], daemons[2]], range(50, 100))

    files = {rig: one.files[0] for rig, one in recorder.recorded.items()}
    assert {rig: len(recorded_k(file.path)) for rig, file in files.items()} == {
        "1": 100,
        "2": 50,
        "3": 100,
    }
    assert "not a message of armrigd" in recorder.recorded["2"].why
    assert files["2"].outcome.startswith("the recorder ended: ")


_HOLDER = """
import sys
from armrig.rig.client import Rig
with Rig("1", connect=sys.argv[1], certificate=sys.argv[2]) as rig:
    rig.reset()
    rig.arm("a test")
    while True:
        rig.set(2.0)
"""


def test_a_voltage_held_through_a_router_that_dies_falls_to_0_v(
    lab: FleetLab, bench: Bench
) -> None:
    bench.configure(watchdog_ms=250, more=lab.access("1"))
    bench.emulate()
    bench.serve()
    router = bench.start("armrig", *lab.router_command())
    with bench.rig() as rig:
        with _holding(lab, bench, rig):
            router.kill()
            wait_for(lambda: bench.volts() == 0.0, WITHIN_S)
            wait_for(lambda: rig.status().owner == "", WITHIN_S)
        assert rig.status().reason.startswith("the lease ran out")


@contextmanager
def _holding(lab: FleetLab, bench: Bench, rig: Rig) -> Iterator[None]:
    """Have alice's program hold 2 V by its lease."""
    arguments = _HOLDER, lab.endpoint, str(lab.made / "alice.pem")
    holder = bench.client(*arguments)

    def holds() -> bool:
        nonlocal holder
        if holder.poll() is not None:  # the daemon has not found its router yet
            holder = bench.client(*arguments)
        return bench.volts() > 1.9 and rig.status().owner == "a test (certificate alice)"

    try:
        wait_for(holds, WITHIN_S)
        yield
    finally:
        holder.kill()
        holder.wait()


def test_a_router_that_cannot_listen_reports_the_reason(
    lab: FleetLab, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*lab.router_command(), "--listen", "tls/192.0.2.1:7447"]) == 1

    said = " ".join(capsys.readouterr().err.split())
    assert "Cannot assign requested address; check that the host is this machine" in said


def test_a_router_ends_in_order_at_a_signal(lab: FleetLab) -> None:
    command = [sys.executable, "-m", "armrig", *lab.router_command()]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as router:
        assert router.stderr is not None
        said = router.stderr.readline()
        router.send_signal(signal.SIGINT)
        rest = router.stderr.read()

    assert said == (
        f"router at {lab.endpoint}: 3 rigs, 2 may drive and 1 may watch; Ctrl-C ends the router\n"
    )
    assert (router.returncode, rest) == (0, "")


def test_one_command_records_the_named_rigs_and_reports_a_missing_rig(
    lab: FleetLab, stack: ExitStack, capsys: pytest.CaptureFixture[str]
) -> None:
    stack.enter_context(lab.router())
    daemons = [stack.enter_context(lab.daemon(rig)) for rig in ("1", "2")]
    publish(daemons, range(100))
    connected(*daemons)
    given = ["--rig", "1", "--rig", "3", "-o", str(lab.folder / "files"), "--seconds", "2"]

    assert main(["record", "--from", lab.endpoint, *given, "--json"]) == 1
    said = capsys.readouterr()

    (file,) = json.loads(said.out)["recordings"]
    assert (file["rig"], file["samples"], file["missing"]) == ("1", 100, 0)
    assert recorded_k(Path(file["recording"])) == list(range(100))
    assert "rig 3: no sample arrived, so it has no recording" in said.err


def test_a_session_at_a_router_receives_only_the_samples_of_its_rig(
    lab: FleetLab, stack: ExitStack
) -> None:
    stack.enter_context(lab.router())
    daemons = [stack.enter_context(lab.daemon(rig)) for rig in RIGS]
    with Publisher(*daemons), Rig("3", connect=lab.endpoint) as rig:
        connected(*daemons)
        assert next(rig.stream("sample")).u_applied_v == 1.0
