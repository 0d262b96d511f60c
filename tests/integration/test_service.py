"""The daemon as its users meet it: zenoh, recordings, errors for people."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig.rig.replies import RefusedError
from armrig_core.manifest import CONFIG
from armrig_daemon.config import EX_CONFIG
from mcap.reader import make_reader

from tests.integration.driving import hold
from tests.integration.processes import WITHIN_S, Bench, Process, wait_for
from tests.integration.sockets import inodes

SUBSCRIBER = """
import sys, zenoh
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
assert not any(name.startswith("armrig") for name in sys.modules)
endpoint, count = sys.argv[1], int(sys.argv[2])
config = zenoh.Config.from_json5(
    '{mode: "client", connect: {endpoints: ["%s"]}}' % endpoint
)
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config) as session:
    reply = next(iter(session.get("rig/1/schema/armrig.v1.Sample", timeout=30)))
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(reply.ok.payload.to_bytes()).file:
        pool.Add(file)
    Sample = message_factory.GetMessageClass(pool.FindMessageTypeByName("armrig.v1.Sample"))
    with session.declare_subscriber("rig/1/sample") as samples:
        ks = []
        for sample in samples:
            assert str(sample.encoding) == "application/protobuf;armrig.v1.Sample", sample.encoding
            decoded = Sample.FromString(sample.payload.to_bytes())
            assert len(decoded.ListFields()) == 11
            ks.append(decoded.k)
            if len(ks) == count:
                break
print(ks[-1] - ks[0] + 1)
"""


def test_a_run_comes_back_as_a_recording_that_others_read(served: Bench) -> None:
    u = armrig.telegraph(300, 0.1, low=0.0, high=5.0, seed=1)

    with served.rig() as rig:
        rig.arm("a test", Ts=0.005)
        path = rig.run(u, experiment="blackbox", details={"seed": 1})

    recording = armrig.load(path)
    at = recording.samples["k"].astype(int) - recording.manifest.k_first
    np.testing.assert_allclose(recording.samples["u_cmd_v"], u[at], atol=1e-4)
    assert at.size + recording.missing == u.size
    assert recording.manifest.details == {"seed": 1}
    assert recording.manifest.Ts == 0.005
    assert not recording.truncated
    doctor = subprocess.run(
        [Path(sys.executable).with_name("pymcap-cli"), "doctor", path],
        capture_output=True,
        text=True,
        check=False,
    )
    assert doctor.returncode == 0, doctor.stdout
    assert "passed MCAP doctor checks" in doctor.stdout
    remarks = [line for line in doctor.stdout.splitlines() if "│ info" in line]
    assert [line for line in remarks if "UNKNOWN_PROFILE" not in line] == []  # `armrig` is ours
    assert "warning" not in doctor.stdout


def test_a_plain_zenoh_subscriber_needs_only_endpoint_and_schema(served: Bench) -> None:
    """No armrig in that process."""
    endpoint = f"unixsock-stream/{served.folder}/armrig/1.sock"

    result = subprocess.run(
        [sys.executable, "-I", "-c", SUBSCRIBER, endpoint, "100"],
        capture_output=True,
        text=True,
        timeout=WITHIN_S * 2,
        check=False,
    )

    assert result.returncode == 0, result.stderr
    assert int(result.stdout) >= 100


def test_a_command_with_a_wrong_field_is_refused_with_its_name(served: Bench) -> None:
    with served.rig() as rig:
        with pytest.raises(RefusedError, match=r"scheduled mode: at least 0.000401 s"):
            rig.arm("a test", Ts=0.0003)
        rig.arm("a test")
        with pytest.raises(ValueError, match=r"u\[1\] = 6 V is outside 0 … 5 V"):
            rig.run(np.array([1.0, 6.0]))
        with pytest.raises(ValueError, match=r"u\[0\] = nan V is outside"):
            rig.set(float("nan"))
    assert served.volts() == 0.0


def test_a_client_that_checks_nothing_is_refused_by_the_daemon(served: Bench) -> None:
    """S1: the service checks by itself."""
    before = len(served.voltage_changes())
    with served.rig() as rig:
        lease = rig.arm("a test").lease
        for volts in ("6.0", "-1.0", "1e999", "NaN", "null", "true", '"3"'):
            payload = f'{{"lease": "{lease}", "n": 1, "u": {volts}}}'
            session = rig._connected()
            (reply,) = session.get("rig/1/cmd/set", payload=payload, timeout=30)
            assert reply.err is not None, volts
            assert b"set: " in reply.err.payload.to_bytes()
    assert {volts for _, volts in served.voltage_changes()[before:]} <= {0.0}


def test_the_voltage_follows_the_hand_and_the_stop(served: Bench) -> None:
    before = len(served.voltage_changes())
    with served.rig() as rig:
        hold(rig, served, 2.0)
        rig.stop()
        wait_for(lambda: served.volts() == 0.0)
    volts = [volts for _, volts in served.voltage_changes()[before:] if volts]
    assert volts == pytest.approx([2.0] * len(volts), abs=0.01)


def test_the_socket_is_for_the_user_and_the_group_alone(served: Bench) -> None:
    """A1: no TCP port, no multicast, no access for others."""
    socket = served.folder / "armrig" / "1.sock"
    assert socket.stat().st_mode & 0o007 == 0
    assert socket.parent.stat().st_mode & 0o077 == 0
    of_daemon = inodes(served.processes[1].popen.pid)
    assert of_daemon  # of the Unix socket
    for table in ("tcp", "tcp6", "udp", "udp6"):
        rows = Path(f"/proc/net/{table}").read_text().splitlines()[1:]
        assert of_daemon.isdisjoint({row.split()[9] for row in rows}), table


@pytest.mark.parametrize(
    ("more", "complaint"),
    [
        ("[timing]\nTs = 0.0005", "at least 0.000728 s, or a higher baud rate"),
        ("[timing]\nTz = 0.01", "timing.Tz = 0.01: no such key; allowed are Ts"),
        ("[limits]\nu_max_v = 7", "limits.u_max_v = 7: expected `float` <= 5.0"),
    ],
)
def test_a_bad_configuration_is_refused_in_one_line(
    bench: Bench, more: str, complaint: str
) -> None:
    bench.configure(more=more)

    daemon = bench.start("armrig_daemon", "run", "--config", str(bench.config))

    assert daemon.popen.wait(WITHIN_S) == EX_CONFIG
    assert complaint in daemon.said
    assert daemon.said.count("\n") == 1


def test_a_directory_of_sockets_that_others_can_write_to_is_refused(bench: Bench) -> None:
    folder = bench.folder / "armrig"
    folder.mkdir()
    folder.chmod(0o777)

    daemon = bench.start("armrig_daemon", "run", "--config", str(bench.config))

    assert daemon.popen.wait(WITHIN_S) == EX_CONFIG
    assert f"{folder}: can be written by other users (mode 777, not 700); set XDG" in daemon.said
    assert daemon.said.count("\n") == 1


@pytest.mark.root
def test_the_thread_of_the_loop_s_parent_death_signal_waits_for_no_processor(served: Bench) -> None:
    daemon = served.processes[-1]
    loop = served.loop_pid(daemon)
    if os.sched_getscheduler(loop) != os.SCHED_FIFO:
        pytest.skip("no real-time rights")
    tasks = Path(f"/proc/{daemon.popen.pid}/task")

    prompt = []
    for task in tasks.iterdir():
        with suppress(ProcessLookupError):  # it has ended since it was listed
            if os.sched_getscheduler(int(task.name)):
                prompt.append(int(task.name))

    assert len(prompt) == 1
    assert (tasks / str(*prompt) / "children").read_text().split() == [str(loop)]


def test_a_file_at_the_place_of_the_socket_is_left_there(bench: Bench) -> None:
    place = bench.folder / "armrig" / "1.sock"
    place.parent.mkdir(mode=0o700)
    place.write_text("somebody's notes")

    daemon = bench.start("armrig_daemon", "run", "--config", str(bench.config))

    assert daemon.popen.wait(WITHIN_S) == EX_CONFIG
    assert place.read_text() == "somebody's notes"
    assert f"{place}: another file has the name of the socket; move it away" in daemon.said
    assert daemon.said.count("\n") == 1


def test_a_port_that_is_not_there_is_waited_for(bench: Bench) -> None:
    daemon = bench.start("armrig_daemon", "run", "--config", str(bench.config))
    wait_for(lambda: bench.phase() == "init")
    with bench.rig() as rig:
        wait_for(lambda: rig.status().line)
        assert rig.status().line.startswith(
            f"{bench.port}: no rig is connected, and the daemon waits for one"
        )
        with pytest.raises(RefusedError, match="no rig is connected, and the daemon waits for one"):
            rig.arm("a test")

    bench.emulate()
    wait_for(lambda: bench.phase() == "safe")

    assert daemon.said.count(f"{bench.port} cannot be opened: it is not there") == 1
    assert "Traceback" not in daemon.said


def test_a_port_that_is_taken_is_said(served: Bench) -> None:
    second = served.start("armrig_daemon", "run", "--config", str(served.config), "--rig", "2")

    assert second.popen.wait(WITHIN_S) == EX_CONFIG
    assert "it is in use by another program" in second.said
    assert served.settled() == "safe"


def test_two_daemons_of_one_rig_are_one_too_many(served: Bench) -> None:
    second = served.start("armrig_daemon", "run", "--config", str(served.config), "--emulate")

    assert second.popen.wait(WITHIN_S) == EX_CONFIG
    assert "1.sock" in second.said
    assert "Traceback" not in second.said
    assert served.settled() == "safe"


@pytest.mark.parametrize(("said", "watchdog_ms"), [("", 250), ("watchdog_ms = 100", 100)])
def test_an_emulated_rig_has_the_longest_watchdog_unless_one_is_said(
    bench: Bench, said: str, watchdog_ms: int
) -> None:
    bench.config.write_text(f'[device]\n{said}\n[recording]\ndirectory = "{bench.recordings}"\n')

    daemon = bench.start("armrig_daemon", "run", "--config", str(bench.config), "--emulate")

    assert _watchdog_of_a_run(bench, daemon) == watchdog_ms
    # Its line is a socket, whose bytes wait for no worker of the kernel.
    assert f"port unix:{bench.folder}/armrig/1-{daemon.popen.pid}.line at" in daemon.said


def test_a_rig_that_is_not_emulated_by_us_has_the_watchdog_of_the_wire(bench: Bench) -> None:
    """100 ms."""
    bench.emulate()
    bench.config.write_text(
        f'[device]\nport = "{bench.port}"\nbaud = 1000000\n'
        f'[recording]\ndirectory = "{bench.recordings}"\n'
    )

    daemon = bench.start("armrig_daemon", "run", "--config", str(bench.config))

    assert _watchdog_of_a_run(bench, daemon) == 100


def _watchdog_of_a_run(bench: Bench, daemon: Process) -> int:
    """Return the watchdog in the configuration that a recording holds, in ms."""
    wait_for(lambda: bench.phase() == "safe" or daemon.popen.poll() is not None)
    with bench.rig() as rig:
        rig.arm("a test", Ts=0.01)
        with rig.run([1.0] * 5).open("rb") as file:
            (config,) = (
                attachment.data
                for attachment in make_reader(file).iter_attachments()
                if attachment.name == CONFIG
            )
    return int(json.loads(config)["device"]["watchdog_ms"])


@pytest.mark.parametrize("program", ["run", "emulate"])
def test_a_configuration_that_is_a_pipe_is_refused(bench: Bench, program: str) -> None:
    bench.config.unlink()
    os.mkfifo(bench.config)

    daemon = bench.start(
        *("armrig_daemon", program, "--config", str(bench.config)),
        *("--port", str(bench.folder / "other")),
    )

    assert daemon.popen.wait(WITHIN_S) == EX_CONFIG
    assert daemon.said == f"armrigd: {bench.config}: not a regular file\n"
