"""Recovery of any file: a whole recording takes its place, or it stays as it is with one line."""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path
from random import Random

from armrig.recordings.files.loading import load
from armrig.recordings.recording import Recording
from armrig_core.errors import FileError
from armrig_core.recording_file.recovery import Recovery
from armrig_core.recording_file.unfinished import RecoveryError

from tests.fuzz.files import corpus, in_memory, in_one_line
from tests.fuzz.mutation import mutated

CHECKED = 2
"""Number of files of the corpus with checksums, as a daemon writes them."""
_RECOVERY = Recovery(armrig="0", now=lambda: "2026-01-01T00:00:00+00:00")


def fuzz(most: int, seed: int) -> Counter[str]:
    """Recover `most` files; count what became of them."""
    rng, honest = Random(seed), corpus()
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="armrig-fuzz-", dir=in_memory()) as directory:
        for _ in range(most):
            number = rng.randrange(len(honest))
            data = mutated(honest[number], rng, honest)
            path = Path(directory) / "1-x.mcap.active"
            found[check(data, path, checked=number == CHECKED)] += 1
    return found


def check(data: bytes, path: Path, *, checked: bool) -> str:
    """Recover one file, and judge what is left; return what became of it.

    Without check sums a changed length may hide from a reader what a copy has to know.
    """
    path.write_bytes(data)
    before = _loaded(path)
    try:
        done = _RECOVERY.recover(path)
    except RecoveryError as err:
        assert path.read_bytes() == data, "it was changed"
        in_one_line(err)
        assert [p.name for p in path.parent.iterdir()] == [path.name], "something is left beside it"
        return "refused"
    assert [p.name for p in path.parent.iterdir()] == [done.path.name]
    after = _loaded(done.path)
    done.path.unlink()
    if checked and before is not None:
        assert after is not None, "what could be read cannot be read any more"
        n = before.samples.size
        assert after.samples[:n].tobytes() == before.samples.tobytes(), "samples are lost"
    return "recovered" if after is not None else "recovered, and no recording"


def _loaded(path: Path) -> Recording | None:
    try:
        return load(path)
    except FileError:
        return None
