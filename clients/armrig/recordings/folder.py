"""The recordings in a folder, newest first: what each says of itself, without its samples."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
from armrig_core.manifest import OUTCOME, RUN, Manifest, Outcome, manifest_of, outcome_of
from armrig_core.recording_file.budget import DamageError

from armrig.recordings.metadata import read_metadata

VALIDATION_OF = "validation_of"
"""Key of a run's details: the id of the run that it was recorded to validate."""
KINDS = ("blackbox", "greybox", "step", "staircase", "bla")
"""What `armrig collect` records; a name that a person gave stands behind it."""

_STAMP = "%Y%m%dT%H%M%S"
_FILE_NAME = re.compile(r".*-(\d{8}T\d{6})-[0-9a-f]{8}\.mcap")  # as the daemon names them
_EXPERIMENT = re.compile(rf"({'|'.join(KINDS)})(-validation)?(?:-(.+))?")


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingSummary:
    """What a whole recording says of how it came about."""

    path: Path
    """The file."""
    manifest: Manifest
    """How the run was made."""
    outcome: Outcome
    """How it ended."""

    @property
    def kind(self) -> str:
        """Kind of experiment, such as blackbox, without a person's name for it."""
        found = _EXPERIMENT.fullmatch(self.manifest.experiment)
        return found[1] if found else self.manifest.experiment

    @property
    def is_validation(self) -> bool:
        """Whether it was recorded to validate what another one gives."""
        found = _EXPERIMENT.fullmatch(self.manifest.experiment)
        return bool(found and found[2])

    @property
    def name(self) -> str:
        """Name that a person gave, "" where nobody did."""
        found = _EXPERIMENT.fullmatch(self.manifest.experiment)
        return (found[3] or "") if found else ""

    @property
    def validation_of(self) -> str:
        """Id of the run that it validates, "" where it does not or does not say."""
        return str(self.manifest.details.get(VALIDATION_OF, ""))

    @property
    def seconds(self) -> float:
        """Length of what was recorded, missing samples included, in s."""
        return (self.outcome.samples + self.outcome.missing) * self.manifest.Ts

    def names(self, *, validation: bool) -> set[str]:
        """Return what it is meant by: its own name, its run's id, its experiment, its file's name.

        A validation is meant by what the recording that it validates is called, with `validation`,
        and by its own id or experiment.
        """
        manifest = self.manifest
        if not validation:
            own = {self.name} if self.name and not self.is_validation else set()
            return own | {manifest.run_id, manifest.experiment, self.path.stem}
        if not self.is_validation:
            return set()
        of = {self.validation_of} if self.validation_of else set()
        return of | ({self.name, f"{self.kind}-{self.name}"} if self.name else {self.kind})


def summary_of(path: Path) -> RecordingSummary:
    """Return what a recording says of itself; a few kilobytes of it are read.

    Raises
    ------
    OSError
        The file cannot be read.
    DamageError
        It is not whole, or no recording of armrig.
    """
    metadata = read_metadata(path)
    for name in (RUN, OUTCOME):
        if name not in metadata:
            msg = f"it holds no metadata named {name}"
            raise DamageError(msg)
    try:
        manifest, outcome = manifest_of(metadata[RUN]), outcome_of(metadata[OUTCOME])
    except (msgspec.DecodeError, ValueError, RecursionError) as err:
        msg = "its metadata are not armrig's"
        raise DamageError(msg) from err
    return RecordingSummary(path=path, manifest=manifest, outcome=outcome)


def newest_first(folder: Path) -> list[Path]:
    """Return the finished recordings of a folder, by the time in their names, or of the files.

    A run that is still going writes to another name, `*.mcap.active`.
    """
    paths = [path for path in folder.glob("*.mcap") if path.is_file()]
    return sorted(paths, key=_age, reverse=True)


def summaries(paths: list[Path]) -> Iterator[RecordingSummary]:
    """Give the summaries of those that are whole, in the same order; read as they are asked for."""
    for path in paths:
        try:
            yield summary_of(path)
        except (OSError, DamageError):
            continue


def may_answer_to(path: Path, name: str, *, validation: bool) -> bool:
    """Return whether a file may be meant by a name: a name of the daemon's says that it is not."""
    wanted = "-validation" if validation else name
    return wanted in path.name or not _FILE_NAME.fullmatch(path.name)


def facts_of(summary: RecordingSummary) -> dict[str, Any]:
    """Return what is said of a recording, for a program."""
    manifest, outcome = summary.manifest, summary.outcome
    return {
        "recording": str(summary.path),
        "run_id": manifest.run_id,
        "rig": manifest.rig,
        "started": manifest.started,
        "experiment": summary.kind,
        "name": summary.name,
        "validation": summary.is_validation,
        "validation_of": summary.validation_of or None,
        "seconds": summary.seconds,
        "Ts": manifest.Ts,
        "samples": outcome.samples,
        "missing": outcome.missing,
        "outcome": outcome.outcome,
    }


def _age(path: Path) -> tuple[str, float, str]:
    """Return what sorts by age: the stamp of the daemon's name, or of the file's own time."""
    try:
        changed = path.stat().st_mtime
    except OSError:
        changed = 0.0
    found = _FILE_NAME.fullmatch(path.name)
    return found[1] if found else time.strftime(_STAMP, time.localtime(changed)), changed, path.name
