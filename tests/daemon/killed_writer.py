"""Processes that record at 1 kHz and are killed at a random moment.

`python tests/daemon/killed_writer.py FOLDER N SEED` makes N of them, some side by side, and leaves
in FOLDER the recording of each and a ledger of what it had handed over and what was acknowledged.
"""

from __future__ import annotations

import mmap
import os
import random
import signal
import struct
import sys
import time
from pathlib import Path
from typing import NamedTuple, NoReturn

import armrig
from armrig_core.recording_file.manifest import CONFIG, INPUT, Manifest
from armrig_core.recording_file.recorder import ActiveRecording
from armrig_core.recording_file.unfinished import unfinished_files
from armrig_core.telemetry.telemetry import Outgoing, Sample, encode_sample
from armrig_daemon.service.host.startup_recovery import StartupRecovery

TS_NS = 1_000_000
SIDE_BY_SIDE = 4
LONGEST_S = 2.5
_N = 1_000_000
_LEDGER = struct.Struct("<QQ")


class Ledger(NamedTuple):
    """Progress of a process when it was killed."""

    handed: int
    """Samples that the recorder was given."""
    acknowledged: int
    """Samples reported as on the disk."""


class Killed(NamedTuple):
    """One process, and the state of its recording."""

    ledger: Ledger
    found: int
    """Samples in the file."""
    recovered: int
    """Samples in the file that was completed."""
    faults: tuple[str, ...]
    """Violations."""


def main() -> None:
    """Make the processes, and kill them."""
    folder, n, seed = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    rng = random.Random(seed)
    alive: dict[int, float] = {}
    begun = 0
    while begun < n or alive:
        if begun < n and len(alive) < SIDE_BY_SIDE:
            begins, told = os.pipe()
            pid = os.fork()
            if pid == 0:
                _write(folder, begun, told)
            os.close(told)
            os.read(begins, 1)
            os.close(begins)
            alive[pid] = time.monotonic() + rng.uniform(0, LONGEST_S)
            begun += 1
            continue
        first = min(alive, key=alive.__getitem__)
        time.sleep(max(0.0, alive.pop(first) - time.monotonic()))
        os.kill(first, signal.SIGKILL)
        os.waitpid(first, 0)


def judged(folder: Path) -> list[Killed]:
    """Judge the remaining files, and their recovery at the next start of a daemon.

    A process that was killed before its beginning leaves a file of 0 B.
    """
    left = {path: _loaded(path) for path in unfinished_files(folder, "1") if path.stat().st_size}
    next_start = StartupRecovery(folder, "1", lambda: None)
    next_start.start()
    next_start.join()
    return [_judged(path, found) for path, found in left.items()]


def _judged(path: Path, left: armrig.Recording | str) -> Killed:
    ledger = Ledger(*_LEDGER.unpack((path.parent / _ledger_name(path.name)).read_bytes()))
    whole = _loaded(path.with_suffix(""))
    if isinstance(left, str) or isinstance(whole, str):
        return Killed(ledger, 0, 0, (f"left: {left}; recovered: {whole}",))
    faults = []
    k = left.samples["k"].tolist()
    if k != list(range(len(k))):
        faults.append("what is there is no prefix without gaps")
    if len(k) < ledger.acknowledged:
        faults.append(f"{ledger.acknowledged - len(k)} acknowledged samples are lost")
    if whole.samples.tobytes() != left.samples.tobytes() or whole.truncated:
        faults.append("what was completed is not what was there")
    if path.exists():
        faults.append("what was left is still there")
    return Killed(ledger, len(k), int(whole.samples.size), tuple(faults))


def _loaded(path: Path) -> armrig.Recording | str:
    """Return a recording, or why it cannot be loaded."""
    try:
        return armrig.load(path)
    except Exception as err:
        return repr(err)


def _ledger_name(name: str) -> str:
    return name.partition(".")[0] + ".ledger"


def _write(folder: Path, number: int, told: int) -> NoReturn:
    """Report that the recording has begun; record a sample each ms until the end."""
    path = folder / f"1-run-20260101T000000-{number:08x}.mcap"
    with (folder / _ledger_name(path.name)).open("w+b") as file:
        file.truncate(_LEDGER.size)
        file.flush()
        ledger = mmap.mmap(file.fileno(), _LEDGER.size)  # its pages outlive us
    manifest = Manifest(
        **{"rig": "1", "run_id": f"{number:08x}", "experiment": "run", "Ts": TS_NS / 1e9},
        **{"samples": _N, "k_first": 0, "started": "2026-01-01T00:00:00+00:00"},
        **{"clock_offset_ns": 10**18, "armrig": "0", "protocol": "1"},
    )
    attachments = {CONFIG: b"{}", INPUT: b"u_v\n" + b"1.0\n" * 1000}
    begin_ns = time.monotonic_ns()
    recording = ActiveRecording.create(
        path, manifest, attachments, t_first_ns=begin_ns, changed=lambda: None
    )
    os.write(told, b"b")
    for k in range(_N):
        due_ns = begin_ns + k * TS_NS
        time.sleep(max(0.0, (due_ns - time.monotonic_ns()) / 1e9))
        host_ns = time.monotonic_ns()
        counts = host_ns % 65536, host_ns // 7 % 65536
        sample = Sample(k, due_ns, host_ns, k * 1000, 0.1, 0.2, 1.0, 1.0, *counts, 3)
        recording.add([Outgoing("sample", host_ns, due_ns, k, encode_sample(sample))])
        _LEDGER.pack_into(ledger, 0, k + 1, recording.synced)
    raise SystemExit("nobody killed us")


if __name__ == "__main__":
    main()
