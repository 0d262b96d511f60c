"""Names of a run's files: unfinished files, and the parts that readers join to one run."""

from __future__ import annotations

from pathlib import Path

ACTIVE, COPY = ".active", ".compact"
"""Suffixes of the name of a file that is being written, and of a file that is being rewritten."""
PART = ".part-"
"""Text between a run's name and a part's number, as in NAME.part-0001.mcap."""


def part_path(path: Path, number: int) -> Path:
    """Return the path of part `number` (1, 2, …) of the run `path`; for 0, return `path`."""
    return path.with_name(f"{path.stem}{PART}{number:04}.mcap") if number else path


def part_paths(path: Path) -> list[Path]:
    """Return the files of the run or the part with the path `path`.

    If the file `path` exists, the result contains only this file. If no file has the name of the
    run, the result contains all parts of the run, in order.
    """
    if path.exists() or path.suffix != ".mcap":
        return [path]
    files = path.parent.glob("*.mcap*") if path.parent.is_dir() else ()
    parts = [p for p in files if part_number(p) and p.name.startswith(path.stem + PART)]
    return sorted(parts, key=lambda part: (part_number(part), part)) or [path]


def part_number(path: Path) -> int:
    """Return the part number in a file's name, 1 or more; 0 if the file is not a part."""
    run, _, tail = path.name.rpartition(PART)
    number, _, ending = tail.partition(".")
    is_number = number.isascii() and number.isdigit()
    is_one = bool(run) and is_number and ending in ("mcap", f"mcap{ACTIVE}")
    return int(number) if is_one else 0
