"""The n-th system call fails, for every n of a run of 2 s; see tests/daemon/test_every_nth_call.py.

`python -m tests.benchmarks.every_nth_call`; it ends at the first harm.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from tests.daemon.test_every_nth_call import CASES, try_every, try_every_disk_call


def main() -> None:
    """Try all, and print their number."""
    began = time.monotonic()
    total = 0
    for kind, way in CASES:
        for scheduled in (False, True):
            tried = try_every(kind, way, scheduled=scheduled)
            total += tried
            print(f"{kind:7s} {way!s:12s} scheduled={scheduled}: {tried} runs", flush=True)
    with tempfile.TemporaryDirectory(prefix="armrig-nth-") as directory:
        tried, told = try_every_disk_call(Path(directory))
    print(f"recorder: {tried} recordings, {told} told, the others complete")
    print(f"{total} runs and {tried} recordings in {time.monotonic() - began:.0f} s, no harm")


if __name__ == "__main__":
    main()
