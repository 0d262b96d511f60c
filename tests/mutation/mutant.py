"""A bug to plant: one small edit of one file."""

from __future__ import annotations

from typing import NamedTuple


class Mutant(NamedTuple):
    """Characters of a file that are replaced by others."""

    file: str
    """Its path within the project."""
    line: int
    kind: str
    start: int
    old: str
    new: str


def planted(source: str, mutant: Mutant) -> str:
    """Return a source with the bug in it."""
    return source[: mutant.start] + mutant.new + source[mutant.start + len(mutant.old) :]


def difference(source: str, mutant: Mutant) -> str:
    """Return the lines that the bug changes, before and after."""
    first = source.rfind("\n", 0, mutant.start) + 1
    last = source.find("\n", mutant.start + len(mutant.old))
    last = len(source) if last < 0 else last
    before, after = source[first:last], source[first : mutant.start] + mutant.new
    after += source[mutant.start + len(mutant.old) : last]
    return "\n".join([f"    - {before.strip()}", f"    + {after.strip()}"])
