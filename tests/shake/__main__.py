"""`python -m tests.shake`: run the suite under disturbance; print what failed, and the seed.

A seed selects one condition. Without options: four seeds, each of another condition, here.
`--proof` runs the plan of a release, each run in a fresh clone of HEAD, and appends each result to
a file. After an interruption the next call runs the missing seeds. A change to code or tests voids
the results; a change to documents does not.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any, Final

from tests.shake.conditions import CONDITIONS, PROOF, of_seed
from tests.shake.run import TIMED_OUT, Result, run

ROOT: Final = Path(__file__).parents[2]
COMMAND: Final = ["make", "test"]
PACKAGES: Final = ("firmware_protocol", "daemon", "clients")
NO_CODE: Final = ("docs", "examples")
"""Folders whose changes void no result; nor do the files of the root that end in `.md`."""


def main() -> int:
    """Run the missing seeds; return 1 if a run failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.shake", description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4])
    parser.add_argument("--condition", choices=CONDITIONS, help="for all seeds")
    parser.add_argument("--proof", action="store_true", help="the runs that a release needs")
    parser.add_argument("--clone", action="store_true", help="run in fresh clones of HEAD")
    parser.add_argument("--results", type=Path, help="file of results; default shake.jsonl")
    parser.add_argument("--venv", type=Path, help="environment for the clones; else make makes one")
    parser.add_argument("--limit-s", type=float, help="default 1200, with --proof 3600")
    parser.add_argument("command", nargs="*", help="default: make test")
    asked = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended by SIGTERM"))

    plan = [(asked.condition or of_seed(seed), seed) for seed in asked.seeds]
    if asked.proof:
        plan = [(name, seed) for name, n in PROOF.items() for seed in range(1, n + 1)]
    results = (asked.results or Path("shake.jsonl")).absolute()
    limit_s = asked.limit_s or (3600.0 if asked.proof else 1200.0)
    command = asked.command or COMMAND
    in_clones = asked.clone or asked.proof
    version = {"commit": _git("rev-parse", "HEAD"), "code": code_hash(_git("ls-tree", "HEAD"))}
    known = kept(results, version["code"]) if in_clones else {}
    codes = []
    for name, seed in plan:
        if (name, seed) in known:
            codes.append(known[name, seed])
            continue
        log = results.with_name(f"{results.stem}-logs") / f"{name}-{seed}.log"
        log.parent.mkdir(parents=True, exist_ok=True)
        print(f"{name}, seed {seed} ...", flush=True)
        with _tree(in_clones, asked.venv) as (folder, environ):
            made = [] if asked.venv is None or command != COMMAND else ["-o", ".venv/dev"]
            result = run(
                [*command, *made],
                *(CONDITIONS[name], seed),
                **{"folder": folder, "log": log, "limit_s": limit_s, "environ": environ},
            )
        line = {**version, "seed": seed, "condition": name, **result._asdict()}
        if in_clones:
            with results.open("a") as file:
                file.write(json.dumps(line) + "\n")
        _print(name, seed, result, log)
        codes.append(result.exit_code)
    failed = sum(code != 0 for code in codes)
    print(f"{len(codes) - failed} of {len(codes)} runs passed")
    return 1 if failed else 0


def code_hash(tree: str) -> str:
    """Return the hash of code and tests, of what `git ls-tree HEAD` prints."""
    names = {line.partition("\t")[2]: line for line in tree.splitlines()}
    counts = [
        line for name, line in names.items() if name not in NO_CODE and not name.endswith(".md")
    ]
    return hashlib.sha256("\n".join(counts).encode()).hexdigest()[:12]


def kept(results: Path, code: str) -> dict[tuple[str, int], int]:
    """Return the exit codes that a file has for this code, by condition and seed."""
    lines = results.read_text().splitlines() if results.exists() else []
    found: list[dict[str, Any]] = [json.loads(line) for line in lines]
    return {(r["condition"], r["seed"]): r["exit_code"] for r in found if r["code"] == code}


@contextmanager
def _tree(in_clone: bool, venv: Path | None) -> Iterator[tuple[Path, dict[str, str]]]:
    """Give a folder to run in, and an environment with a temporary folder of its own."""
    temporary = short_folder(Path(tempfile.gettempdir()))
    environ = {**os.environ, "TMPDIR": str(temporary)}
    folder = ROOT
    try:
        if in_clone:
            folder = temporary / "clone"
            subprocess.run(["git", "clone", "--quiet", ROOT, folder], check=True)
            if venv is not None:
                (folder / ".venv").symlink_to(venv.absolute())
                environ["PYTHONPATH"] = ":".join(str(folder / package) for package in PACKAGES)
        yield folder, environ
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def short_folder(parent: Path) -> Path:
    """Make a folder with a short name, because a socket's path has 107 characters at most."""
    for n in count():
        with suppress(FileExistsError):
            folder = parent / f"s{n}"
            folder.mkdir(mode=0o700)
            return folder
    raise AssertionError


def _print(name: str, seed: int, result: Result, log: Path) -> None:
    if result.exit_code:
        print(log.read_text(errors="replace"))
    how = "passed" if result.exit_code == 0 else f"failed with exit code {result.exit_code}"
    if result.exit_code == TIMED_OUT:
        how = "did not end in time"
    print(
        f"{name}, seed {seed}: {how} after {result.wall_s:.0f} s, {result.cpu_s:.0f} s of "
        f"processors, {result.stops} stops, {result.left_over} processes left over; {log}"
    )
    for test in result.repeated:
        print(f"  repeated: {test}")
    for test in result.failed:
        print(f"  failed: {test}")
    if result.exit_code:
        print(f"  again: python -m tests.shake --condition {name} --seeds {seed}")


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
