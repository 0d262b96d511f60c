"""The names of the files of one run: a long run is recorded in parts, which are read as one."""

from __future__ import annotations

from pathlib import Path

from armrig_core.recording_file.unfinished import ACTIVE

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
    begin = path.stem + PART
    found = path.parent.glob("*.mcap*") if path.parent.is_dir() else ()
    parts = [p for p in found if p.name.startswith(begin) and _number(p.name[len(begin) :])]
    return sorted(parts) or [path]


def _number(rest: str) -> bool:
    return rest.partition(".")[0].isdigit() and rest.partition(".")[2] in ("mcap", f"mcap{ACTIVE}")
