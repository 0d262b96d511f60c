"""Removal of old recordings from a folder: whole runs of one rig, the oldest first.

Before the removal of a run, each file of the run is read completely. The run is removed only if
each file is a complete recording of this rig.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from io import BytesIO
from math import inf
from pathlib import Path
from typing import IO, NamedTuple

import msgspec
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Metadata

from armrig_core.commands.codes import OutcomeCode
from armrig_core.process.printable import plural
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.byte_source import ByteSource
from armrig_core.recording_file.file_records import MAGIC, UNREADABLE
from armrig_core.recording_file.manifest import OUTCOME, RUN, Manifest, Outcome
from armrig_core.recording_file.part_names import ACTIVE, COPY, PART
from armrig_core.recording_file.rewriting import all_records
from armrig_core.recording_file.unfinished import NotOursError, RecoveryError, open_locked

DAY_S, GB = 86_400, 10**9
_READ_ERRORS = (DamageError, RecoveryError, OSError, msgspec.DecodeError, *UNREADABLE)
_NAME = re.compile(rf"(.+?)(?:{re.escape(PART)}(\d+))?\.mcap({ACTIVE}|{COPY})?", re.DOTALL)


class Removal(NamedTuple):
    """Result for one run outside the limits: the run was removed, or could not be removed."""

    is_removed: bool
    text: str
    """File, reason and size, for a person."""


class _RecordedRun(NamedTuple):
    files: list[Path]
    """Files in the order of the parts."""
    size: int
    """Size of all files, in B."""
    ended_s: float
    """Time of the last write to any of the files, in s since the epoch."""


@dataclass(kw_only=True)
class Retention:
    """Limits on the age and the size of one rig's recordings in a folder."""

    folder: Path
    rig: str
    keep_days: float
    """Age above which a run is removed, in days; 0 sets no limit."""
    keep_gb: float
    """Largest size of the rig's recordings, in GB; 0 sets no limit."""
    owner: int
    """Id of the user whose files may be removed."""
    breath: Callable[[], None] = lambda: None
    """Function that is called between two records; it may wait."""
    _reported: set[tuple[Path, float]] = field(default_factory=set)
    """Last file and end time of each run whose failed removal was reported."""
    _keeps_old: bool = False
    _rigs: dict[tuple[Path, float], str] = field(default_factory=dict)
    """Rig of each run, by the run's first file and end time; "" if the file is no recording."""

    @property
    def is_asked(self) -> bool:
        """True if a limit is set."""
        return self.keep_days > 0 or self.keep_gb > 0

    def apply(self, now_s: float) -> Iterator[Removal]:
        """Remove the runs outside the limits; yield a result for each removal and each failure.

        The newest run stays, however large it is. A run with an unfinished file stays, too. If the
        newest run is older than `keep_days`, the clock may be wrong, and the age removes no run.

        `now_s` is the time of day, in s since the epoch.
        """
        runs = self._runs()
        total = sum(run.size for run in runs)
        until_s = now_s - self.keep_days * DAY_S if self.keep_days else -inf
        if runs and runs[-1].ended_s < until_s:
            if runs[1:] and not self._keeps_old:
                why = f"the newest recording is older than {plural(self.keep_days, 'day')}"
                yield Removal(
                    False, f"{self.folder}: {why}, so none is removed by its age: check `date`"
                )
            self._keeps_old, until_s = True, -inf
        for run in runs[:-1]:
            if why := self._reason(run, total, until_s):
                # Subtract the size even if the removal fails, so that no other run is removed.
                total -= run.size
                if (done := self._remove(run, why)) is not None:
                    yield done

    def _reason(self, run: _RecordedRun, total: int, until_s: float) -> str:
        if run.ended_s < until_s:
            return f"older than {plural(self.keep_days, 'day')}"
        if self.keep_gb and total > self.keep_gb * GB:
            return f"the recordings of rig {self.rig} take more than {self.keep_gb:g} GB"
        return ""

    def _runs(self) -> list[_RecordedRun]:
        """Return the finished runs of this rig, the oldest first."""
        files: dict[str, list[tuple[int, Path, os.stat_result]]] = {}
        unfinished = set()
        try:
            with os.scandir(self.folder) as entries:
                for entry in entries:
                    name = _NAME.fullmatch(entry.name)
                    if name is None or not entry.name.startswith(f"{self.rig}-"):
                        continue
                    if name[3]:
                        unfinished.add(name[1])
                    elif entry.is_file(follow_symlinks=False):
                        part = (int(name[2] or 0), Path(entry.path), entry.stat())
                        files.setdefault(name[1], []).append(part)
        except OSError:  # nothing can be read, so nothing is removed
            return []
        runs = [_run(parts) for name, parts in files.items() if name not in unfinished]
        # The name is not enough: the names of the files of rig 1-b also begin with "1-".
        rig_runs = [run for run in runs if self._rig_of(run) == self.rig]
        return sorted(rig_runs, key=lambda run: (run.ended_s, run.files))

    def _rig_of(self, run: _RecordedRun) -> str:
        key = (run.files[0], run.ended_s)
        if key not in self._rigs:
            self.breath()
            try:
                with open_locked(run.files[0], self.owner) as stream:
                    manifests = (data for name, data in self._metadata(stream) if name == RUN)
                    self._rigs[key] = Manifest.of(next(manifests, {})).rig
            except NotOursError:  # the file may be free at the next call
                return ""
            except _READ_ERRORS:
                self._rigs[key] = ""
        return self._rigs[key]

    def _remove(self, run: _RecordedRun, why: str) -> Removal | None:
        """Remove a run; return None if a file is in use or a failure was already reported."""
        path = run.files[-1]
        if (path, run.ended_s) in self._reported:
            return None
        try:
            with ExitStack() as stack:  # nobody else may recover or remove one of the files
                streams = [stack.enter_context(open_locked(file, self.owner)) for file in run.files]
                outcomes = [self._outcome(stream) for stream in streams]
                if outcomes[-1] == OutcomeCode.CONTINUED:
                    raise DamageError("its last part is missing")
                # The last part is removed last: after a loss of power, the next call can then
                # remove the parts that are left.
                for file in run.files:
                    file.unlink()
        except NotOursError:
            return None
        except _READ_ERRORS as err:
            self._reported.add((path, run.ended_s))
            reason = err.strerror if isinstance(err, OSError) else err
            text = f"{path}: {why}, but it stays, because reading or removing it failed"
            return Removal(False, f"{text}: {reason}")
        parts = (
            f" and the {plural(len(run.files) - 1, 'part')} before it" if len(run.files) > 1 else ""
        )
        return Removal(True, f"{path}{parts}: removed, {run.size / 1e6:.1f} MB: {why}")

    def _outcome(self, stream: IO[bytes]) -> str:
        """Read a whole file; return the code of its outcome."""
        metadata = dict(self._metadata(stream))
        if Manifest.of(metadata.get(RUN, {})).rig != self.rig:
            raise DamageError("a part of it belongs to another rig")
        if OUTCOME not in metadata:
            raise DamageError("it contains no outcome of its run")
        return Outcome.of(metadata[OUTCOME]).code

    def _metadata(self, stream: IO[bytes]) -> Iterator[tuple[str, dict[str, str]]]:
        """Yield the name and the content of each metadata record; raise DamageError at damage."""
        source = ByteSource(stream, os.fstat(stream.fileno()).st_size)
        if source.read(len(MAGIC)) != MAGIC:
            raise DamageError("not an MCAP file")
        for record in all_records(source):
            if record.opcode == Opcode.METADATA:
                metadata = Metadata.read(ReadDataStream(BytesIO(record.body)))
                yield metadata.name, metadata.metadata
            self.breath()


def _run(parts: list[tuple[int, Path, os.stat_result]]) -> _RecordedRun:
    parts.sort(key=lambda part: part[:2])
    return _RecordedRun(
        files=[path for _, path, _ in parts],
        size=sum(inode.st_size for _, _, inode in parts),
        ended_s=max(inode.st_mtime for _, _, inode in parts),
    )
