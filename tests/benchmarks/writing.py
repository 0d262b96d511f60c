"""Cost of the recorder for a message, compared with the bare MCAP writer with the same flushes.

`python -m tests.benchmarks.writing [--n 100000]`; processor time, in turn, the least of three.
`recorder` is a file as the daemon writes it. `once more` is the same file rewritten in full chunks,
as after the run. `handed over` is both, with the queue to the writer's thread, message by message.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from armrig_core import protobuf
from armrig_core.codes import COMPLETE
from armrig_core.manifest import Manifest, Outcome
from armrig_core.recording_file.outgoing import Outgoing
from armrig_core.recording_file.recorder import Recording
from armrig_core.recording_file.recording_part import CHUNK_BYTES, Part
from armrig_core.recording_file.rewriting import compact
from armrig_core.telemetry import Sample, encode_sample
from mcap.writer import CompressionType, Writer

_FLUSH = 100  # samples, ten times a second at 1 kHz
_ROUNDS = 3
_QUEUED = 1_000  # batches that may wait for the writer


def main() -> None:
    """Write the same samples both ways."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=100_000)
    n = parser.parse_args().n
    samples = [_sample(k) for k in range(n)]
    took: dict[str, list[float]] = {name: [] for name in WAYS}
    for _ in range(_ROUNDS):
        with tempfile.TemporaryDirectory(prefix="armrig-writing-") as folder:
            for name, way in WAYS.items():
                began = time.process_time()
                way(Path(folder), samples)
                took[name].append(time.process_time() - began)
    bare = min(took["bare"])
    for name, times in took.items():
        print(f"{name}: {min(times) / n * 1e6:.2f} us a message, {min(times) / bare:.2f} times")


def _sample(k: int) -> Outgoing:
    t_ns, noise = k * 1_000_000, (k * 2_654_435_761) % 2**32
    readings = noise % 65536, noise // 65536
    data = encode_sample(Sample(k, t_ns, t_ns + 5, k, noise, 0.2, 1.0, 1.0, *readings, 3))
    return Outgoing("sample", t_ns + 5, t_ns, k, data)


def _bare(folder: Path, samples: list[Outgoing]) -> None:
    with (folder / "bare.mcap").open("wb") as file:
        writer = Writer(
            file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        writer.start()
        name = protobuf.SAMPLE
        schema = writer.register_schema(name, "protobuf", protobuf.descriptor_set(name))
        channel = writer.register_channel("/rig/1/sample", "protobuf", schema)
        for i, m in enumerate(samples, 1):
            writer.add_message(channel, m.t_host_ns, m.data, m.t_sched_ns, m.sequence)
            if i % _FLUSH == 0:
                writer.flush()
        writer.finish()


def _recorder(folder: Path, samples: list[Outgoing]) -> None:
    part = Part(folder / "part.mcap", _manifest(len(samples)), {}, 0)
    for i, message in enumerate(samples, 1):
        part.add(message)
        if i % _FLUSH == 0:
            part.flush()
    part.finish(Outcome(outcome="complete", samples=part.samples, missing=0))
    part.name()


def _once_more(folder: Path, _samples: list[Outgoing]) -> None:
    compact(folder / "part.mcap", folder / "compact.mcap")


def _handed_over(folder: Path, samples: list[Outgoing]) -> None:
    manifest = _manifest(len(samples))
    path = folder / "handed.mcap"
    recording = Recording(path, manifest, {}, t_first_ns=0, changed=lambda: None)
    for message in samples:
        recording.add([message])
        while recording._queue.qsize() > _QUEUED:
            time.sleep(0.001)
    recording.finish(COMPLETE)
    recording.join(30)
    if recording.error or recording.dropped:
        raise SystemExit(recording.error or "messages were dropped")


def _manifest(n: int) -> Manifest:
    return Manifest(
        rig="1",
        run_id="r",
        experiment="run",
        Ts=0.001,
        samples=n,
        k_first=0,
        started="2026-01-01T00:00:00+00:00",
        clock_offset_ns=0,
        armrig="benchmark",
        protocol="1",
    )


WAYS: dict[str, Callable[[Path, list[Outgoing]], None]] = {
    "bare": _bare,
    "recorder": _recorder,
    "once more": _once_more,
    "handed over": _handed_over,
}


if __name__ == "__main__":
    main()
