"""`python -m tests.fuzz`: a long run, and what it came to.

An input that does harm ends it with the exception; the same seed finds it again.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time

from tests.fuzz import bombs, cuts, data_files, files, frames, recoveries, requests

TARGETS = {
    "frames": (frames.fuzz, 100_000_000),
    "requests": (requests.fuzz, 1_000_000),
    "files": (files.fuzz, 1_000_000),
    "recoveries": (recoveries.fuzz, 100_000),
    "data_files": (data_files.fuzz, 100_000),
    "every_byte": (cuts.every_byte, 1),
    "any_place": (cuts.any_place, 10_000),
    "bombs": (bombs.fuzz, 1),
}


def main() -> int:
    """Fuzz the requested kinds, or all."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", default=list(TARGETS), help=", ".join(TARGETS))
    parser.add_argument("--most", type=int, help="bytes of frames, or inputs")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    for name in asked.targets:
        function, most = TARGETS[name]
        began, before = time.monotonic(), _peak_mib()
        found = function(asked.most or most, asked.seed)
        took, grown = time.monotonic() - began, _peak_mib() - before
        counts = ", ".join(f"{count} {what}" for what, count in found.most_common())
        print(
            f"{name}: {counts}; {took:.0f} s, {grown:.1f} MiB more, seed {asked.seed}", flush=True
        )
    return 0


def _peak_mib() -> float:
    scale = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * scale / (1 << 20)


if __name__ == "__main__":
    sys.exit(main())
