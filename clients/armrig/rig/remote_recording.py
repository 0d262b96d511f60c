"""A rig recorded from afar: what its daemon publishes, in the same files as the daemon's own."""

from __future__ import annotations

import os
import platform
import secrets
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from armrig_core import protobuf
from armrig_core.codes import CONTINUED, Ending, OutcomeCode
from armrig_core.errors import InputError
from armrig_core.manifest import Manifest, check_whole_numbers
from armrig_core.recording_file.outgoing import Outgoing
from armrig_core.recording_file.part_names import ACTIVE
from armrig_core.recording_file.recorder import Recording, RecordingError
from armrig_core.telemetry import Sample
from google.protobuf.message import DecodeError

from armrig.recordings.grid import MISSING_LIMIT, TS_LEAST_S, TS_LIMIT_S
from armrig.recordings.recording_summary import REMOTE
from armrig.rig.live_gaps import LiveGap, Newest, gaps_between, told_gaps
from armrig.rig.remote_source import Piece
from armrig.rig.session import RigError
from armrig.rig.telemetry_stream import decoded

CUT_OFF = "the recorder was cut off for longer than the daemon keeps what it published"
STARTED_ANEW = "the daemon was started anew, and counts anew"
MOST_ROWS = 1 << 23
"""Samples of a file, missing ones too: 2.3 hours at 1 kHz; one may be loaded with twice as many."""
_FINISH_S = 60.0
_FILES, _FILES_S = 60, 60.0  # so many files in such a time are no daemon's
_MOST_WAITING, _OVERHEAD = 16 << 20, 200  # B until a state says Ts, which it does once a second
_MOST_BEHIND, _LOOK_S = 16, 0.01  # pieces that the disk may be behind
Tell = Callable[[str], None]
_LIMIT = 1 << 62
"""Above any time in ns, and any index of a sample."""


class DiskError(RigError):
    """The disk refuses a file, or the rest of it; the message says which and what to do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedFile:
    """A file that is complete."""

    path: Path
    outcome: str
    samples: int
    missing: int


@dataclass(slots=True, kw_only=True)
class RemoteRecording:
    """Writes what comes into a file, or several.

    A new one begins where samples count anew, come at another rate, or where with the next ones it
    could not be loaded: too many are missing, or there are too many.
    """

    path: Path
    """Of the first file; the second is NAME-2.mcap."""
    rig: str
    endpoint: str
    tell: Tell
    """Called with a line for a person."""
    done: list[RecordedFile] = field(default_factory=list)
    """Files that are complete."""
    _file: Recording | None = None
    _first: Sample | None = None
    _last: Sample | None = None
    _missing: int = 0
    _told: Newest[Any] = field(default_factory=told_gaps)
    _waiting: list[Outgoing] = field(default_factory=list)
    _waiting_size: int = 0
    _state: Any = None
    _offset_ns: int = 0
    _number: int = 0
    _begun: deque[float] = field(default_factory=lambda: deque(maxlen=_FILES))

    def add(self, piece: Piece) -> None:
        """Record what came; wait for the disk where it is behind.

        Raises
        ------
        RigError
            A message is not armrigd's, or nothing more can be written.
        """
        self._offset_ns = piece.past.clock_offset_ns
        if piece.is_new_life:
            self.tell(STARTED_ANEW)
            self._end(Ending(OutcomeCode.RECORDER, STARTED_ANEW))
            self._state = None
        if piece.lost:
            self._warn(f"{CUT_OFF}: {piece.lost} messages are lost")
        for stream, data in piece.past.messages:
            self._take(remote_message(stream, data, self._offset_ns))
        self._hand_over()

    def finish(self, ended: Ending) -> None:
        """Complete the file."""
        self._end(ended)

    def _hand_over(self) -> None:
        file = self._file
        if file is None:
            if self._waiting_size > _MOST_WAITING:
                raise RigError(
                    f"rig {self.rig}: no state came with {len(self._waiting)} messages, so its "
                    "sampling time is not known; what answers there is no armrigd"
                )
            return
        file.add(self._taken())
        # What waits meanwhile is kept by the daemon; nothing is dropped, as it is by a full queue.
        while file.behind > _MOST_BEHIND and not file.error:
            time.sleep(_LOOK_S)
        if file.error:
            raise DiskError(file.error)

    def _taken(self) -> list[Outgoing]:
        waiting, self._waiting, self._waiting_size = self._waiting, [], 0
        return waiting

    def _warn(self, text: str) -> None:
        """Say something to the person, and in the file."""
        self.tell(text)
        now_ns = time.time_ns()
        message = protobuf.message_class(protobuf.LOG)(
            level=protobuf.LEVELS["warning"], message=text, name="armrig record"
        )
        message.timestamp.FromNanoseconds(now_ns)
        t_ns = max(now_ns - self._offset_ns, 0)
        self._write(Outgoing("event", t_ns, t_ns, 0, message.SerializeToString()))

    def _take(self, message: RemoteMessage) -> None:
        if message.stream == "gap":
            # Written before the sample behind it: only then is it between two of the file's.
            self._told.add(message.value, len(message.data))
            return
        if message.stream == "sample":
            self._go_on(message.value)
        elif message.stream == "state":
            if self._state is not None and self._state.Ts_s != message.value.Ts_s:
                text = f"the sampling time became {message.value.Ts_s:g} s"
                self._end(Ending(OutcomeCode.RECORDER, text))
            self._state = message.value
        self._write(message.outgoing())

    def _go_on(self, sample: Sample) -> None:
        """Write what is missing before a sample, or begin a file with it."""
        if self._first is not None and self._last is not None:
            self._follow(self._first, self._last, sample)
        self._first = self._first or sample
        if self._file is None and self._state is not None and self._state.Ts_s > 0:
            self._begin(self._first)
        self._last = sample
        if self._told:
            self._told.take()

    def _follow(self, first: Sample, last: Sample, sample: Sample) -> None:
        if sample.k <= last.k:
            msg = f"rig {self.rig}: sample {sample.k} came behind sample {last.k}; what answers "
            raise RigError(msg + "there is no armrigd")
        self._missing += sample.k - last.k - 1
        if self._missing > MISSING_LIMIT:
            text = f"{sample.k - last.k - 1} samples are missing behind its last"
            self._end(Ending(OutcomeCode.RECORDER, text))
        elif sample.k - first.k >= MOST_ROWS:
            self._end(CONTINUED)
        elif sample.k > last.k + 1:
            for gap in gaps_between(last, sample, self._told):
                self._write(Outgoing("gap", gap.t_to_ns, gap.t_to_ns, 0, _gap(gap)))

    def _write(self, message: Outgoing) -> None:
        self._waiting.append(message)
        self._waiting_size += len(message.data) + _OVERHEAD

    def _begin(self, first: Sample) -> None:
        now_s = time.monotonic()
        if len(self._begun) == _FILES and now_s - self._begun[0] < _FILES_S:
            msg = f"rig {self.rig}: {_FILES} files in a minute: its samples count anew, or change "
            raise RigError(msg + "their rate, all the time; what answers there is no armrigd")
        self._begun.append(now_s)
        path = self._free_path()
        manifest = remote_manifest(self.rig, self.endpoint, self._state, self._offset_ns)
        try:
            self._file = Recording(
                path, manifest, {}, t_first_ns=first.t_host_ns, changed=lambda: None
            )
        except RecordingError as err:
            why = getattr(err.__cause__, "strerror", "") or err
            raise DiskError(f"{path}: {why}; give a place with room by -o") from err

    def _free_path(self) -> Path:
        """Return where the next file goes: nothing is there that it could replace."""
        while True:
            self._number += 1
            end = f"-{self._number}" if self._number > 1 else ""
            path = self.path.with_stem(f"{self.path.stem}{end}")
            if not any(os.path.lexists(taken) for taken in (path, f"{path}{ACTIVE}")):
                return path

    def _end(self, ended: Ending) -> None:
        file, self._file = self._file, None
        waiting = self._taken()
        self._first = self._last = None
        self._missing = 0
        self._told.take()
        if file is None:
            return
        file.add(waiting)
        file.finish(ended)
        file.join(_FINISH_S)
        if not file.kept.name.endswith(ACTIVE):  # whole, though the disk may have ended it
            how = "its recording ended early" if file.error else ended.text
            self.done.append(
                RecordedFile(path=file.kept, outcome=how, samples=file.synced, missing=file.missing)
            )
        if file.error:
            raise DiskError(file.error)


def recorder_ended(err: Exception) -> Ending:
    """Return how a file ends whose recorder failed."""
    return Ending(OutcomeCode.RECORDER, f"the recorder ended: {err}")


def _gap(gap: LiveGap) -> bytes:
    message = protobuf.message_class(protobuf.GAP)(
        k_first=gap.k_first,
        count=gap.count,
        t_from_ns=gap.t_from_ns,
        t_to_ns=gap.t_to_ns,
        u_held_v=gap.u_held_v,
        reason=CUT_OFF if gap.published else gap.reason,
    )
    return bytes(message.SerializeToString())


def remote_manifest(rig: str, endpoint: str, state: Any, clock_offset_ns: int) -> Manifest:
    """Return the manifest of a recording that begins now.

    Parameters
    ----------
    state : armrig.v1.State
        What the daemon last said; of its device only what fits into a manifest is taken.
    clock_offset_ns : int
        Real-time clock less monotonic clock, where the samples are made.
    """
    uname = platform.uname()
    manifest = Manifest(
        rig=rig,
        run_id=secrets.token_hex(4),
        experiment=REMOTE,
        details={"recorded_from": endpoint},
        Ts=state.Ts_s,
        samples=0,  # nobody asked for a number of them
        started=datetime.now(UTC).astimezone().isoformat(timespec="milliseconds"),
        clock_offset_ns=clock_offset_ns,
        armrig=version("armrig"),
        protocol="",
        host={"kernel": f"{uname.system} {uname.release} {uname.version}"},
    )
    try:
        device = msgspec.json.decode(state.device, type=dict[str, Any])
        told = msgspec.structs.replace(manifest, device=device)
        check_whole_numbers(told)
        told.metadata()
    except (ValueError, OverflowError, RecursionError):  # a DecodeError is a ValueError
        return manifest
    return told


class RemoteMessage(NamedTuple):
    """A message, and when it was published."""

    stream: str
    data: bytes
    value: Any
    """A `Sample`, or a protobuf message."""
    t_ns: int
    """On the host's monotonic clock."""

    def outgoing(self) -> Outgoing:
        """Return it as a recorder takes it."""
        due_ns, number = self.t_ns, 0
        if self.stream == "sample":
            due_ns, number = self.value.t_sched_ns, self.value.k
        return Outgoing(self.stream, self.t_ns, due_ns, number, self.data)


def remote_message(stream: str, data: bytes, clock_offset_ns: int) -> RemoteMessage:
    """Return a message as it came.

    Parameters
    ----------
    clock_offset_ns : int
        Real-time clock less monotonic clock, where it was made.

    Raises
    ------
    RigError
        It is none that a daemon sends.
    """
    try:
        if not 0 <= clock_offset_ns < _LIMIT:
            raise InputError(f"a clock offset of {clock_offset_ns} ns")
        value = decoded(stream, data)
        _check(stream, value)
    except (ValueError, DecodeError) as err:
        raise RigError(
            f"{len(data)} B of the stream {stream!r} are no message of armrigd's ({err})"
        ) from err
    return RemoteMessage(stream, data, value, _host_ns(stream, value, clock_offset_ns))


def _check(stream: str, value: Any) -> None:
    """Refuse what no recording can hold, or no reader of one would take."""
    times: list[int] = []
    if stream == "sample":
        times = [value.t_host_ns, value.t_sched_ns, value.k]
    elif stream == "gap":
        times = [value.t_from_ns, value.t_to_ns, value.k_first + value.count]
    elif stream != "event":
        times = [value.t_host_ns]
    for ns in times:
        if not 0 <= ns < _LIMIT:
            raise InputError(f"a time or an index of {ns}")
    # Until a rig is there it has no sampling time.
    if stream == "state" and value.Ts_s != 0 and not TS_LEAST_S <= value.Ts_s < TS_LIMIT_S:
        raise InputError(f"a sampling time of {value.Ts_s:g} s")


def _host_ns(stream: str, value: Any, clock_offset_ns: int) -> int:
    if stream == "event":
        stamp = value.timestamp
        told_ns = int(stamp.seconds) * 1_000_000_000 + int(stamp.nanos) - clock_offset_ns
        return min(max(told_ns, 0), _LIMIT)  # the real-time clock may have been set
    return int(value.t_to_ns if stream == "gap" else value.t_host_ns)
