"""Files made to cost memory: each is loaded in a process of its own, whose memory is watched."""

from __future__ import annotations

import struct
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import zstandard
from armrig_core.recording_file import budget, file_records
from armrig_core.recording_file.file_records import MAGIC
from armrig_core.recording_file.manifest import OUTCOME
from armrig_core.telemetry import protobuf
from mcap.opcode import Opcode

from tests.fuzz.cuts import edges, noisy
from tests.fuzz.files import in_memory, recording

MOST_MIB = 64.0
"""Memory that reading a hostile file may need, in MiB resident."""
_LOAD = """
import sys
import armrig.recordings.files.loading
import armrig.recordings.recording
# Not getrusage: its maximum is inherited from who started us.
peak = lambda: int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0]) / 1024
armrig.recordings.files.loading.load(sys.argv[1])  # an honest one: what reading costs anyway
before = peak()
try:
    armrig.recordings.files.loading.load(sys.argv[2])
except armrig.FileError:
    pass
print(before, peak() - before)
"""


def _record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def _chunk(packed: bytes, size: int) -> bytes:
    head = struct.pack("<QQQII", 0, 0, size, 0, 4) + b"zstd" + struct.pack("<Q", len(packed))
    return _record(0x06, head + packed)


def _text(text: bytes) -> bytes:
    return struct.pack("<I", len(text)) + text


def _gigabyte() -> bytes:
    """Return a chunk of zeros that declares 1 MiB and unpacks to 1 GiB."""
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    block = bytes(1 << 20)
    packed = b"".join([*(packer.compress(block) for _ in range(1024)), packer.flush()])
    return _chunk(packed, 1 << 20)


def _full_chunks() -> bytes:
    """Return chunks of the maximum size, of foreign messages."""
    message = _record(0x05, struct.pack("<HIQQ", 999, 0, 0, 0) + bytes(1000))
    data = message * (file_records.CHUNK_LIMIT // len(message))
    return _chunk(zstandard.compress(data), len(data)) * 12


def _long_claims() -> bytes:
    """Return records that claim to be longer than any memory."""
    return struct.pack("<BQ", 0x06, 2**62)


def _metadata() -> bytes:
    """Return metadata of 8 MB in short entries, under a name that is kept, and under others'."""
    entries = b"".join(_text(b"%07d" % i) + _text(b"") for i in range(500_000))
    return _record(0x0C, _text(OUTCOME.encode()) + _text(entries)) * 2 + _record(
        0x0C, _text(b"theirs") + _text(entries)
    )


def _messages(stream: str, name: str, **fields: object) -> Callable[[], bytes]:
    """Return what makes messages that are kept: 8 MiB of them in one small chunk."""

    def made() -> bytes:
        schema = _record(0x03, struct.pack("<H", 9) + _text(name.encode()) + bytes(8))
        channel = struct.pack("<HH", 9, 9) + _text(f"/rig/1/{stream}".encode()) + bytes(8)
        message = protobuf.message_class(name)(**fields).SerializeToString()
        one = _record(0x05, struct.pack("<HIQQ", 9, 0, 0, 0) + message)
        data = one * (file_records.CHUNK_LIMIT // len(one))
        return schema + _record(0x04, channel) + _chunk(zstandard.compress(data), len(data)) * 7

    return made


def _timing() -> dict[str, object]:
    """Return a full report: nothing costs more for its length."""
    kind = protobuf.message_class(protobuf.TIMING)
    of = {"p50": 1.0, "p90": 1.0, "p99": 1.0, "p999": 1.0, "max": 1.0, "n": 1}
    names = [field.name for field in kind.DESCRIPTOR.fields if field.message_type]
    return {"t_host_ns": 1, **dict.fromkeys(names, of)}


def _attachments() -> bytes:
    """Return attachments of 8 MB under a name that is kept."""
    body = bytes(16) + _text(b"config.json") + _text(b"application/json")
    body += struct.pack("<Q", 8_000_000) + bytes(8_000_000) + bytes(4)
    return _record(0x09, body) * 5


BOMBS: dict[str, Callable[[], bytes]] = {
    "1 GiB in one chunk": _gigabyte,
    "full chunks": _full_chunks,
    "records without end": _long_claims,
    "metadata": _metadata,
    "attachments": _attachments,
    "events": _messages("event", protobuf.LOG, message="x"),
    "gaps": _messages("gap", protobuf.GAP, k_first=1, count=1),
    "timing": _messages("timing", protobuf.TIMING, **_timing()),
    "clocks": _messages("clock", protobuf.CLOCK, t_host_ns=1),
    "states": _messages("state", protobuf.STATE, phase="safe"),
}


def cost_mib(bomb: bytes, directory: Path, *, alone: bool = False) -> float:
    """Return the additional memory of a process that loads a file with a bomb at its end.

    Parameters
    ----------
    alone : bool
        The file contains only the bomb, so that it yields nothing.
    """
    honest, path = directory / "honest.mcap", directory / "bomb.mcap"
    data = recording(noisy(2000, 1), checked=True)
    honest.write_bytes(data)
    edge = max(at for at in edges(data) if data[at] == Opcode.METADATA)  # that of the outcome
    path.write_bytes(data[: len(MAGIC) if alone else edge] + bomb)
    done = subprocess.run(
        [sys.executable, "-c", _LOAD, honest, path], capture_output=True, text=True, check=True
    )
    return float(done.stdout.split()[1])


def fuzz(_most: int, _seed: int) -> Counter[str]:
    """Load each bomb; return the MiB that it cost."""
    costs: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="armrig-fuzz-", dir=in_memory()) as directory:
        for name, made in BOMBS.items():
            bomb = made()
            for alone in (False, True):
                cost = cost_mib(bomb, Path(directory), alone=alone)
                what = f"{name}{' alone' * alone} ({len(bomb) / 1e6:.3g} MB)"
                costs[f"MiB for {what}"] = round(cost)
                # A long recording may cost more: so much for each of its bytes.
                more = 0 if alone else budget.MESSAGES_PER_BYTE * len(bomb) / (1 << 20)
                assert cost <= MOST_MIB + more, f"{what}: {cost:.0f} MiB"
    return costs
