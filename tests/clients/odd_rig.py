"""A rig, a recording and a host that are unlike those of other tests; what is said of them.

Several of each kind, of unequal length and in no order; nothing is at its default.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import numpy as np
from armrig.dashboard.experiments import ExperimentRequest, previewed
from armrig.lab.doctor import examine
from armrig.lab.host import Granted, InspectedHost
from armrig_core.commands.commands import LastRun, StatusReport
from armrig_core.recording_file.manifest import Outcome
from armrig_core.rig.calibration import Calibration, Potentiometer
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Flag

from tests.clients.made_recordings import manifest, recorded, written

TS_NS = 40_000_000
K_FIRST = 1234
CALIBRATION = Calibration(
    theta_1=Potentiometer(zero_counts=40_000.0, rad_per_count=-9.5e-5),
    alpha=Potentiometer(zero_counts=33_000.0, rad_per_count=-8e-5, wraps=False),
)
"""Calibration of potentiometers that are turned the other way."""


def show(value: Any) -> None:
    """Print a value as JSON."""
    print(msgspec.json.encode(value).decode())


def odd_sample(i: int) -> Sample:
    """Return row i of the recording: the chassis turns back, into the dead band at row 40."""
    k, due = K_FIRST + i, 7_000_000_000 + i * TS_NS
    theta_counts = (30_000 + 640 * i) // 64 * 64
    hidden = theta_counts >= 65_472 - 64 * 150
    counts = 0 if hidden else theta_counts, 33_024 + 64 * (i % 7)
    angles = CALIBRATION.theta_1.value(counts[0]), CALIBRATION.alpha.value(counts[1])
    return Sample(
        k=k,
        t_sched_ns=due,
        t_host_ns=due + 1000 * (40 + (i * 37) % 400),
        t_device_us=2**32 - 500_000 + i * TS_NS // 1000 + i % 3,
        value_0=float("nan") if hidden else angles[0],
        value_1=angles[1],
        u_cmd_v=0.7 + 0.6 * (i // 5 % 4),
        u_applied_v=0.75 + 0.6 * (i // 5 % 4),
        counts_0=counts[0],
        counts_1=counts[1],
        flags=int(Flag.RUN | (Flag.ADC0_RAIL if hidden else 0)),
    )


def odd_gap(i: int, count: int, reason: str) -> Any:
    """Return a gap record."""
    return protobuf.message_class(protobuf.GAP)(
        k_first=K_FIRST + i,
        count=count,
        t_from_ns=odd_sample(i).t_sched_ns,
        t_to_ns=odd_sample(i + count).t_sched_ns,
        u_held_v=odd_sample(i - 1).u_applied_v,
        reason=reason,
    )


def odd_recording(folder: str) -> Path:
    """Write a recording that ended early, with two holes, the first of them near its start."""
    messages: list[Any] = []
    for i in range(90):
        if i in (3, 50):
            messages.append(odd_gap(i, 1 if i == 3 else 4, "overrun" if i == 3 else "link silent"))
        if i != 3 and not 50 <= i < 54:
            messages.append(odd_sample(i))
    about = manifest(
        rig="lab-2",
        run_id="ab12",
        experiment="staircase-late",
        pacing="exchange",
        Ts=TS_NS / 1e9,
        samples=200,
        k_first=K_FIRST,
        started="2026-03-01T23:30:00-05:00",
        details={"levels": 4},
    )
    ended = Outcome(outcome="stopped by Ada", samples=85, missing=5)
    data = recorded(messages, manifest=about, outcome=ended, calibration=CALIBRATION)
    return written(Path(folder), data, "lab-2-odd.mcap")


def odd_run(**changes: Any) -> LastRun:
    """Return a run in progress."""
    fields: dict[str, Any] = {"run_id": "ab12", "recording": "/data/a.b.mcap.active"}
    fields |= {"finished": False, "samples": 85, "synced": 70, "outcome": ""}
    return LastRun(**(fields | changes))


def odd_status(**changes: Any) -> StatusReport:
    """Return the status of a rig with narrow limits, which a client drives."""
    fields: dict[str, Any] = {
        "rig": "lab-2",
        "version": "0.0.9",
        "phase": "active",
        "reason": "",
        "motor": "driven",
        "owner": "Ada",
        "Ts": 0.04,
        "u_min": 0.25,
        "u_max": 3.5,
        "endpoint": "tls/lab:7447",
        "device": {"uid": "07", "firmware": 3},
        "host": {"fifo": 70, "refused": ["mlockall", "cpu_dma_latency"]},
        "last_run": odd_run(),
        "recordings": "/data",
        "calibration": "measured",
        "arm_removed": True,
    }
    return StatusReport(**(fields | changes))


HOST = {
    "proc/sys/kernel/version": "#1 SMP PREEMPT_DYNAMIC Debian 6.12",
    "sys/kernel/debug/sched/preempt": "none voluntary full (lazy)",
    "proc/cpuinfo": "model name\t: an odd one\nflags\t\t: fpu hypervisor\n",
    "proc/loadavg": "2.50 9.00 9.00 1/200 4711",
    "proc/stat": "cpu  100 20 300 9000 40 5 6 29 700 0\ncpu0 1 1 1 1 1 1 1 900 0 0",
    "proc/swaps": "Filename Type Size Used Priority\n/a p 99999 1024 -2\n/b file 9999 2048 -3\n",
    "proc/self/timerslack_ns": "1500",
    "proc/sys/kernel/sched_rt_runtime_us": "180000",
    "proc/sys/kernel/sched_rt_period_us": "200000",
    "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "schedutil",
    "sys/devices/system/cpu/cpu1/cpufreq/scaling_governor": "performance",
    "sys/devices/system/cpu/cpu0/cpuidle/state3/latency": "90",
    "sys/devices/system/cpu/cpu0/cpuidle/state3/name": "C7",
    "sys/devices/system/cpu/cpu1/cpuidle/state1/latency": "21",
    "sys/devices/system/cpu/cpu1/cpuidle/state1/name": "C1E",
    "sys/devices/system/cpu/cpu10/cpuidle/state2/latency": "500",
    "sys/devices/system/cpu/cpu10/cpuidle/state2/disable": "1",
    "sys/bus/usb-serial/devices/ttyUSB3/latency_timer": "2",
    "sys/bus/usb-serial/devices/ttyUSB1/latency_timer": "1",
    "proc/48/stat": "48 (kworker/u9:0-events) I 2 0 0 0 -1 69 0 0 0 0 0 0 0 0 0 20 0 1 0",
    "proc/49/stat": "49 (kworker/u8:0) I) 2 0 0 0 -1 69 0 0 0 0 0 0 0 0 0 20 0 1 0",
    "proc/50/stat": "50 (kworker/u8:1-x) I 2 0 0 0 -1 69 0 0 0 0 0 0 0 0 -80 0 1 0",
    "proc/51/stat": "51 (kworker/0:1) I 2 0 0 0 -1 69 0 0 0 0 0 0 0 0 20 0 1 0",
}


def odd_host() -> None:
    """Print the doctor's output for a host of two processors with several of everything."""
    with TemporaryDirectory() as folder:
        print(*examine(_host(Path(folder))), sep="\n")


def _host(root: Path) -> InspectedHost:
    for name, content in HOST.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(content)
    granted = Granted(
        fifo=False,
        memory_lock=True,
        is_root=False,
        groups=frozenset({"uucp", "dialout", "x"}),
        cpus=2,
        recordings=Path("/data"),
        free_bytes=(1 << 30) - 1,
    )
    return InspectedHost(root=root, granted=granted)


def odd_plan(**changes: Any) -> Any:
    """Return a plan that plays a ramp."""
    from armrig.rig.collection import Plan as Collection

    fields: dict[str, Any] = {"experiment": "ramp", "details": {}, "seconds": 0.35, "Ts": 0.04}
    fields |= {"make": lambda N, Ts: Ts * np.arange(N or 7), "pacing": "exchange", "owner": "Ada"}
    return Collection(**(fields | changes))


def odd_report() -> Any:
    """Return a report of a second's timing whose numbers all differ."""
    report = protobuf.message_class(protobuf.TIMING)(t_host_ns=1, cpu_pressure_percent=7.5)
    parts = report.wake_lateness_us, report.device_tick_error_us, report.link_round_trip_us
    for i, part in enumerate(parts):
        part.p50, part.p99, part.max, part.n = 10 * i + 1.5, 10 * i + 3, 10 * i + 5, 100
    return report


def odd_preview(status: StatusReport | None = None, **how: Any) -> None:
    """Print the page's preview of an experiment."""
    show(previewed(ExperimentRequest(**({"low": 0.5, "high": 3.0} | how)), status or odd_status()))
