"""The catalogue of many small recordings: from files alone, and from what is known of them.

`python -m tests.benchmarks.catalogue [--files 10000] [--rounds 5]`. One recording is copied under
so many names, each with an id, a name and a date of its own. Times are those of a whole process
with interpreter and imports: of `armrig ls`, and of a Python program. "Cold" is without an index,
and with `--drop-caches` (as root) also without the files in memory.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from tests.clients.made_recordings import manifest, recorded, sample

_PROGRAM = """
import sys, time
import armrig
begin = time.perf_counter()
found = armrig.catalogue(sys.argv[1])
print(time.perf_counter() - begin, len(found.columns()["Ts"]))
"""
_ID = "ffffffff"


def make(folder: Path, files: int) -> int:
    """Write the recordings; return their size in B."""
    about = manifest(experiment="blackbox-monday", run_id=_ID, k_first=0, samples=500)
    data = recorded([sample(k) for k in range(500)], manifest=about)
    for number in range(files):
        run_id = f"{number:08x}"
        stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime(1_700_000_000 + 60 * number))
        path = folder / f"1-blackbox-monday-{stamp}-{run_id}.mcap"
        # The checksum of the file is not that of the copy, which the catalogue does not look at.
        path.write_bytes(data.replace(_ID.encode(), run_id.encode()))
        os.utime(path, (1_700_000_000 + 60 * number,) * 2)
    return len(data)


def timed(command: list[str], environ: dict[str, str]) -> tuple[float, float, str]:
    """Run a command; return its time in s, its processor time, and its output."""
    begin, before = time.perf_counter(), _processor_s()
    done = subprocess.run(command, env=environ, capture_output=True, text=True, check=True)
    return time.perf_counter() - begin, _processor_s() - before, done.stdout


def _processor_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--drop-caches", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="armrig-catalogue-") as directory:
        folder, cache = Path(directory) / "recordings", Path(directory) / "cache"
        folder.mkdir()
        size = make(folder, given.files)
        print(f"{given.files} recordings of {size} B")
        time.sleep(2.5)  # files that were just written are not trusted to stay
        environ = {
            **os.environ,
            "XDG_CACHE_HOME": str(cache),
            "ARMRIG_RECORDING_DIRECTORY": str(folder),
        }
        program = [sys.executable, "-c", _PROGRAM, str(folder)]
        ls = [str(Path(sys.executable).with_name("armrig")), "ls"]
        took: dict[str, list[float]] = {}
        for _ in range(given.rounds):
            for name, command in (("armrig.catalogue", program), ("armrig ls", ls)):
                for index in cache.rglob("*.json"):
                    index.unlink()
                if given.drop_caches:
                    os.sync()
                    Path("/proc/sys/vm/drop_caches").write_text("3")
                for heat in ("cold", "warm"):
                    seconds, processor_s, told = timed(command, environ)
                    took.setdefault(f"{name}, {heat}", []).append(seconds)
                    took.setdefault(f"  {name}, {heat}, of the processor", []).append(processor_s)
                    if command is program:
                        inside, count = told.split()
                        assert int(count) == given.files
                        took.setdefault(f"  of it the call, {heat}", []).append(float(inside))
        for name, all_s in took.items():
            print(f"{name:42} median {median(all_s):6.2f} s, longest {max(all_s):6.2f} s")
        (index,) = cache.rglob("*.json")
        print(f"the index has {index.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
