"""The names of the files of one run, while it is written, and in parts, which are read as one."""

from __future__ import annotations

from pathlib import Path

ACTIVE, COPY = ".active", ".compact"
"""How the name of a recording goes on while it is written, and while it is written once more."""
PART = ".part-"
"""Between a run's name and a part's number: NAME.part-0001.mcap."""


def part_path(path: Path, number: int) -> Path:
    """Return where part `number` of the run NAME.mcap is, from 1; of part 0 it is NAME.mcap."""
    return path.with_name(f"{path.stem}{PART}{number:04}.mcap") if number else path


def part_paths(path: Path) -> list[Path]:
    """Return the files that a path stands for.

    The name of a run stands for its parts, in their order, where there is no file of that name;
    the name of a part for that part.
    """
    if path.exists() or path.suffix != ".mcap":
        return [path]
    found = path.parent.glob("*.mcap*") if path.parent.is_dir() else ()
    parts = [p for p in found if part_number(p) and p.name.startswith(path.stem + PART)]
    return sorted(parts, key=lambda part: (part_number(part), part)) or [path]


def part_number(path: Path) -> int:
    """Return which part of a run a file is by its name, from 1; 0 for what is named as none."""
    run, _, rest = path.name.rpartition(PART)
    number, _, ending = rest.partition(".")
    is_number = number.isascii() and number.isdigit()
    is_one = bool(run) and is_number and ending in ("mcap", f"mcap{ACTIVE}")
    return int(number) if is_one else 0
