"""Verdicts on bugs, in a file that only grows, so that a draw can resume."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from tests.mutation.mutant import Mutant
from tests.mutation.reach import digest
from tests.mutation.trial import Outcome, Verdict


class Outcomes:
    """A file of one JSON object a line."""

    def __init__(self, path: Path) -> None:
        """Read the present lines; a last line that was cut off is discarded."""
        self._path = path
        self._entries: dict[tuple[Any, ...], dict[str, Any]] = {}
        for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
            try:
                entry = json.loads(line)
            except json.JSONDecodeError:
                continue
            self._entries[_key(entry)] = entry

    def verdict(self, mutant: Mutant, tests: list[str]) -> Verdict | None:
        """Return the verdict on a bug, if its source and its tests are unchanged."""
        entry = self._entries.get(_key(_entry(mutant)))
        if entry is None or entry["tests"] != _hash(_concerned(entry["by"], tests)):
            return None
        return Verdict(Outcome(entry["outcome"]), entry["by"], entry["took_s"], entry["marker"])

    def add(self, room: str, mutant: Mutant, tests: list[str], verdict: Verdict) -> None:
        """Keep what became of a bug."""
        entry = {"room": room, **_entry(mutant), **verdict._asdict()}
        entry["tests"] = _hash(_concerned(verdict.by, tests))
        self._entries[_key(entry)] = entry
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")


def _entry(mutant: Mutant) -> dict[str, Any]:
    return {**mutant._asdict(), "source": digest(mutant.file)}


def _key(entry: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(entry[name] for name in ("file", "start", "old", "new", "source"))


def _concerned(by: str, tests: list[str]) -> list[str]:
    """Return the test that saw a bug; those that did not, if none did."""
    return [by] if "::" in by else sorted(tests)


def _hash(tests: list[str]) -> str:
    files = sorted({test.partition("::")[0] for test in tests})
    told = "\n".join([*tests, *map(digest, files)])
    return hashlib.sha256(told.encode()).hexdigest()[:16]
