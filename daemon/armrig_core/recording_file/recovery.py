"""Recovery of unfinished recordings: the undamaged beginning becomes a complete recording.

The daemon recovers its recordings when it starts. `armrig recover` recovers the recordings that its
user names, on any machine.
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

from armrig_core.commands.codes import OutcomeCode
from armrig_core.process.printable import plural
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.byte_source import ByteSource
from armrig_core.recording_file.file_records import MAGIC, UNREADABLE
from armrig_core.recording_file.manifest import (
    OUTCOME,
    RECOVERED,
    RUN,
    Manifest,
    Outcome,
    Recovered,
    check_whole_numbers,
)
from armrig_core.recording_file.opening import lock
from armrig_core.recording_file.part_names import ACTIVE, COPY
from armrig_core.recording_file.rewriting import Rewriter, all_records, sync_directory
from armrig_core.recording_file.unfinished import NotOursError, RecoveryError, open_locked
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.topics import stream_of

CUT_OFF = "cut off: its recorder died or could not write"
"""Outcome of a run whose recording contains no outcome."""
MOST_CUT_OFF = 1 << 20
"""Size of the largest damaged end that a recovery cuts off, in B.

One torn write is shorter than this limit. If more bytes follow the damage, the damage is in the
middle of the file. The file is then kept unchanged, because the bytes may become readable.
"""


class RecoveredFile(NamedTuple):
    """A recovered recording."""

    path: Path
    """Path of the complete file."""
    manifest: Manifest
    outcome: Outcome
    recovered: Recovered


@dataclass(frozen=True, slots=True, kw_only=True)
class Recovery:
    """Settings of a recovery: the program that recovers, and the files that it may recover."""

    armrig: str
    """Version of armrig."""
    now: Callable[[], str]
    """Function that returns the time of day, ISO 8601."""
    owner: int | None = None
    """Id of the user whose files may be recovered; None for all users."""
    rig: str = ""
    """Id of the rig whose recordings may be recovered; "" for all rigs."""
    breath: Callable[[], None] = lambda: None
    """Function that is called between two records; it may wait."""

    def recover(self, path: Path) -> RecoveredFile:
        """Complete an unfinished recording NAME.mcap.active as NAME.mcap.

        The undamaged beginning is kept. The recovery appends a record of itself, and an outcome if
        the file has none. When the new file is on the disk, it replaces the old file.

        Raises NotOursError if the file is being written, or belongs to another rig. Raises
        RecoveryError if the file cannot be recovered and stays as it is.
        """
        if not path.name.endswith(f".mcap{ACTIVE}"):
            raise RecoveryError(
                f"{path}: an unfinished recording ends in .mcap{ACTIVE}; this file stays as it is"
            )
        final = path.with_name(path.name.removesuffix(ACTIVE))
        copy = path.with_name(final.name + COPY)
        try:
            with open_locked(path, self.owner) as stream:
                if os.path.lexists(final):
                    raise RecoveryError(
                        f"{path}: {final.name} exists already; move one of the two files away"
                    )
                # This process holds the lock, so a process that died has left any existing copy.
                copy.unlink(missing_ok=True)
                try:
                    done = self._copy(path, stream, copy)
                    if sys.platform == "win32":  # Windows cannot rename an open file
                        stream.close()
                    # If the process dies between these calls, `path` or `final` is complete.
                    copy.replace(path)
                    path.replace(final)
                    sync_directory(final.parent)
                except BaseException:
                    with suppress(OSError):
                        copy.unlink(missing_ok=True)
                    raise
        except OSError as err:
            msg = f"{path}: {err.strerror or err}; the file stays as it is; correct the cause, "
            raise RecoveryError(msg + "then `armrig recover` it") from err
        return RecoveredFile(final, *done)

    def _copy(
        self, path: Path, stream: IO[bytes], copy: Path
    ) -> tuple[Manifest, Outcome, Recovered]:
        """Write the undamaged records to `copy`; complete the copy, and sync it to the disk."""
        size = os.fstat(stream.fileno()).st_size
        source = ByteSource(stream, size)
        if source.read(len(MAGIC)) != MAGIC:
            content = "not an MCAP file" if size else "0 B"
            raise RecoveryError(f"{path}: {content}: nothing was recorded; delete it")
        with copy.open("xb") as target:
            lock(target)
            rewriter, tally = Rewriter(target, size), _Tally()
            damage = self._copy_records(path, source, rewriter, tally)
            tail_size = size - source.whole
            # The last 28 B of a complete file begin with the place of the index: records may lie
            # between a damage and the index.
            stream.seek(max(size - 28, 0))
            end = stream.read(28)
            is_torn = not end.endswith(MAGIC) or source.at >= int.from_bytes(end[:8], "little")
            if damage and (tail_size > MOST_CUT_OFF or not is_torn):
                msg = f"{path}: {damage}, and {tail_size} B follow; the file stays as it is; "
                raise RecoveryError(msg + "`armrig info` reads the undamaged data")
            manifest = _manifest(path, rewriter, self.rig)
            if manifest is None:
                why = damage or "it contains no metadata named armrig.run"
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
                outcome = _read_record(path, Outcome, rewriter.metadata[OUTCOME])
                if tally.samples < outcome.samples:
                    raise RecoveryError(
                        f"{path}: the run was recorded to the end, but only {tally.samples} of its "
                        f"{plural(outcome.samples, 'sample is', 'samples are')} readable; the file "
                        "stays as it is; copy it again"
                    )
            else:
                rewriter.add_metadata(OUTCOME, outcome.metadata())
            recovered = Recovered(
                when=self.now(),
                armrig=self.armrig,
                kept_bytes=source.whole,
                cut_off_bytes=tail_size,
                damage="; ".join([*rewriter.left_out, *([str(damage)] if damage else [])]),
            )
            if RECOVERED in rewriter.metadata:  # an interrupted recovery wrote it
                recovered = _read_record(path, Recovered, rewriter.metadata[RECOVERED])
            else:
                rewriter.add_metadata(RECOVERED, recovered.metadata())
            rewriter.finish()
            target.flush()
            os.fsync(target.fileno())
        return manifest, outcome, recovered

    def _copy_records(
        self, path: Path, source: ByteSource, rewriter: Rewriter, tally: _Tally
    ) -> DamageError | None:
        """Copy the undamaged records; return the damage at which the copy ends, or None."""
        is_known = False
        try:
            for record in all_records(source):
                for channel, data in rewriter.add(record):
                    tally.add(stream_of(rewriter.topics[channel]), data)
                # Check the rig as soon as the manifest is known: the file of another rig need not
                # be copied to its end.
                is_known = is_known or _manifest(path, rewriter, self.rig) is not None
                self.breath()
        except DamageError as damage:
            return damage
        except UNREADABLE as err:
            return DamageError(f"a record cannot be read ({err or type(err).__name__})")
        return None


class _Tally:
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
        """Return the number of the run's samples that lie in the gaps."""
        due = manifest.due
        within = (range(max(g.start, due.start), min(g.stop, due.stop)) for g in self._gaps)
        return min(sum(len(gap) for gap in within), 1 << 62)


def sentence(done: RecoveredFile) -> str:
    """Return the result of a recovery as a sentence."""
    manifest, outcome = done.manifest, done.outcome
    seconds = (outcome.samples + outcome.missing) * manifest.Ts
    text = f"{done.path}: recovered, {plural(outcome.samples, 'sample')}, {seconds:g} s"
    text += f" of {manifest.samples * manifest.Ts:g} s" if manifest.samples else ""
    if done.recovered.cut_off_bytes:
        text += f"; the last {done.recovered.cut_off_bytes} B were incomplete and were cut off"
    return text


def _manifest(path: Path, rewriter: Rewriter, rig: str) -> Manifest | None:
    """Return the copied manifest; None before it is copied."""
    if RUN not in rewriter.metadata:
        return None
    manifest = _read_record(path, Manifest, rewriter.metadata[RUN])
    if rig and manifest.rig != rig:
        raise NotOursError(f"{path}: belongs to rig {manifest.rig}, not to rig {rig}")
    return manifest


_R = TypeVar("_R", Manifest, Outcome, Recovered)


def _read_record(path: Path, kind: type[_R], metadata: dict[str, str]) -> _R:
    try:
        record = kind.of(metadata)
        check_whole_numbers(record)
    except (msgspec.DecodeError, ValueError, RecursionError, OverflowError) as err:
        msg = f"{path}: a metadata record of armrig is not valid; the file stays as it is"
        raise RecoveryError(msg) from err
    return record
