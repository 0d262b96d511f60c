"""Recordings that a folder no longer keeps: whole runs of one rig, the oldest first.

A run is removed only if each of its files has been read from its first byte to its last, and is a
complete recording of this rig.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

import msgspec
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Metadata

from armrig_core.codes import OutcomeCode
from armrig_core.manifest import OUTCOME, RUN, manifest_of, outcome_of
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.byte_source import ByteSource
from armrig_core.recording_file.file_records import MAGIC, UNREADABLE
from armrig_core.recording_file.part_names import ACTIVE, COPY, PART
from armrig_core.recording_file.rewriting import all_records
from armrig_core.recording_file.unfinished import NotOursError, RecoveryError, held

DAY_S, GB = 86_400, 10**9
_NO_RECORDING = (DamageError, RecoveryError, OSError, msgspec.DecodeError, *UNREADABLE)
_NAME = re.compile(rf"(.+?)(?:{re.escape(PART)}(\d+))?\.mcap({ACTIVE}|{COPY})?", re.DOTALL)


class Removal(NamedTuple):
    """What became of a run that the folder was not to keep."""

    is_removed: bool
    text: str
    """For a person: which file, why, and how much room it took."""


class _Run(NamedTuple):
    files: list[Path]
    """In the order of its parts."""
    size: int
    """In B."""
    ended_s: float
    """When its last file was written last, in s."""


@dataclass(kw_only=True)
class Retention:
    """How long, and how much, a folder keeps of the recordings of one rig."""

    folder: Path
    rig: str
    keep_days: float
    """Age from which a run is removed, in days; 0 is none."""
    keep_gb: float
    """Most that the rig's recordings take, in GB; 0 is no limit."""
    owner: int
    """User whose files alone are touched."""
    breath: Callable[[], None] = lambda: None
    """Called between two records; it may wait."""
    _reported: set[tuple[Path, float]] = field(default_factory=set)
    """Last files, and their times, of runs that are not removed."""
    _rigs: dict[tuple[Path, float], str] = field(default_factory=dict)
    """Whose recording a file is, with its time; "" for what is none."""

    @property
    def is_asked(self) -> bool:
        """Whether anything is ever removed."""
        return self.keep_days > 0 or self.keep_gb > 0

    def apply(self, now_s: float) -> Iterator[Removal]:
        """Remove what is not to be kept; give a line for each run as it is done.

        The newest run stays, however large it is, and so does a run of which a file is unfinished.

        Parameters
        ----------
        now_s : float
            Time of day, in s.
        """
        found = self._runs()
        total = sum(run.size for run in found)
        for run in found[:-1]:
            if why := self._reason(run, total, now_s):
                total -= run.size  # also of a run that stays: it makes no other one go
                if (done := self._removed(run, why)) is not None:
                    yield done

    def _reason(self, run: _Run, total: int, now_s: float) -> str:
        if self.keep_days and now_s - run.ended_s > self.keep_days * DAY_S:
            return f"older than {self.keep_days:g} days"
        if self.keep_gb and total > self.keep_gb * GB:
            return f"the recordings of rig {self.rig} take more than {self.keep_gb:g} GB"
        return ""

    def _runs(self) -> list[_Run]:
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
        except OSError:  # where nothing can be read nothing is removed
            return []
        runs = [_run(parts) for name, parts in files.items() if name not in unfinished]
        # The name alone does not say it: the files of rig 1-b look like those of rig 1.
        own = [run for run in runs if self._rig_of(run) == self.rig]
        return sorted(own, key=lambda run: (run.ended_s, run.files))

    def _rig_of(self, run: _Run) -> str:
        known = (run.files[0], run.ended_s)
        if known not in self._rigs:
            self.breath()
            try:
                with held(run.files[0], self.owner) as stream:
                    told = (data for name, data in self._metadata(stream) if name == RUN)
                    self._rigs[known] = manifest_of(next(told, {})).rig
            except NotOursError:  # for the moment
                return ""
            except _NO_RECORDING:
                self._rigs[known] = ""
        return self._rigs[known]

    def _removed(self, run: _Run, why: str) -> Removal | None:
        """Remove a run; None where somebody has one of its files, or it was reported before."""
        path = run.files[-1]
        if (path, run.ended_s) in self._reported:
            return None
        try:
            with ExitStack() as stack:  # nobody else recovers or removes one of them
                streams = [stack.enter_context(held(file, self.owner)) for file in run.files]
                outcomes = [self._outcome(stream) for stream in streams]
                if outcomes[-1] == OutcomeCode.CONTINUED:
                    raise DamageError("its last part is missing")
                # The last part at the end: if a loss of power leaves it, it goes the next time.
                for file in run.files:
                    file.unlink()
        except NotOursError:
            return None
        except _NO_RECORDING as err:
            self._reported.add((path, run.ended_s))
            said = err.strerror if isinstance(err, OSError) else err
            text = f"{path}: {why}, but stays: it cannot be read to its end, or removed: {said}"
            return Removal(False, text)
        parts = f" and the {len(run.files) - 1} parts before it" if len(run.files) > 1 else ""
        return Removal(True, f"{path}{parts}: removed, {run.size / 1e6:.1f} MB: {why}")

    def _outcome(self, stream: IO[bytes]) -> str:
        """Read a whole file; return the code of the outcome in it."""
        told = dict(self._metadata(stream))
        if manifest_of(told.get(RUN, {})).rig != self.rig:
            raise DamageError("a part of it is of another rig")
        if OUTCOME not in told:
            raise DamageError("it does not say how its run ended")
        return outcome_of(told[OUTCOME]).code

    def _metadata(self, stream: IO[bytes]) -> Iterator[tuple[str, dict[str, str]]]:
        """Give each metadata record of a file while it is read; DamageError where it breaks."""
        source = ByteSource(stream, os.fstat(stream.fileno()).st_size)
        if source.read(len(MAGIC)) != MAGIC:
            raise DamageError("not an MCAP file")
        for record in all_records(source):
            if record.opcode == Opcode.METADATA:
                metadata = Metadata.read(ReadDataStream(BytesIO(record.body)))
                yield metadata.name, metadata.metadata
            self.breath()


def _run(parts: list[tuple[int, Path, os.stat_result]]) -> _Run:
    parts.sort(key=lambda part: part[:2])
    return _Run(
        files=[path for _, path, _ in parts],
        size=sum(found.st_size for _, _, found in parts),
        ended_s=max(found.st_mtime for _, _, found in parts),
    )
