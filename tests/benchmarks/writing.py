"""What the recorder costs a message, against the bare MCAP writer with the same flushes.

`python tests/benchmarks/writing.py [--n 100000]`; processor time, in turn, the least of three.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from armrig_core import protobuf
from armrig_core.manifest import Manifest, Outcome
from armrig_core.telemetry import Sample, encode_sample
from armrig_daemon.service.protobuf_out import Outgoing
from armrig_daemon.service.recording_part import CHUNK, Part
from mcap.writer import CompressionType, Writer

_FLUSH = 100  # samples, ten times a second at 1 kHz
_ROUNDS = 3


def main() -> None:
    """Write the same samples both ways."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=100_000)
    n = parser.parse_args().n
    samples = [_sample(k) for k in range(n)]
    took: dict[str, list[float]] = {"bare": [], "recorder": []}
    with tempfile.TemporaryDirectory(prefix="armrig-writing-") as name:
        for i in range(_ROUNDS):
            took["bare"].append(_timed(lambda i=i: _bare(Path(name) / f"b{i}", samples)))
            took["recorder"].append(
                _timed(lambda i=i: _recorder(Path(name) / f"r{i}.mcap", samples))
            )
    bare, ours = (min(took[way]) / n * 1e6 for way in ("bare", "recorder"))
    print(f"a message: bare writer {bare:.2f} us, recorder {ours:.2f} us: {ours / bare:.2f} times")


def _sample(k: int) -> Outgoing:
    t_ns, noise = k * 1_000_000, (k * 2_654_435_761) % 2**32
    readings = noise % 65536, noise // 65536
    data = encode_sample(Sample(k, t_ns, t_ns + 5, k, noise, 0.2, 1.0, 1.0, *readings, 3))
    return Outgoing("sample", t_ns + 5, t_ns, k, data)


def _timed(work: Callable[[], None]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def _bare(path: Path, samples: list[Outgoing]) -> None:
    with path.open("wb") as file:
        writer = Writer(
            file, chunk_size=CHUNK, compression=CompressionType.ZSTD, enable_data_crcs=True
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


def _recorder(path: Path, samples: list[Outgoing]) -> None:
    manifest = Manifest(
        rig="1",
        run_id="r",
        experiment="run",
        Ts=0.001,
        samples=len(samples),
        k_first=0,
        started="2026-01-01T00:00:00+00:00",
        clock_offset_ns=0,
        armrig="benchmark",
        protocol="1",
    )
    part = Part(path, manifest, {}, 0)
    for i, message in enumerate(samples, 1):
        part.add(message)
        if i % _FLUSH == 0:
            part.flush()
    part.finish(Outcome(outcome="complete", samples=part.samples, missing=0))
    part.name()


if __name__ == "__main__":
    main()
