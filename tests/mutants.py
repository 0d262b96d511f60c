"""Draw N mutants with Cosmic Ray, and print which of them no test of their room sees.

`make mutants N=120`. The table `[tool.armrig.mutants]` of pyproject.toml names the rooms: the first
folder is mutated, and the others contain its tests. Two copies of the checked-out commit are
mutated at the same time. A line of the results' file is one mutant, known by its file and by the
lines that it changes. A second call continues. `--again FILE` tries the mutants of that file.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import time
import tomllib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any

from cosmic_ray.commands.init import init
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator
from cosmic_ray.testing import run_tests
from cosmic_ray.work_db import WorkDB

ROOT = Path(__file__).parents[1]
LIMIT_S = 1200.0
"""Tests that have not ended by then see the mutant, because it made them wait."""
LIMIT_CPU_S = 300
"""Processor time after which tests see the mutant, because it made them compute for ever."""
IN_TYPES = "BitOr"
"""The operator `|` joins types in this project, and no annotation is evaluated."""


Mutant = dict[str, Any]
"""`room`, `file`, `operator`, `change` (lines before, after), and then `outcome` and `seconds`."""


def main() -> int:
    """Draw or read the mutants, try each, and print the survivors."""
    parser = argparse.ArgumentParser(prog="make mutants", description=__doc__)
    parser.add_argument("--n", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rooms", nargs="*", help="rooms to draw from; default all")
    parser.add_argument("--again", type=Path, help="file of results whose mutants are tried")
    parser.add_argument("--results", type=Path, default=Path("mutants.jsonl"))
    asked = parser.parse_args()
    rooms: dict[str, list[str]] = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"][
        "armrig"
    ]["mutants"]
    if asked.again:
        mutants = _read(asked.again)
    else:
        mutants = _drawn({r: rooms[r] for r in asked.rooms or rooms}, asked.n, asked.seed)
    tried = _read(asked.results) if asked.results.exists() else []
    done = {(m["file"], m["operator"], *m["change"]) for m in tried}
    left = [m for m in mutants if (m["file"], m["operator"], *m["change"]) not in done]
    with TemporaryDirectory() as folder, asked.results.open("a") as results:
        copies: SimpleQueue[Path] = SimpleQueue()
        for name in ("one", "two"):
            copy = Path(folder, name)
            subprocess.run(["git", "clone", "-q", str(ROOT), str(copy)], check=True)
            copies.put(copy)
        with ThreadPoolExecutor(2) as pool:
            for mutant in pool.map(lambda m: _tried(m, rooms[m["room"]][1:], copies), left):
                tried.append(mutant)
                results.write(json.dumps(mutant) + "\n")
                results.flush()
                print(f"{len(tried)} of {len(mutants)}: {mutant['outcome']}", file=sys.stderr)
    for mutant in tried:
        if mutant["outcome"] == "survived":
            print(mutant["file"], *mutant["change"], sep="\n  ")
    for room in rooms:
        print(f"{room:14}", dict(Counter(m["outcome"] for m in tried if m["room"] == room)))
    return 0


def _read(path: Path) -> list[Mutant]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def _drawn(rooms: dict[str, list[str]], n: int, seed: int) -> list[Mutant]:
    """Return n mutants, the same number of each room, drawn with equal probability in the room."""
    draw = random.Random(seed)
    mutants: list[Mutant] = []
    with TemporaryDirectory() as folder:
        for room, (source, *_) in rooms.items():
            work = WorkDB(Path(folder, room), WorkDB.Mode.create)
            init(sorted(Path(source).rglob("*.py")), work, {})
            places = sorted(
                (str(m.module_path), m.operator_name, m.occurrence)
                for item in work.work_items
                for m in item.mutations
                if IN_TYPES not in m.operator_name
            )
            work.close()
            draw.shuffle(places)
            changed = ((file, name, nth, Path(file).read_text()) for file, name, nth in places)
            valid = (
                {"room": room, "file": file, "operator": name, "change": _change(text, code)}
                for file, name, nth, text in changed
                if _compiles(code := _mutated(text, name, nth) or "")
            )
            mutants += islice(valid, n // len(rooms))
    return mutants


def _compiles(code: str) -> bool:
    with suppress(SyntaxError):
        return bool(compile(code, "", "exec"))
    return False


def _mutated(text: str, operator: str, nth: int) -> str | None:
    """Return the text with the n-th change of an operator; None if there are fewer places."""
    code: str | None = ""  # the operator for exceptions raises for a name with a point
    with suppress(AttributeError):
        code = mutate_code(text, get_operator(operator)(), nth)
    return code


def _change(before: str, after: str) -> list[str]:
    """Return the changed lines before and after, without their places in the file."""
    a, b = before.splitlines(), after.splitlines()
    while a and b and a[0] == b[0]:
        a, b = a[1:], b[1:]
    while a and b and a[-1] == b[-1]:
        a, b = a[:-1], b[:-1]
    return ["- " + "\n".join(a), "+ " + "\n".join(b)]


def _tried(mutant: Mutant, folders: list[str], copies: SimpleQueue[Path]) -> Mutant:
    """Return the mutant with its outcome: `killed`, `survived`, or `gone` with its lines."""
    copy = copies.get()
    file = copy / mutant["file"]
    text = file.read_text() if file.exists() else ""
    began = time.monotonic()
    try:
        nth, code = 0, _mutated(text, mutant["operator"], 0)
        while code is not None and _change(text, code) != mutant["change"]:
            nth, code = nth + 1, _mutated(text, mutant["operator"], nth + 1)
        if code is None:
            return mutant | {"outcome": "gone"}
        file.write_text(code)
        return _outcome(mutant, copy, folders, began)
    finally:
        if text:
            file.write_text(text)
        copies.put(copy)


def _outcome(mutant: Mutant, copy: Path, folders: list[str], began: float) -> Mutant:
    near = [
        str(path.relative_to(copy))
        for folder in folders
        for path in (copy / folder).rglob(f"test_*{Path(mutant['file']).stem.strip('_')}*.py")
    ]
    paths = ":".join(str(copy / part) for part in ("firmware_protocol", "daemon", "clients"))
    words = [f"PYTHONPATH={paths}", "OPENBLAS_NUM_THREADS=1", str(ROOT / ".venv/bin/pytest")]
    words += ["-xq", "--rootdir", str(copy), "-c", str(copy / "pyproject.toml")]
    words += ["-m", "'not exhaustive and not timed and not machine'", *near, *folders]
    seen, _ = run_tests(f"prlimit --cpu={LIMIT_CPU_S} env -C {copy} " + " ".join(words), LIMIT_S)
    return mutant | {"outcome": seen.value, "seconds": round(time.monotonic() - began, 1)}


if __name__ == "__main__":
    os.chdir(ROOT)
    sys.exit(main())
