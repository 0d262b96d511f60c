"""`python -m mutation.core`: plant bugs in the C core, and say which of them no test sees."""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from mutation.core_sites import CoreSite, planted, sites
from mutation.trial import Outcome

ROOT = Path(__file__).parents[2]
FIRMWARE = ROOT / "firmware_protocol" / "firmware"
TESTS = [
    "test_specification.py",
    "test_same_answers.py",
    "test_core_guards_itself.py",
    "test_wraps.py",
    "test_bounds.py",
    "test_core_frames.py",
    "test_interrupts.py",
    "test_fuzz_core.py",
]
"""Of tests/firmware, those first that catch the most."""
LIMIT_S = 400.0


def main() -> int:
    """Draw, plant, build, run, report; 1 where fewer are caught than are asked for."""
    parser = argparse.ArgumentParser(prog="python -m mutation.core", description=__doc__)
    parser.add_argument("--n", type=int, default=60, help="bugs to draw")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--skip", type=int, default=0, help="bugs drawn that were tried already")
    parser.add_argument("--least", type=float, default=0.9, help="share to be caught")
    asked = parser.parse_args()

    found = sites(FIRMWARE / "core")
    chosen = random.Random(asked.seed).sample(found, len(found))
    print(f"{asked.n} of {len(found)} bugs, seed {asked.seed}", flush=True)
    counts: Counter[Outcome] = Counter()
    for site in chosen[asked.skip :]:
        if counts.total() == asked.n - asked.skip:
            break
        outcome = _judged(site)
        if outcome is not None:  # else the compiler sees it: it could never be built
            counts[outcome] += 1
    caught = counts[Outcome.CAUGHT] + counts[Outcome.TIMED_OUT]
    told = ", ".join(f"{n} {what}" for what, n in sorted(counts.items()))
    print(f"{counts.total()} bugs: {told}; {caught / max(1, counts.total()):.1%} seen")
    return 0 if caught >= asked.least * counts.total() else 1


def _judged(site: CoreSite) -> Outcome | None:
    """Return what became of a bug; None where it does not compile."""
    with tempfile.TemporaryDirectory(prefix="armrig-mutant-") as folder:
        firmware = Path(folder, "firmware")
        shutil.copytree(FIRMWARE, firmware, ignore=shutil.ignore_patterns("uno", "build", "*.hex"))
        source = firmware / "core" / site.file
        source.write_text(planted(source.read_text(), site))
        pc = firmware / "boards" / "pc"
        build = ["make", "-s", "-C", str(pc), f"OUT={folder}", f"{folder}/librig.so"]
        if subprocess.run(build, capture_output=True, check=False).returncode:
            return None
        began = time.monotonic()
        outcome, by = _tried(firmware)
    where = f"{site.file}:{site.line} ({site.kind})"
    print(f"{outcome:9} {time.monotonic() - began:5.1f} s  {where}  {by}", flush=True)
    if outcome is Outcome.SURVIVED:
        print(f"    - {site.before.strip()}\n    + {site.after.strip()}", flush=True)
    return outcome


def _tried(firmware: Path) -> tuple[Outcome, str]:
    tests = [str(ROOT / "tests" / "firmware" / name) for name in TESTS]
    environment = {
        **os.environ,
        "ARMRIG_FIRMWARE": str(firmware),
        "PYTHONPATH": os.pathsep.join(map(str, (ROOT / "tests", *sys.path))),
    }
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(
            command,
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Outcome.TIMED_OUT, ""
    if done.returncode == 0:
        return Outcome.SURVIVED, ""
    failed = re.search(r"^_+ (test_\S+) _+$", done.stdout, re.MULTILINE)
    return Outcome.CAUGHT, failed.group(1) if failed else "crash"


if __name__ == "__main__":
    sys.exit(main())
