"""The reader of recordings: any file gives a recording without holes, or one line that says why."""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from io import BytesIO
from pathlib import Path
from random import Random
from typing import Any

import msgspec
import numpy as np
from armrig.recordings.files.loading import load
from armrig.recordings.recording import Recording
from armrig_core.errors import FileError
from armrig_core.recording_file.manifest import CALIBRATION, OUTCOME, RUN, Manifest, Outcome
from armrig_core.rig.calibration import Calibration
from armrig_core.telemetry import protobuf, telemetry
from armrig_core.telemetry.topics import topic
from mcap.writer import CompressionType, Writer

from tests.fuzz.mutation import mutated

N = 40
_MANIFEST = Manifest(
    **{"rig": "1", "run_id": "r", "experiment": "fuzz", "details": {"seed": 1}, "Ts": 0.01},
    **{"samples": N, "started": "2026-01-01T00:00:00+00:00", "clock_offset_ns": 10**18},
    **{"armrig": "0", "protocol": "1"},
)
_STREAMS = {
    "sample": protobuf.SAMPLE,
    "gap": protobuf.GAP,
    "event": protobuf.LOG,
    "timing": protobuf.TIMING,
    "clock": protobuf.CLOCK,
}


def recording(
    samples: Iterable[telemetry.Sample],
    compression: CompressionType = CompressionType.ZSTD,
    *,
    checked: bool,
    flush_every: int = 8,
) -> bytes:
    """Return a recording; without check sums a change goes as deep as it can."""
    out = BytesIO()
    writer = Writer(out, compression=compression, enable_crcs=checked, enable_data_crcs=checked)
    writer.start(profile="", library="armrig tests")
    writer.add_metadata(RUN, _MANIFEST.metadata())
    writer.add_attachment(0, 0, CALIBRATION, "application/json", msgspec.json.encode(Calibration()))
    channels = {}
    for stream, name in _STREAMS.items():
        schema = writer.register_schema(name, "protobuf", protobuf.descriptor_set(name))
        channels[stream] = writer.register_channel(topic("1", stream), "protobuf", schema)
    for sample in samples:
        k, t_ns = sample.k, sample.t_sched_ns
        writer.add_message(
            channels["sample"], t_ns, telemetry.encode_sample(sample), t_ns, k & 0xFFFFFFFF
        )
        if k % flush_every == flush_every - 1:
            for stream, data in _happened(k, t_ns):
                writer.add_message(channels[stream], t_ns, data, t_ns, k)
            writer.flush()
    writer.add_metadata(OUTCOME, Outcome(outcome="complete", samples=N, missing=0).metadata())
    writer.finish()
    return out.getvalue()


def _happened(k: int, t_ns: int) -> Iterator[tuple[str, bytes]]:
    """Give one message of each stream that is not a sample."""
    fields: dict[str, dict[str, Any]] = {
        "gap": {"k_first": k, "count": 1, "u_held_v": 1.0, "reason": "late"},
        "event": {"message": "hello"},
        "timing": {"t_host_ns": t_ns},
        "clock": {"t_host_ns": t_ns},
    }
    for stream, values in fields.items():
        yield stream, protobuf.message_class(_STREAMS[stream])(**values).SerializeToString()


def _at_rest(k: int) -> telemetry.Sample:
    t_ns = k * 10_000_000
    return telemetry.Sample(k, t_ns, t_ns + 5, k, 0.1, 0.2, 1.0, 1.0, 1, 2, 3)


def corpus() -> list[bytes]:
    """Return recordings in each form that the reader takes."""
    samples = [_at_rest(k) for k in range(N)]
    return [
        recording(samples, CompressionType.NONE, checked=False),
        recording(samples, checked=False),
        recording(samples, checked=True),
    ]


def in_one_line(err: Exception) -> None:
    """Assert that a person can read it."""
    assert "\n" not in str(err), str(err)


def used(found: Recording) -> None:
    """Use a recording as a user does; only documented results may come out."""
    assert np.all(np.diff(found.samples["k"].astype(np.int64)) > 0)
    for output in ("theta_1", "alpha"):
        try:
            found.dataset(output=output)
        except FileError as err:
            in_one_line(err)


def fuzz(most: int, seed: int) -> Counter[str]:
    """Load `most` files; return how many gave a recording, whole or cut, and how many none."""
    rng, files = Random(seed), corpus()
    weights = (6, 2, 2)
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="armrig-fuzz-", dir=in_memory()) as directory:
        path = Path(directory) / "run.mcap"
        for _ in range(most):
            path.write_bytes(mutated(rng.choices(files, weights)[0], rng, files))
            found["inputs"] += 1
            try:
                loaded = load(path)
            except FileError as err:
                in_one_line(err)
                found["refused"] += 1
                continue
            used(loaded)
            found["cut" if loaded.truncated else "whole"] += 1
            found["samples"] += loaded.samples.size
    return found


def in_memory() -> str | None:
    """Return a directory in memory, if there is one."""
    shared = "/dev/shm"
    return shared if os.access(shared, os.W_OK) else None
