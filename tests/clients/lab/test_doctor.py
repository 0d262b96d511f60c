"""The doctor on hosts made of files: findings, their costs, and the remedies."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from armrig.cli import main
from armrig.cli.printing import fold
from armrig.lab import doctor
from armrig.lab.doctor import examine, is_well
from armrig.lab.host import Granted, HostCheck, InspectedHost, preemption, probe
from armrig_core.commands.commands import StatusReport
from msgspec.structs import replace

from tests.clients.fake_daemon import FakeDaemon

GRANTED: dict[str, Any] = {
    "fifo": True,
    "memory_lock": True,
    "is_root": False,
    "groups": frozenset({"student", "dialout"}),
    "cpus": 4,
    "recordings": Path("/data"),
    "free_bytes": 50 << 30,
}
GOOD = {
    "proc/sys/kernel/version": "#1 SMP PREEMPT_RT Debian 6.12.48-1",
    "proc/cmdline": "quiet",
    "proc/cpuinfo": "model name\t: a real one\nflags\t\t: fpu tsc\n",
    "proc/loadavg": "0.40 0.50 0.60 1/200 4711",
    "proc/stat": "cpu  100 0 100 9800 0 0 0 0 0 0\ncpu0 1 1 1 1 1 1 1 1 0 0",
    "proc/swaps": "Filename\tType\tSize\tUsed\tPriority\n",
    "proc/sys/kernel/sched_rt_runtime_us": "950000",
    "proc/sys/kernel/sched_rt_period_us": "1000000",
    "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "performance",
    "sys/devices/system/cpu/cpu0/cpuidle/state1/latency": "2",
    "sys/devices/system/cpu/cpu0/cpuidle/state1/name": "C1",
    "sys/devices/system/cpu/cpu0/cpuidle/state1/disable": "0",
    "sys/bus/usb-serial/devices/ttyUSB0/latency_timer": "1",
    "dev/cpu_dma_latency": "",
    "proc/48/stat": "48 (kworker/u9:0-events) I 2 0 0 0 -1 69238880 0 0 0 0 0 0 0 0 -80 0 1 0",
    "proc/49/stat": "49 (a (b) c) S 2 0 0 0 -1 69238880 0 0 0 0 0 0 0 0 20 0 1 0",
}


def host(root: Path, files: dict[str, str] | None = None, **granted: Any) -> InspectedHost:
    """Return a good host except for these files and grants."""
    for name, content in (GOOD | (files or {})).items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    return InspectedHost(root=root, granted=Granted(**(GRANTED | granted)))


def found(findings: list[HostCheck], name: str) -> HostCheck:
    (finding,) = (f for f in findings if f.name == name)
    return finding


def test_a_suitable_host_has_only_good_findings(tmp_path: Path) -> None:
    findings = examine(host(tmp_path))

    assert {f.level for f in findings} == {"good"}
    assert len(findings) == 13
    assert found(findings, "load").found == "0.4 on 4 processors"
    full = examine(host(tmp_path, {"proc/loadavg": "4.00 1 1 1/2 3"}))
    assert str(found(full, "load")) == "good  load: 4 on 4 processors"
    assert all("\n" not in str(f) and not f.mend for f in findings)


@pytest.mark.parametrize(
    ("name", "files", "granted", "words", "way_out"),
    [
        ("mlockall", {}, {"memory_lock": False}, "not allowed", "memlock unlimited"),
        (
            "preemption",
            {
                "proc/sys/kernel/version": "#1 SMP PREEMPT_DYNAMIC Debian",
                "sys/kernel/debug/sched/preempt": "none (voluntary) full lazy",
            },
            {},
            "voluntary",
            "preempt=full",
        ),
        (
            "virtual machine",
            {"proc/stat": "cpu  100 0 100 8800 0 0 0 1000 0 0"},
            {},
            "10.0%",
            "real hardware",
        ),
        ("serial ports", {}, {"groups": frozenset({"student"})}, "dialout", "usermod -aG dialout"),
    ],
    ids=lambda value: value if isinstance(value, str) and value[:1] != "#" else "",
)
def test_each_cause_of_poor_timing_is_reported_with_the_remedy(
    tmp_path: Path,
    name: str,
    files: dict[str, str],
    granted: dict[str, Any],
    words: str,
    way_out: str,
) -> None:
    findings = examine(host(tmp_path, files, **granted))

    assert [f.name for f in findings if f.level == "bad"] == [name]
    finding = found(findings, name)
    assert words in finding.found
    assert finding.costs
    assert way_out in finding.mend
    assert not is_well(findings)


def test_a_finding_without_a_remedy_on_this_host_is_a_note(tmp_path: Path) -> None:
    files = {
        "proc/cpuinfo": "flags\t\t: fpu hypervisor tsc\n",
        "proc/sys/kernel/version": "#1 SMP PREEMPT_DYNAMIC @0",
    }

    findings = examine(host(tmp_path, files))

    assert [f.name for f in findings if f.level == "note"] == ["preemption", "virtual machine"]
    assert is_well(findings)


def test_a_host_without_information_is_not_an_error(tmp_path: Path) -> None:
    findings = examine(InspectedHost(root=tmp_path, granted=Granted(**GRANTED)))

    assert {f.name for f in findings if f.level == "note"} == {
        *("preemption", "kernel workers", "RT throttling"),
    }
    assert is_well(findings)


def test_a_deep_idle_state_is_reported_unless_the_loop_can_prevent_it(tmp_path: Path) -> None:
    """The loop writes /dev/cpu_dma_latency while it runs."""
    state = "sys/devices/system/cpu/cpu1/cpuidle/state3"
    made = host(tmp_path, {f"{state}/latency": "133", f"{state}/name": "C6"})

    assert found(examine(made), "idle states").level == "good"

    (tmp_path / "dev/cpu_dma_latency").unlink()
    assert found(examine(made), "idle states").level == "bad"


def test_a_disabled_idle_state_is_not_reported(tmp_path: Path) -> None:
    state = "sys/devices/system/cpu/cpu0/cpuidle/state1"
    made = host(tmp_path, {f"{state}/latency": "300", f"{state}/disable": "1"})
    (tmp_path / "dev/cpu_dma_latency").unlink()

    assert found(examine(made), "idle states").found == "waking takes at most 0 µs"


@pytest.mark.parametrize(
    ("files", "model"),
    [
        ({"sys/kernel/realtime": "1"}, "PREEMPT_RT"),
        ({"sys/kernel/debug/sched/preempt": "none voluntary (full) lazy"}, "full"),
        ({"proc/cmdline": "quiet preempt=none ro"}, "none"),
        ({"proc/sys/kernel/version": "#1 SMP PREEMPT 2024"}, "full"),
        ({"proc/sys/kernel/version": "#1 SMP 2024"}, "unknown"),
        ({}, "unknown"),
    ],
)
def test_the_preemption_model_is_read_from_the_first_available_source(
    tmp_path: Path, files: dict[str, str], model: str
) -> None:
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content)

    assert preemption(tmp_path) == model


def test_the_free_space_is_that_of_the_nearest_folder_that_exists(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Path] = []

    def disk_usage(path: Path) -> SimpleNamespace:
        asked.append(path)
        return SimpleNamespace(total=7, used=4, free=3)

    monkeypatch.setattr(shutil, "disk_usage", disk_usage)

    granted = probe(tmp_path / "not" / "made")

    assert granted.free_bytes == 3
    assert granted.recordings == tmp_path / "not" / "made"
    assert asked == [tmp_path]


def test_a_brief_result_has_few_lines_and_the_remedies_of_an_ordinary_laptop(
    tmp_path: Path,
) -> None:
    files = {
        "sys/devices/system/cpu/cpu1/cpufreq/scaling_governor": "powersave",
        "sys/kernel/debug/sched/preempt": "none (voluntary) full lazy",
        "proc/sys/kernel/version": "#1 SMP PREEMPT_DYNAMIC Debian",
    }
    laptop: dict[str, Any] = {"fifo": False, "memory_lock": False}

    few = doctor.brief(examine(host(tmp_path, files, **laptop)))
    many = doctor.brief(examine(host(tmp_path, files, **laptop, groups=frozenset({"student"}))))

    assert few.startswith("4 of 13 checks found an effect on the timing\nbad   SCHED_FIFO: not")
    assert "LimitMEMLOCK=infinity" in few
    assert len(fold(few, 80).splitlines()) < 14
    assert "LimitMEMLOCK" not in many
    assert len(fold(many, 80).splitlines()) < 14
    assert many.splitlines()[-1].startswith("good  idle states, ")


@pytest.mark.parametrize(("fifo", "code"), [(True, 0), (False, 1)])
def test_the_exit_code_is_0_only_if_all_findings_are_good(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    fifo: bool,
    code: int,
) -> None:
    findings = examine(host(tmp_path, fifo=fifo))
    monkeypatch.setattr(doctor, "doctor", lambda *_: findings)

    assert main(["doctor"]) == code
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{code or 'none'} of 13 checks found an effect on the timing"
    assert lines[1].startswith("good  SCHED_FIFO, mlockall" if fifo else "bad   SCHED_FIFO: not")

    assert main(["doctor", "-v"]) == code
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(findings)
    assert lines[0].startswith("good  SCHED_FIFO" if fifo else "bad   SCHED_FIFO")

    assert main(["doctor", "--json"]) == code
    said = json.loads(capsys.readouterr().out)
    assert [f["level"] for f in said].count("bad") == code


def test_the_doctor_examines_any_host() -> None:
    assert len(doctor.doctor()) >= 12


GRANTED_TO_DAEMON: dict[str, Any] = {
    "fifo": 80,
    "mlockall": True,
    "cpu": None,
    "awake": True,
    "refused": [],
}
REFUSED = [
    "priority 80 (it is 1; LimitRTPRIO= of the unit has no effect)",
    "mlockall (LimitMEMLOCK= of the unit has no effect)",
    "/dev/cpu_dma_latency (udev has not given it)",
]
NOBODY: dict[str, Any] = {
    "fifo": False,
    "memory_lock": False,
    "groups": frozenset({"student", "armrig"}),
}
"""Permissions of a student without a daemon."""


def daemon(**host: Any) -> StatusReport:
    """Return the status of a daemon that was granted all but this."""
    return replace(FakeDaemon("there").status(), host=GRANTED_TO_DAEMON | host)


def test_a_daemon_that_answers_is_judged_and_not_the_calling_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A student has no permission and must not join the group that opens the port."""
    monkeypatch.setattr(os, "access", lambda *_: False)
    deep = {"sys/devices/system/cpu/cpu1/cpuidle/state3/latency": "133"}
    made = host(tmp_path, deep, **NOBODY)

    findings = examine(dataclasses.replace(made, daemon=daemon()))

    assert {f.level for f in findings} == {"good"}
    assert str(findings[0]) == "good  daemon: rig 1 at there"
    assert found(findings, "SCHED_FIFO").found == "the daemon has priority 80"
    assert "serial ports" not in {f.name for f in findings}
    assert not [f for f in findings if "dialout" in str(f)]


def test_the_refused_requests_of_the_daemon_are_reported_to_root_too(tmp_path: Path) -> None:
    deep = {"sys/devices/system/cpu/cpu1/cpuidle/state3/latency": "133"}
    made = host(tmp_path, deep, is_root=True)

    findings = examine(
        dataclasses.replace(
            made, daemon=daemon(fifo=1, mlockall=False, awake=False, refused=REFUSED)
        )
    )

    fifo, memory, latency = (
        found(findings, name) for name in ("SCHED_FIFO", "mlockall", "idle states")
    )
    assert (fifo.level, fifo.found) == ("note", "the daemon has priority 1")
    assert fifo.mend == "it is 1; LimitRTPRIO= of the unit has no effect"
    assert (memory.level, memory.mend) == ("bad", "LimitMEMLOCK= of the unit has no effect")
    assert (latency.level, latency.mend.partition(",")[0]) == ("bad", "udev has not given it")
    none = examine(dataclasses.replace(made, daemon=daemon(fifo=0)))
    assert found(none, "SCHED_FIFO").mend == "[timing] priority is 0"


def test_the_permissions_of_a_stopped_service_are_not_judged(tmp_path: Path) -> None:
    made = host(tmp_path, **NOBODY)

    findings = examine(dataclasses.replace(made, silent="the service of rig 1 has stopped"))

    assert is_well(findings)
    assert str(findings[0]).endswith("; the service of rig 1 has stopped")
    left_out = {"SCHED_FIFO", "mlockall", "serial ports"}
    assert not left_out & {f.name for f in findings}


def test_the_doctor_asks_the_daemon_of_this_machine(tmp_path: Path) -> None:
    with FakeDaemon(f"unixsock-stream/{tmp_path}/1.sock") as asked:
        findings = doctor.doctor("1", asked.endpoint)

    assert found(findings, "daemon").found == f"rig 1 at {asked.endpoint}"
    assert found(findings, "SCHED_FIFO").mend == "set LimitRTPRIO="
    with pytest.raises(
        ValueError, match="the doctor examines only this machine; give unixsock-stream/PATH"
    ):
        doctor.doctor("1", "tls/lab:7447")


@pytest.mark.parametrize(
    ("runtime", "period", "level", "words"),
    [
        ("-1", "1000000", "good", "off"),
        ("0", "1000000", "bad", "may use 0% of a processor"),
        ("450000", "500000", "good", "above 90% of a processor"),
        ("449999", "500000", "bad", "may use 90% of a processor"),
        ("950000", "", "bad", "may use 0% of a processor"),
        ("none", "1000000", "note", "not reported by this kernel"),
    ],
)
def test_the_share_of_real_time_programs_is_judged(
    tmp_path: Path, runtime: str, period: str, level: str, words: str
) -> None:
    kernel = "proc/sys/kernel/sched_rt"
    files = {f"{kernel}_runtime_us": runtime, f"{kernel}_period_us": period}

    finding = found(examine(host(tmp_path, files)), "RT throttling")

    assert finding.level == level
    assert words in finding.found
    assert ("sched_rt_runtime_us" in finding.mend) == (level == "bad")


def test_the_module_of_a_host_does_not_load_zenoh() -> None:
    program = "import sys, armrig.lab.host; sys.exit('zenoh' in sys.modules)"

    done = subprocess.run([sys.executable, "-c", program], check=False)

    assert done.returncode == 0
