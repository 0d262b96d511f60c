"""A bug that a person planted: an entry of a table."""

from __future__ import annotations

import tomllib
from itertools import takewhile
from pathlib import Path

import msgspec

from tests.mutation.mutant import Mutant
from tests.mutation.reach import ROOT


class Bug(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A piece of a file, what replaces it, and the tests that see the difference."""

    name: str
    file: str
    old: str
    new: str
    tests: list[str] = []

    @property
    def source(self) -> str:
        """Text of the file, without the bug."""
        return (ROOT / self.file).read_text(encoding="utf-8")

    @property
    def mutant(self) -> Mutant:
        """Edit that plants the bug; its line is the first that changes.

        Raises
        ------
        ValueError
            `old` does not occur exactly once.
        """
        source = self.source
        if (n := source.count(self.old)) != 1:
            raise ValueError(f"{self.name}: `old` occurs {n} times in {self.file}, not once")
        pairs = zip(self.old, self.new, strict=False)
        same = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
        start = source.index(self.old) + same
        line = source.count("\n", 0, start) + 1
        return Mutant(self.file, line, "by hand", start, self.old[same:], self.new[same:])


def bugs(table: Path) -> list[Bug]:
    """Return the bugs of a table."""
    return msgspec.convert(tomllib.loads(table.read_text(encoding="utf-8"))["bug"], list[Bug])
