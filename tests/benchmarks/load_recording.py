"""Loading a recording against the bare work on its chunks, and against mcap's own reader.

`python -m tests.benchmarks.load_recording FILE [--rounds 3]`; `long_recording.py` makes the file.
All take turns in one process. A time is the least processor time, so that other load counts less.
The memory of loading is measured in a process of its own.
"""

from __future__ import annotations

import argparse
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import zstandard
from armrig.recordings.loading import load
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

READ_BY_MCAP = 200_000  # messages: it takes half a minute for an hour
_PEAK = """
import sys
from armrig.recordings.loading import load
peak = lambda: int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0]) / 1024
before = peak()
rec = load(sys.argv[1])
names = ("t", "u", "theta_1", "alpha", "valid", "valid_alpha", "present", "samples")
print(peak() - before, sum(getattr(rec, name).nbytes for name in names) / 2**20)
"""


def bare(path: Path) -> int:
    """Unpack every chunk and check its sum; return how many B there were."""
    packer, found = zstandard.ZstdDecompressor(), 0
    with path.open("rb") as file:
        file.seek(8)
        while True:
            opcode, length = struct.unpack("<BQ", file.read(9))
            if opcode == 0x02:
                return found
            if opcode != 0x06:
                file.seek(length, 1)
                continue
            body = file.read(length)
            _, _, size, crc, n = struct.unpack_from("<QQQII", body)
            data = packer.decompress(memoryview(body)[32 + n + 8 :], max_output_size=size)
            if crc and zlib.crc32(data) != crc:
                raise SystemExit("the checksum of a chunk is wrong")
            found += len(data)


def by_mcap(path: Path) -> int:
    """Decode the first samples with mcap's reader and its protobuf support."""
    topics = ["/rig/1/sample"]
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        some = islice(reader.iter_decoded_messages(topics=topics), READ_BY_MCAP)
        return sum(1 for _, _, _, message in some if message.k >= 0)


def seconds(action: Callable[[], object]) -> float:
    """Return the processor time that an action takes, in s."""
    begin = time.process_time()
    action()
    return time.process_time() - begin


def main() -> None:
    """Print the numbers of one file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    asked = parser.parse_args()
    path, say = asked.file, sys.stdout.write
    N, unpacked = load(path).samples.size, bare(path)
    say(f"{N} samples, {path.stat().st_size / 1e6:.0f} MB, unpacked {unpacked / 1e6:.0f} MB\n")
    took: dict[str, list[float]] = {"bare": [], "load": [], "mcap": []}
    for _ in range(asked.rounds):
        took["bare"].append(seconds(lambda: bare(path)))
        took["load"].append(seconds(lambda: load(path)))
        took["mcap"].append(seconds(lambda: by_mcap(path)) * N / min(READ_BY_MCAP, N))
        say(", ".join(f"{name} {times[-1]:.2f} s" for name, times in took.items()) + "\n")
    chunks, whole, mcap = (min(times) for times in took.values())
    told = subprocess.run(
        [sys.executable, "-c", _PEAK, str(path)], capture_output=True, text=True, check=True
    ).stdout
    peak, arrays = (float(word) for word in told.split())
    say(f"by the least of each: {chunks / whole:.0%} of the bare speed, ")
    say(f"{mcap / whole:.1f} times mcap's; ")
    say(f"{peak:.0f} MiB for arrays of {arrays:.0f} MiB\n")


if __name__ == "__main__":
    main()
