"""Recordings that their daemon left unfinished: completed as far as they are whole, and named.

The daemon does so when it starts, `armrig recover` by hand, on any machine.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, NamedTuple, TypeVar

import msgspec

from armrig_core import protobuf
from armrig_core.codes import OutcomeCode
from armrig_core.manifest import (
    OUTCOME,
    RECOVERED,
    RUN,
    Manifest,
    Outcome,
    Recovered,
    check_whole_numbers,
    manifest_of,
    outcome_of,
    recovered_of,
)
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.byte_source import ByteSource
from armrig_core.recording_file.file_lock import lock
from armrig_core.recording_file.file_records import MAGIC, UNREADABLE
from armrig_core.recording_file.part_names import ACTIVE, COPY
from armrig_core.recording_file.rewriting import Rewriter, all_records, sync_directory
from armrig_core.recording_file.unfinished import NotOursError, RecoveryError, held
from armrig_core.topics import stream_of

CUT_OFF = "cut off: its daemon died"
"""Outcome of a run whose recording does not say how it ended."""
MOST_CUT_OFF = 1 << 20
"""Most that is cut off, in B: more than one write that was torn, and not what stands behind a
damage in the middle, which may be read some day."""


class RecoveredFile(NamedTuple):
    """A recording that has been completed."""

    path: Path
    """Where it is now."""
    manifest: Manifest
    outcome: Outcome
    recovered: Recovered


@dataclass(frozen=True, slots=True, kw_only=True)
class Recovery:
    """How files are recovered: who does it, and which ones."""

    armrig: str
    """Version of armrig."""
    now: Callable[[], str]
    """Return the time of day, ISO 8601."""
    owner: int | None = None
    """User whose files alone are touched; None for everybody's."""
    rig: str = ""
    """Rig whose recordings alone are touched; "" for any."""
    breath: Callable[[], None] = lambda: None
    """Called between two records; it may wait."""

    def recover(self, path: Path) -> RecoveredFile:
        """Complete a recording that was left unfinished, NAME.mcap.active, as NAME.mcap.

        What is whole from its beginning on is kept, all of it; then come the outcome, where there
        is none, and a record of the recovery. The file is replaced when the new one is on the disk.

        Raises
        ------
        NotOursError
            It is being written, or of another rig.
        RecoveryError
            It cannot be recovered, and stays as it is.
        """
        if not path.name.endswith(f".mcap{ACTIVE}"):
            raise RecoveryError(
                f"{path}: what a daemon left ends in .mcap{ACTIVE}; any other file stays as it is"
            )
        final = path.with_name(path.name.removesuffix(ACTIVE))
        copy = path.with_name(final.name + COPY)
        try:
            with held(path, self.owner) as stream:
                if os.path.lexists(final):
                    raise RecoveryError(
                        f"{path}: {final.name} is there already; move one of them away"
                    )
                # Left by who died while he wrote it: the lock is ours.
                copy.unlink(missing_ok=True)
                try:
                    done = self._copied(path, stream, copy)
                    if sys.platform == "win32":  # it renames no open file
                        stream.close()
                    # Whatever dies in between, one whole recording is there under one of the names.
                    copy.replace(path)
                    path.replace(final)
                    sync_directory(final.parent)
                except BaseException:
                    with suppress(OSError):
                        copy.unlink(missing_ok=True)
                    raise
        except OSError as err:
            msg = f"{path}: {err.strerror or err}; it stays as it is: mend that, then "
            raise RecoveryError(msg + "`armrig recover` it") from err
        return RecoveredFile(final, *done)

    def _copied(
        self, path: Path, stream: IO[bytes], copy: Path
    ) -> tuple[Manifest, Outcome, Recovered]:
        """Write what is whole to `copy`, complete it, and have it on the disk."""
        size = os.fstat(stream.fileno()).st_size
        source = ByteSource(stream, size)
        if source.read(len(MAGIC)) != MAGIC:
            what = "not an MCAP file" if size else "0 B"
            raise RecoveryError(f"{path}: {what}: nothing was recorded; delete it")
        with copy.open("xb") as target:
            lock(target)  # ours while we write
            rewriter, tally = Rewriter(target, size), _Tally()
            damage = self._walked(path, source, rewriter, tally)
            behind = size - source.whole
            if damage and behind > MOST_CUT_OFF:
                msg = f"{path}: {damage}, and {behind} B stand behind it; it stays as it is, and "
                raise RecoveryError(msg + "`armrig info` reads what comes before")
            manifest = _manifest(path, rewriter, self.rig)
            if manifest is None:
                why = damage or "it holds no metadata named armrig.run"
                raise RecoveryError(
                    f"{path}: no manifest of a run: {why}; nothing was recorded; delete it"
                )
            outcome = Outcome(
                outcome=CUT_OFF,
                samples=tally.samples,
                missing=tally.missing(manifest),
                code=OutcomeCode.CUT_OFF,
            )
            if OUTCOME in rewriter.metadata:
                outcome = _told(path, outcome_of, rewriter.metadata[OUTCOME])
                if tally.samples < outcome.samples:
                    raise RecoveryError(
                        f"{path}: {tally.samples} of its {outcome.samples} samples are whole, "
                        "and its run was recorded to the end; it stays as it is: copy it again"
                    )
            else:
                rewriter.add_metadata(OUTCOME, outcome.metadata())
            recovered = Recovered(
                when=self.now(),
                armrig=self.armrig,
                kept_bytes=source.whole,
                cut_off_bytes=behind,
                damage="; ".join([*rewriter.left_out, *([damage] if damage else [])]),
            )
            if RECOVERED in rewriter.metadata:  # by one who died before it had its name
                recovered = _told(path, recovered_of, rewriter.metadata[RECOVERED])
            else:
                rewriter.add_metadata(RECOVERED, recovered.metadata())
            rewriter.finish()
            target.flush()
            os.fsync(target.fileno())
        return manifest, outcome, recovered

    def _walked(self, path: Path, source: ByteSource, rewriter: Rewriter, tally: _Tally) -> str:
        """Copy what is whole; return why it ends before the file's own end, or nothing."""
        is_known = False
        try:
            for record in all_records(source):
                for channel, data in rewriter.add(record):
                    tally.add(stream_of(rewriter.topics[channel]), data)
                # As soon as it is known, not when all of another rig's file has been copied.
                is_known = is_known or _manifest(path, rewriter, self.rig) is not None
                self.breath()
        except DamageError as damage:
            return str(damage)
        except UNREADABLE as err:
            return f"a record cannot be read ({err or type(err).__name__})"
        return ""


class _Tally:
    """What has been copied: samples, and gaps between them."""

    def __init__(self) -> None:
        self.samples = 0
        self._gaps: list[range] = []

    def add(self, stream: str, data: bytes) -> None:
        """Count a message."""
        if stream == "sample":
            self.samples += 1
        elif stream == "gap":
            gap = protobuf.message_class(protobuf.GAP).FromString(data)
            self._gaps.append(range(gap.k_first, gap.k_first + gap.count))

    def missing(self, manifest: Manifest) -> int:
        """Return how many samples of the run the gaps are short of."""
        due = manifest.due
        within = (range(max(g.start, due.start), min(g.stop, due.stop)) for g in self._gaps)
        return min(sum(len(gap) for gap in within), 1 << 62)


def sentence(done: RecoveredFile) -> str:
    """Return what was recovered, for a person."""
    manifest, outcome = done.manifest, done.outcome
    seconds = (outcome.samples + outcome.missing) * manifest.Ts
    text = f"{done.path}: recovered, {outcome.samples} samples, {seconds:g} s of "
    text += f"{manifest.samples * manifest.Ts:g} s"
    if done.recovered.cut_off_bytes:
        text += f"; a torn write of {done.recovered.cut_off_bytes} B behind them is cut off"
    return text


def _manifest(path: Path, rewriter: Rewriter, rig: str) -> Manifest | None:
    """Return the manifest that was copied; None where none was yet."""
    if RUN not in rewriter.metadata:
        return None
    manifest = _told(path, manifest_of, rewriter.metadata[RUN])
    if rig and manifest.rig != rig:
        raise NotOursError(f"{path}: a recording of rig {manifest.rig}")
    return manifest


_R = TypeVar("_R", Manifest, Outcome, Recovered)


def _told(path: Path, read: Callable[[dict[str, str]], _R], metadata: dict[str, str]) -> _R:
    """Return what a metadata record of ours says."""
    try:
        record = read(metadata)
        check_whole_numbers(record)
    except (msgspec.DecodeError, ValueError, RecursionError, OverflowError) as err:
        raise RecoveryError(f"{path}: its manifest is not armrig's; it stays as it is") from err
    return record
