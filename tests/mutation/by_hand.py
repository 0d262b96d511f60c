"""`python -m tests.mutation.by_hand`: plant the bugs of `planted.toml` again; a test must see each.

People planted these bugs after a look at the code. No tool had drawn their like.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.mutation.__main__ import Room, Trials, preload
from tests.mutation.bug import Bug, bugs
from tests.mutation.planting import keep, module_of, plant_kept
from tests.mutation.reach import Reach
from tests.mutation.trial import Outcome, Verdict, tried

TABLE = Path(__file__).with_name("planted.toml")
LIMIT_S = 120.0


def judged(bug: Bug, folder: Path) -> Verdict:
    """Return the verdict of its tests on a bug."""
    if not bug.file.endswith(".py"):
        room = Room(name=bug.name, sources=[], tests=bug.tests, build=["true"])
        trials = Trials(folder, Reach(folder / "reach"), Counter(), everyday=False)
        return trials.judged(room, bug.mutant, bug.tests)
    kept = folder / "bug.json"
    environment = keep(kept, module_of(bug.file), bug.source.replace(bug.old, bug.new))

    def plant() -> None:
        os.environ.update(environment)
        plant_kept(str(kept))

    return tried(bug.tests, plant, LIMIT_S)


def _outcome(bug: Bug, folder: Path) -> str:
    """Return an outcome, or why the table is out of date."""
    if (n := bug.source.count(bug.old)) != 1:
        return f"found {n} times"
    try:
        return judged(bug, folder).outcome
    except RuntimeError as err:
        return str(err)


def main() -> int:
    """Plant the bugs whose name contains the first argument; return 1 unless each is seen."""
    chosen = [bug for bug in bugs(TABLE) if not sys.argv[1:] or sys.argv[1] in bug.name]
    preload()
    unseen = 0
    for bug in chosen:
        with TemporaryDirectory(prefix="armrig-bug-") as folder:
            outcome = _outcome(bug, Path(folder))
        if outcome not in (Outcome.CAUGHT, Outcome.TIMED_OUT):
            unseen += 1
            print(f"{outcome}: {bug.name} ({bug.file})", flush=True)
    print(f"{len(chosen) - unseen} of {len(chosen)} bugs are seen")
    return 1 if unseen else 0


if __name__ == "__main__":
    sys.exit(main())
