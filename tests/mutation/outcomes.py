"""What became of bugs, in a file that only grows: a draw goes on where it was left."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from mutation.sites import Site
from mutation.trial import Outcome, Verdict


class Outcomes:
    """A file of one JSON object a line."""

    def __init__(self, path: Path) -> None:
        """Read what is there; a last line that was cut off is passed over."""
        self._path = path
        self._verdicts: dict[tuple[str, str], Verdict] = {}
        self.timed: dict[str, list[str]] = {}
        """Sound tests of each file, or name, that was asked for."""
        self.took_s: dict[str, float] = {}
        """By test, without a bug."""
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        for line in lines:
            try:
                self._take(json.loads(line))
            except json.JSONDecodeError:
                continue

    def verdict(self, site: Site, source: str) -> Verdict | None:
        """Return what became of a bug of this very source, or None."""
        return self._verdicts.get((site.name, _digest(source)))

    def verdicts(self) -> list[Verdict]:
        """Return all that is known."""
        return list(self._verdicts.values())

    def add(self, site: Site, source: str, verdict: Verdict) -> None:
        """Keep what became of a bug."""
        outcome, by, took_s = verdict
        self._add(
            {"bug": site.name, "source": _digest(source), "outcome": outcome.value, "by": by}
            | {"took_s": round(took_s, 1)}
        )

    def add_timed(self, asked: str, took_s: dict[str, float], failed: list[str]) -> None:
        """Keep how long the tests of a file take; those that failed say nothing."""
        sound = {test: round(s, 3) for test, s in took_s.items() if test not in failed}
        self._add({"tests": asked, "took_s": sound, "failed": failed})

    def _add(self, entry: dict[str, Any]) -> None:
        self._take(entry)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")

    def _take(self, entry: dict[str, Any]) -> None:
        if "tests" in entry:
            self.timed[entry["tests"]] = list(entry["took_s"])
            self.took_s |= entry["took_s"]
        else:
            verdict = Verdict(Outcome(entry["outcome"]), entry["by"], entry["took_s"])
            self._verdicts[entry["bug"], entry["source"]] = verdict


def _digest(source: str) -> str:
    return hashlib.sha256(source.encode()).hexdigest()[:16]
