"""The service under a real systemd: from its start to its end, and with bad input."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from tests.systemd.machine import Machine, wait_for
from tests.systemd.served_rig import Rig

pytestmark = pytest.mark.machine
PRIORITY = 80  # [timing] priority
RESTARTED_S = 30.0
"""Threshold between a restart and none; docs/service.md has the measured time."""


@pytest.fixture
def rig(first: Rig) -> Rig:
    """Give rig 1 at 0 V without a holder; all tests that do not end the service share it."""
    first.start()
    return first


def _restarts(rig: Rig) -> int:
    return int(rig.machine.shown(rig.unit, "NRestarts")["NRestarts"])


def _is_at_rest(rig: Rig) -> bool:
    return rig.volts()[-1] == 0.0


def _errors(rig: Rig, since: int) -> list[str]:
    return [line for priority, line in rig.said()[since:] if priority == "3"]


def test_the_loop_has_its_priority_and_reports_it(rig: Rig) -> None:
    """The priority comes from systemd, because its sandbox prevents a request for it.

    One thread of the service keeps it: that thread only waits for the end of the loop. Inside the
    sandbox the service may choose its own priority from 1 up or, if limits cannot be raised,
    downwards.
    """
    machine = rig.machine
    rows = machine.run("ps", "-Lo", "lwp=,cls=", "-p", rig.main_pid()).stdout.splitlines()
    prompt = [number for number, policy in map(str.split, rows) if policy != "TS"]
    of_it = machine.run("cat", f"/proc/{rig.main_pid()}/task/{prompt[0]}/children").stdout.split()

    policy = machine.run("chrt", "-p", rig.loop_pid()).stdout
    _, status, _ = rig.armrig("status", "--json")

    assert "SCHED_FIFO" in policy
    assert f"priority: {PRIORITY}\n" in policy
    assert f'"fifo":{PRIORITY},' in status
    assert (len(prompt), of_it) == (1, [rig.loop_pid()])


def test_systemd_and_the_journal_show_the_state_of_the_service(rig: Rig) -> None:
    assert rig.status() == "safe, nobody has it"
    said = rig.said()
    assert ("6", "rig 1 at unixsock-stream//run/armrig/1/1.sock") in said
    assert not [line for _, line in said if line.startswith(("armrigd:", "<"))]


def test_only_a_member_of_the_group_can_operate_the_rig(rig: Rig) -> None:
    machine = rig.machine
    for user in ("student", "stranger"):
        machine.run("useradd", "--no-create-home", *(["-G", "armrig"] * (user == "student")), user)
    collect = ("collect", "step", "--seconds", "1", "--at", "0.5", "--name", "s")

    code, _, said = rig.armrig("status", user="stranger", check=False)
    wait_for(lambda: rig.armrig(*collect, user="student", check=False)[0] == 0)

    assert code == 1
    assert "not running, or not permitted" in said
    recording = next(machine.path("/var/lib/armrig/recordings").glob("*-s-*.mcap"))
    name = f"/var/lib/armrig/recordings/{recording.name}"
    machine.run("armrig", "info", name, user="student")
    assert machine.run("armrig", "info", name, user="stranger", check=False).returncode == 1


def _about(machine: Machine, **fields: str) -> list[dict[str, Any]]:
    """Return the entries of the journal with these fields, the oldest first."""
    machine.run("journalctl", "--sync")
    wanted = [f"ARMRIG_{name.upper()}={value}" for name, value in fields.items()]
    found = machine.run("journalctl", "--no-pager", "-o", "json", *wanted).stdout
    return [json.loads(line) for line in found.splitlines()]


def test_the_journal_can_be_filtered_by_the_subject_of_a_line(rig: Rig) -> None:
    machine = rig.machine
    rig.drive()
    rig.armrig("stop", "--owner", "the next")
    wait_for(lambda: rig.phase() == "safe")
    wait_for(lambda: _about(machine, cause="stopped by the next", command="stop"))

    *_, run = _about(machine, rig="1", command="run", owner="group 3")
    *_, stop = _about(machine, rig="1", command="stop")
    wait_for(lambda: "recorded" in _about(machine, run=run["ARMRIG_RUN"])[-1]["MESSAGE"])
    end = _about(machine, run=run["ARMRIG_RUN"])[-1]

    assert run["MESSAGE"] == "run: by group 3"
    assert stop["ARMRIG_OWNER"] == "the next"
    assert end["ARMRIG_CAUSE"].startswith("stopped by the next")
    assert {line["_SYSTEMD_UNIT"] for line in (run, stop, end)} == {rig.unit}
    assert {line["PRIORITY"] for line in (run, stop, end)} == {"6"}
    assert {line["SYSLOG_IDENTIFIER"] for line in (run, stop, end)} == {"armrigd"}


def test_a_stop_in_a_run_ends_at_0_v_with_the_file_finished(rig: Rig, second: Rig) -> None:
    second.start()
    rig.drive()
    before = len(rig.said())

    rig.machine.systemctl("restart", rig.unit)

    assert _is_at_rest(rig)
    assert not list(rig.machine.path("/var/lib/armrig/recordings").glob("1-*.active"))
    wait_for(lambda: rig.phase() == "safe")
    rig.machine.systemctl("stop", rig.unit)
    assert not rig.machine.path("/run/armrig/1").exists()
    assert not [line for _, line in rig.said()[before:] if "estop" in line]
    assert second.phase() == "safe"
    second.machine.systemctl("stop", second.unit)


STOPPED = (
    "armrig: the service of rig 1 has stopped; `systemctl status armrigd@1`; what was recorded is "
    "in `armrig ls`\n"
)


@pytest.mark.parametrize("user", ["", "learner"])
def test_a_service_that_was_stopped_in_a_run_is_named(rig: Rig, user: str) -> None:
    machine = rig.machine
    machine.run("useradd", "--no-create-home", "-G", "armrig", "learner", check=False)
    rig.drive()
    before = len(rig.said())

    machine.systemctl("stop", rig.unit)

    done = machine.run("armrig", "status", user=user, check=False)
    assert (done.returncode, done.stderr) == (1, STOPPED)
    assert _errors(rig, before) == []


@pytest.mark.parametrize("user", ["", "learner"])
def test_the_doctor_judges_the_service_for_any_caller(rig: Rig, user: str) -> None:
    rig.machine.run("useradd", "--no-create-home", "-G", "armrig", "learner", check=False)

    said = rig.machine.run("armrig", "doctor", "--verbose", user=user, check=False).stdout

    assert said.startswith(f"good  daemon: rig 1 at {rig.endpoint}\n")
    assert f"good  SCHED_FIFO: the daemon has priority {PRIORITY}\n" in said
    assert "GiB free in /var/lib/armrig/recordings\n" in said
    assert "dialout" not in said


@pytest.mark.parametrize("whose", ["main_pid", "loop_pid"])
def test_a_process_that_is_killed_is_replaced(rig: Rig, whose: str) -> None:
    rig.drive()
    pid, restarts, before = rig.main_pid(), _restarts(rig), len(rig.said())

    rig.machine.run("kill", "-KILL", getattr(rig, whose)())
    took = wait_for(lambda: _restarts(rig) > restarts and rig.is_active(), RESTARTED_S)

    print(f"{whose} killed: served again after {took:.1f} s")
    assert _is_at_rest(rig)
    assert rig.main_pid() != pid
    assert any("estop: /run/rig1/tty is in ESTOP, 0 V" in line for _, line in rig.said()[before:])
    wait_for(lambda: rig.phase() in ("safe", "fault"))
    assert _is_at_rest(rig)


def test_a_hanging_service_or_loop_is_restarted_by_the_watchdog(rig: Rig, second: Rig) -> None:
    second.start()
    rigs = (rig, second)
    for each in rigs:
        each.drive()

    rig.machine.run("kill", "-STOP", rig.main_pid())
    second.machine.run("kill", "-STOP", second.loop_pid())
    took = [
        wait_for(lambda r=each: _restarts(r) == 1 and r.is_active(), RESTARTED_S) for each in rigs
    ]

    print(f"stood still: served again after {took[0]:.1f} s, {took[0] + took[1]:.1f} s")
    for each in rigs:
        assert _is_at_rest(each)
        wait_for(lambda r=each: r.phase() in ("safe", "fault"))
        log = each.machine.run("journalctl", "--no-pager", "-u", each.unit).stdout
        assert "Watchdog timeout" in log
    second.machine.systemctl("stop", second.unit)


def test_a_reload_applies_the_new_configuration_and_keeps_the_priority(rig: Rig) -> None:
    machine, path = rig.machine, Path("/etc/armrig/1.toml")
    before = machine.path(path).read_text()
    machine.write(path, before + "[limits]\nu_max_v = 4.5\n")
    try:
        rig.drive()
        machine.systemctl("reload", rig.unit)
        wait_for(lambda: any("group 3 has the rig; reload when" in line for _, line in rig.said()))
        assert rig.phase() == "active", rig.status()
        rig.armrig("stop")
        wait_for(lambda: rig.phase() == "safe")

        pid = rig.main_pid()
        machine.systemctl("reload", rig.unit)
        wait_for(lambda: rig.is_active() and rig.main_pid() not in ("0", pid))

        wait_for(lambda: rig.phase() == "safe")
        assert '"u_max":4.5' in rig.armrig("status", "--json")[1]
        assert "SCHED_FIFO" in machine.run("chrt", "-p", rig.loop_pid()).stdout
    finally:
        machine.write(path, before)


def test_a_service_is_not_restarted_after_five_failures_in_a_minute(rig: Rig) -> None:
    state = ""
    for _ in range(6):
        wait_for(lambda: rig.is_active() or state_of(rig) == "failed")
        state = state_of(rig)
        if state == "failed":
            break
        pid = rig.main_pid()
        rig.machine.run("kill", "-KILL", pid)
        wait_for(lambda p=pid: rig.main_pid() not in ("0", p) or state_of(rig) == "failed")

    assert state_of(rig) == "failed"
    assert _is_at_rest(rig)


def state_of(rig: Rig) -> str:
    """Return systemd's state of the unit."""
    return rig.machine.shown(rig.unit, "ActiveState")["ActiveState"]


def _refused(machine: Machine, rig: str) -> tuple[list[str], dict[str, str]]:
    """Start a service that cannot begin; return its lines, and how systemd has left it."""
    unit = f"armrigd@{rig}.service"
    before = len(machine.journal(unit))
    assert machine.systemctl("start", unit, check=False).returncode == 1
    lines = [f"{line['PRIORITY']} {line['MESSAGE']}" for line in machine.journal(unit)[before:]]
    return lines, machine.shown(unit, "ActiveState", "NRestarts", "ExecMainStatus")


GIVEN_UP = {"ActiveState": "failed", "NRestarts": "0", "ExecMainStatus": "78"}


def test_a_rig_without_a_configuration_is_refused_once(machine: Machine) -> None:
    lines, left = _refused(machine, "l")

    assert left == GIVEN_UP
    assert lines == [
        "3 /etc/armrig/l.toml: there is no such file; write it with at least [device] port; "
        "`armrigd config --example` prints all keys"
    ]


@pytest.mark.parametrize(
    ("text", "mode", "line"),
    [
        ("[device]\nport = 5\n", 0o644, r"3 /etc/armrig/3\.toml: device\.port = 5: expected `str`"),
        ("[device]\n", 0o600, r"3 /etc/armrig/3\.toml: Permission denied; let the daemon's user"),
        (
            '[device]\nport = "/etc/passwd"\n',
            0o644,
            r"3 /etc/passwd .*: it is no serial port; give",
        ),
        ('[device]\nport = "/dev/null"\n', 0o644, r"3 /dev/null .*: it is no serial port; give"),
        (
            '[device]\nport = "/dev/cpu_dma_latency"\n',
            0o644,
            r"3 /dev/cpu_dma_latency .*: not permitted; add this user to the group of the port",
        ),
    ],
)
def test_a_configuration_error_is_reported_in_one_line_without_a_restart(
    machine: Machine, text: str, mode: int, line: str
) -> None:
    machine.write(Path("/etc/armrig/3.toml"), text, mode)

    lines, left = _refused(machine, "3")

    assert left == GIVEN_UP
    errors = [said for said in lines if said.startswith("3 ")]
    assert len(errors) == 1, lines
    assert re.match(line, errors[0])


def test_a_folder_that_cannot_be_written_is_reported_at_the_start(rig: Rig) -> None:
    machine = rig.machine
    folder = "/srv/recordings"
    machine.run("mkdir", "-p", folder)
    drop_in = Path("/etc/systemd/system/armrigd@1.service.d/folder.conf")
    machine.write(drop_in, f"[Service]\nEnvironment=ARMRIG_RECORDING_DIRECTORY={folder}\n")
    machine.systemctl("daemon-reload")
    before = len(rig.said())
    try:
        machine.systemctl("restart", rig.unit)
        told = [line for priority, line in rig.said()[before:] if priority == "4"]
    finally:
        machine.path(drop_in).unlink()
        machine.systemctl("daemon-reload")
        machine.systemctl("restart", rig.unit)

    assert (
        f"nothing can be recorded: {folder}: not writable; `install -d -o armrig {folder}` and "
        "restart the daemon, or set [recording] directory"
    ) in told


def test_a_second_install_changes_nothing_and_status_reports_the_units(rig: Rig) -> None:
    machine, pid = rig.machine, rig.main_pid()

    again = machine.run("armrig", "service", "install", "--yes").stdout
    status = machine.run("armrig", "service", "status").stdout

    assert "write" not in again
    assert "replace" not in again
    assert "missing" not in status
    assert "rig 1: active: safe, nobody has it, does not start with the machine" in status
    assert rig.main_pid() == pid


def test_uninstalling_the_service_stops_the_rig_and_keeps_recordings(rig: Rig) -> None:
    machine = rig.machine
    rig.drive()
    machine.systemctl("enable", rig.unit)

    machine.run("armrig", "service", "uninstall", "--yes")

    assert _is_at_rest(rig)
    assert machine.systemctl("is-active", rig.unit, check=False).stdout == "inactive\n"
    assert machine.path("/etc/armrig/1.toml").exists()
    assert [*machine.path("/var/lib/armrig/recordings").glob("*.mcap")]
    machine.run("armrig", "service", "install", "--yes")
    rig.start()
