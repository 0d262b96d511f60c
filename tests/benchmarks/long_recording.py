"""A recording of one long run at 1 kHz, by the daemon's own core, loop, emulator and recorder.

`python -m tests.benchmarks.long_recording FILE [--seconds 3600]` makes it. The loop runs in virtual
time, so an hour takes a few minutes. The service's recorder writes the records, and rewrites them
in full chunks as after any run. A daemon would refuse this length, so the order of the run goes to
the loop itself.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import armrig
import msgspec
import numpy as np
from armrig_core.calibration import Calibration
from armrig_core.codes import Ending
from armrig_core.manifest import CALIBRATION, CONFIG, INPUT, Manifest
from armrig_core.recording_file.outgoing import Outgoing
from armrig_core.recording_file.recorder import Recording
from armrig_core.telemetry import decode_sample
from armrig_core.volts import code_of
from armrig_daemon.config import Config, Device
from armrig_daemon.pipe import Answer, Record, Run, RunEnded, RunStarted, State
from armrig_daemon.service.protobuf_out import outgoing
from armrig_protocol.messages import SCHEMA_HASH, VERSION
from numpy.typing import NDArray

from tests.daemon.virtual_bench import LEASE, Bench

TS_US = 1000
_OFFSET_NS = 1_750_000_000_000_000_000
_TURN_MS = 1000.0  # virtual time between two looks at what the loop said
_QUEUED = 50  # batches that may wait for the writer


def main() -> None:
    """Make one file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--seconds", type=int, default=3600)
    parser.add_argument("--pacing", choices=("scheduled", "exchange"), default="scheduled")
    asked = parser.parse_args()
    began = time.monotonic()
    made = make(asked.file, asked.seconds, asked.pacing)
    size = asked.file.stat().st_size / 1e6
    sys.stdout.write(f"{made} samples, {size:.1f} MB, {time.monotonic() - began:.0f} s\n")


def make(path: Path, seconds: int, pacing: str = "scheduled") -> int:
    """Record a telegraph signal of so many seconds; return the number of samples."""
    u = armrig.telegraph(seconds * 1_000_000 // TS_US, 0.01, low=0.5, high=4.5, seed=1)
    config = Config(device=Device(baud=1_000_000))
    bench = Bench(config)
    bench.arm(ts_us=TS_US)
    bench.order(
        Run(
            order=99,
            lease=LEASE,
            n=0,
            run_id="r",
            codes=np.asarray([code_of(v) for v in u], "<u2").tobytes(),
            scheduled=pacing == "scheduled",
        )
    )
    recording: Recording | None = None
    count = first = 0
    for records in _turns(bench):
        for i, record in enumerate(records):
            if isinstance(record, RunStarted):
                recording = _begun(path, config, record, bench, u, pacing)
                first, records = record.k_first, records[i + 1 :]
                break
        if recording is None:
            continue
        made = [message for record in records if (message := _outgoing(record)) is not None]
        batch = [m for m in made if m.stream != "sample" or first <= m.sequence < first + u.size]
        count += sum(message.stream == "sample" for message in batch)
        recording.add(batch)
        while recording._queue.qsize() > _QUEUED:
            time.sleep(0.01)
        ended = [record for record in records if isinstance(record, RunEnded)]
        if ended:
            recording.finish(Ending(ended[0].outcome_code, ended[0].outcome))
            recording.join(30)
            if recording.error:
                raise SystemExit(recording.error)
            return count
    return count


def _turns(bench: Bench) -> Iterator[list[bytes | Record]]:
    while True:
        bench.records.clear()  # an hour of them is not needed
        bench.run_for(_TURN_MS)
        yield list(bench.records)


def _outgoing(record: bytes | Record) -> Outgoing | None:
    """Return a record as the service hands it to its recorder."""
    if isinstance(record, bytes):
        sample = decode_sample(record)
        if sample is None:
            raise SystemExit("a sample of another layout")
        return Outgoing("sample", sample.t_host_ns, sample.t_sched_ns, sample.k, record)
    if isinstance(record, RunStarted | RunEnded | Answer):
        return None
    return outgoing(record, _OFFSET_NS)


def _begun(
    path: Path,
    config: Config,
    started: RunStarted,
    bench: Bench,
    u: NDArray[np.float64],
    pacing: str,
) -> Recording:
    """Return the recording with the service's attachments."""
    state = bench.of(State)
    manifest = Manifest(
        rig="1",
        run_id=started.run_id,
        experiment="blackbox",
        details={"input": "telegraph", "a": 0.01, "low": 0.5, "high": 4.5, "seed": 1},
        Ts=TS_US / 1e6,
        samples=u.size,
        k_first=started.k_first,
        pacing=pacing,
        started="2026-01-01T00:00:00.000+00:00",
        clock_offset_ns=_OFFSET_NS,
        armrig="benchmark",
        protocol=f"{VERSION} {SCHEMA_HASH:08x}",
        device=state[-1].device if state else {"adc_bits": 10, "pwm_bits": 10},
    )
    attachments = {
        CONFIG: msgspec.json.encode(config),
        CALIBRATION: msgspec.json.encode(Calibration()),
        INPUT: "".join(["u_v\n", *(f"{volts!r}\n" for volts in u.tolist())]).encode(),
    }
    return Recording(
        path, manifest, attachments, t_first_ns=started.t_host_ns, changed=lambda: None
    )


if __name__ == "__main__":
    main()
