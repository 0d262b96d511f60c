"""Recorder of a rig over a network; its files have the format of the daemon's recordings."""

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
from typing import Any, NamedTuple, Protocol

import msgspec
import zenoh
from armrig_core.commands.codes import CONTINUED, Ending, GapCode, OutcomeCode
from armrig_core.errors import InputError
from armrig_core.process.printable import plural
from armrig_core.recording_file.manifest import Manifest, check_whole_numbers
from armrig_core.recording_file.part_names import ACTIVE
from armrig_core.recording_file.recorder import ActiveRecording, RecordingError
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.telemetry import Outgoing, Sample
from google.protobuf.message import DecodeError

from armrig.recordings.files.recording_summary import REMOTE
from armrig.recordings.grid import MISSING_LIMIT, TS_LEAST_S, TS_LIMIT_S
from armrig.rig.remote_source import Piece, RemoteSource
from armrig.rig.session import RigError, service_has_stopped, service_stop_sentence
from armrig.rig.telemetry_stream import LiveGap, Newest, decode, gap_store, gaps_between

STARTED_ANEW = "the daemon was restarted, and its counts begin again"
MOST_ROWS = 1 << 23
"""Largest number of samples in a file, including missing samples: 2.3 h at 1 kHz."""
_FINISH_TIMEOUT_S = 60.0
_MAX_FILES, _MAX_FILES_PERIOD_S = 60, 60.0  # no daemon causes more files in this time
# Messages wait for the first state, because only the state contains Ts.
_MAX_WAITING_BYTES, _OVERHEAD_BYTES = 16 << 20, 200
_MAX_PENDING_PIECES, _DISK_INTERVAL_S = 16, 0.01  # pieces not yet on the disk
Tell = Callable[[str], None]
_LIMIT = 1 << 62
"""Upper limit: valid times, in ns, and valid sample indices are below this number."""
_QUERY_INTERVAL_S = 0.2
_MAX_SILENCE_S = 2.0
_MAX_LAST_PIECES = 64


class DiskError(RigError):
    """A file cannot be created or completed; the message contains the path and the remedy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedFile:
    """A complete file."""

    path: Path
    outcome: str
    samples: int
    missing: int


@dataclass(slots=True, kw_only=True)
class RemoteRecording:
    """Writer of a rig's messages into one or several files.

    A new file begins if the sample index restarts, or if the sampling time changes. A file with too
    many samples or too many missing samples cannot be loaded. A new file therefore begins before
    the current file reaches one of these limits.
    """

    path: Path
    """Path of the first file, NAME.mcap; the second file is NAME-2.mcap."""
    rig: str
    endpoint: str
    tell: Tell
    """Function that is called with each message for the user."""
    done: list[RecordedFile] = field(default_factory=list)
    """Complete files."""
    _file: ActiveRecording | None = None
    _first: Sample | None = None
    _last: Sample | None = None
    _missing: int = 0
    _told: Newest[Any] = field(default_factory=gap_store)
    _waiting: list[Outgoing] = field(default_factory=list)
    _waiting_size: int = 0
    _state: Any = None
    _offset_ns: int = 0
    _number: int = 0
    _begun: deque[float] = field(default_factory=lambda: deque(maxlen=_MAX_FILES))

    def add(self, piece: Piece) -> None:
        """Record the messages of a piece; wait if too many pieces are not yet on the disk.

        Raises RigError if a message is not from an armrigd, or the disk cannot be written.
        """
        self._offset_ns = piece.past.clock_offset_ns
        if piece.is_new_life:
            self.tell(STARTED_ANEW)
            self.finish(Ending(OutcomeCode.RECORDER, STARTED_ANEW))
            self._state = None
        if piece.lost:
            self._warn(
                f"{GapCode.RECORDER_CUT_OFF.sentence}: "
                f"{plural(piece.lost, 'message is', 'messages are')} lost"
            )
        for stream, data in piece.past.messages:
            self._take(remote_message(stream, data, self._offset_ns))
        self._hand_over()

    def _hand_over(self) -> None:
        file = self._file
        if file is None:
            if self._waiting_size > _MAX_WAITING_BYTES:
                raise RigError(
                    f"rig {self.rig}: no state came with {plural(len(self._waiting), 'message')}, "
                    "so its sampling time is unknown; the sender is not an armrigd"
                )
            return
        file.add(self._drain())
        # Wait: a full queue of the file would drop messages, but the daemon keeps later messages.
        while file.behind > _MAX_PENDING_PIECES and not file.error:
            time.sleep(_DISK_INTERVAL_S)
            file.look()
        file.look()
        if file.error:
            raise DiskError(file.error)

    def _drain(self) -> list[Outgoing]:
        waiting, self._waiting, self._waiting_size = self._waiting, [], 0
        return waiting

    def _warn(self, text: str) -> None:
        """Report a warning to the user, and write the warning into the file."""
        self.tell(text)
        now_ns = time.time_ns()
        message = protobuf.message_class(protobuf.LOG)(
            level=protobuf.LEVELS["warning"],
            message=text,
            name="armrig record",
            emulator_stall_ns=0,
        )
        message.timestamp.FromNanoseconds(now_ns)
        t_ns = max(now_ns - self._offset_ns, 0)
        self._write(Outgoing("event", t_ns, t_ns, 0, message.SerializeToString()))

    def _take(self, message: RemoteMessage) -> None:
        if message.stream == "gap":
            # The next sample writes the gap: both neighbours of the gap are then in the file.
            self._told.add(message.value, len(message.data))
            return
        if message.stream == "sample":
            self._go_on(message.value)
        elif message.stream == "state":
            if self._state is not None and self._state.Ts_s != message.value.Ts_s:
                text = f"the sampling time became {message.value.Ts_s:g} s"
                self.finish(Ending(OutcomeCode.RECORDER, text))
            self._state = message.value
        self._write(message.outgoing())

    def _go_on(self, sample: Sample) -> None:
        """Write the gap before a sample, or begin a file with the sample."""
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
            msg = f"rig {self.rig}: sample {sample.k} came after sample {last.k}; the sender "
            raise RigError(msg + "is not an armrigd")
        self._missing += sample.k - last.k - 1
        if self._missing > MISSING_LIMIT:
            text = (
                f"{plural(sample.k - last.k - 1, 'sample is', 'samples are')} missing after "
                "its last sample"
            )
            self.finish(Ending(OutcomeCode.RECORDER, text))
        elif sample.k - first.k >= MOST_ROWS:
            self.finish(CONTINUED)
        elif sample.k > last.k + 1:
            for gap in gaps_between(last, sample, self._told):
                self._write(Outgoing("gap", gap.t_to_ns, gap.t_to_ns, 0, _gap(gap)))

    def _write(self, message: Outgoing) -> None:
        self._waiting.append(message)
        self._waiting_size += len(message.data) + _OVERHEAD_BYTES

    def _begin(self, first: Sample) -> None:
        now_s = time.monotonic()
        if len(self._begun) == _MAX_FILES and now_s - self._begun[0] < _MAX_FILES_PERIOD_S:
            msg = f"rig {self.rig}: {_MAX_FILES} files in a minute, because the index of its "
            msg += "samples restarts, or their rate changes, again and again; "
            raise RigError(msg + "the sender is not an armrigd")
        self._begun.append(now_s)
        path = self._free_path()
        manifest = remote_manifest(self.rig, self.endpoint, self._state, self._offset_ns)
        try:
            self._file = ActiveRecording.create(
                path, manifest, {}, t_first_ns=first.t_host_ns, changed=lambda: None
            )
        except RecordingError as err:
            why = getattr(err.__cause__, "strerror", "") or err
            raise DiskError(f"{path}: {why}; give a folder with free space by -o") from err

    def _free_path(self) -> Path:
        """Return the path of the next file, at which no file exists."""
        while True:
            self._number += 1
            end = f"-{self._number}" if self._number > 1 else ""
            path = self.path.with_stem(f"{self.path.stem}{end}")
            if not any(os.path.lexists(taken) for taken in (path, f"{path}{ACTIVE}")):
                return path

    def finish(self, ended: Ending) -> None:
        """Complete the current file, and write its outcome."""
        file, self._file = self._file, None
        waiting = self._drain()
        self._first = self._last = None
        self._missing = 0
        self._told.take()
        if file is None:
            return
        file.add(waiting)
        file.finish(ended)
        file.join(_FINISH_TIMEOUT_S)
        if not file.kept.name.endswith(ACTIVE):  # the file is complete
            how = "its recording ended early" if file.error else ended.text
            self.done.append(
                RecordedFile(path=file.kept, outcome=how, samples=file.synced, missing=file.missing)
            )
        if file.error:
            raise DiskError(file.error)


def recorder_ended(err: Exception) -> Ending:
    """Return the outcome of a file whose recorder failed."""
    return Ending(OutcomeCode.RECORDER, f"the recorder ended: {err}")


def _gap(gap: LiveGap) -> bytes:
    missed = GapCode.RECORDER_CUT_OFF
    message = protobuf.message_class(protobuf.GAP)(
        k_first=gap.k_first,
        count=gap.count,
        t_from_ns=gap.t_from_ns,
        t_to_ns=gap.t_to_ns,
        u_held_v=gap.u_held_v,
        reason=missed.sentence if gap.published else gap.reason,
        code=missed if gap.published else gap.code,
    )
    return bytes(message.SerializeToString())


def remote_manifest(rig: str, endpoint: str, state: Any, clock_offset_ns: int) -> Manifest:
    """Return the manifest of a recording that begins at the time of the call.

    `state` is the newest state that the daemon published (armrig.v1.State). If its description of
    the device is valid in a manifest, the manifest contains this description.
    """
    uname = platform.uname()
    manifest = Manifest(
        rig=rig,
        run_id=secrets.token_hex(4),
        experiment=REMOTE,
        details={"recorded_from": endpoint},
        Ts=state.Ts_s,
        samples=0,  # the length was not requested
        started=datetime.now(UTC).astimezone().isoformat(timespec="milliseconds"),
        clock_offset_ns=clock_offset_ns,
        armrig=version("armrig"),
        protocol="",
        host={"kernel": f"{uname.system} {uname.release} {uname.version}"},
    )
    try:
        device = msgspec.json.decode(state.device, type=dict[str, Any])
        complete = msgspec.structs.replace(manifest, device=device)
        check_whole_numbers(complete)
        complete.metadata()
    except (ValueError, OverflowError, RecursionError):  # a DecodeError is a ValueError
        return manifest
    return complete


class RemoteMessage(NamedTuple):
    """A message of a rig, with its stream and the time of its publication."""

    stream: str
    data: bytes
    value: Any
    """A `Sample`, or a protobuf message."""
    t_ns: int
    """Time of the publication, in ns of the host's monotonic clock."""

    def outgoing(self) -> Outgoing:
        """Return the message in the form that a recorder accepts."""
        due_ns, number = self.t_ns, 0
        if self.stream == "sample":
            due_ns, number = self.value.t_sched_ns, self.value.k
        return Outgoing(self.stream, self.t_ns, due_ns, number, self.data)


def remote_message(stream: str, data: bytes, clock_offset_ns: int) -> RemoteMessage:
    """Decode a received message, and check its values.

    The clock offset is the real-time clock minus the monotonic clock, in ns, on the daemon's host.

    Raises RigError if the message is not a valid message of a daemon.
    """
    try:
        if not 0 <= clock_offset_ns < _LIMIT:
            raise InputError(f"the clock offset {clock_offset_ns} ns is not possible")
        value = decode(stream, data)
        _check(stream, value)
    except (ValueError, DecodeError) as err:
        raise RigError(
            f"{len(data)} B of the stream {stream!r} are not a message of armrigd ({err})"
        ) from err
    return RemoteMessage(stream, data, value, _host_ns(stream, value, clock_offset_ns))


def _check(stream: str, value: Any) -> None:
    """Raise InputError for values that a recording cannot contain, or that `load` refuses."""
    times: list[int] = []
    if stream == "sample":
        times = [value.t_host_ns, value.t_sched_ns, value.k]
    elif stream == "gap":
        times = [value.t_from_ns, value.t_to_ns, value.k_first + value.count]
    elif stream != "event":
        times = [value.t_host_ns]
    for ns in times:
        if not 0 <= ns < _LIMIT:
            raise InputError(f"the time or index {ns} is not possible")
    # The sampling time is 0 until a device has answered.
    if stream == "state" and value.Ts_s != 0 and not TS_LEAST_S <= value.Ts_s < TS_LIMIT_S:
        raise InputError(f"the sampling time {value.Ts_s:g} s is not possible")


def _host_ns(stream: str, value: Any, clock_offset_ns: int) -> int:
    if stream == "event":
        stamp = value.timestamp
        event_ns = int(stamp.seconds) * 1_000_000_000 + int(stamp.nanos) - clock_offset_ns
        return min(max(event_ns, 0), _LIMIT)  # the real-time clock may have been set
    return int(value.t_to_ns if stream == "gap" else value.t_host_ns)


class Ended(Protocol):
    """Signal that ends a recorder, such as a process signal or an Event of another thread."""

    def is_set(self) -> bool:
        """Return whether the recorder must end."""

    def wait(self, timeout: float) -> bool:
        """Wait for the signal, at most `timeout` seconds; return whether the recorder must end."""


class RemoteRecorder:
    """Recorder of all messages of a rig, also of the earlier messages that its daemon keeps."""

    def __init__(self, session: zenoh.Session, recording: RemoteRecording) -> None:
        """Prepare a recorder; no query is sent yet."""
        self.recording = recording
        self._row = RemoteSource(session, recording.rig)

    def begin(self) -> bool:
        """Record the oldest messages that the daemon keeps; return True if the daemon answers.

        Raises RigError if the sender is not an armrigd, or the disk cannot be written.
        """
        piece = self._row.next_piece()
        if piece is not None:
            self.recording.add(piece)
        return piece is not None

    def record(self, ended: Ended, seconds: float | None = None) -> None:
        """Record all messages that are published until `ended` is set or `seconds` have passed.

        Raises RigError if the sender is not an armrigd, or the disk cannot be written.
        """
        rig, tell = self.recording.rig, self.recording.tell
        stopped = service_has_stopped(rig, self.recording.endpoint) and service_stop_sentence(rig)
        begun = heard = time.monotonic()
        silent = False
        while not ended.is_set() and (seconds is None or time.monotonic() - begun < seconds):
            piece = self._row.next_piece()
            now = time.monotonic()
            if piece is None:
                if now - heard > _MAX_SILENCE_S and not silent:
                    tell(f"{stopped or f'rig {rig} does not answer'}; waiting for it")
                    silent = True
                ended.wait(_QUERY_INTERVAL_S)
                continue
            if silent:
                tell(f"rig {rig} answers again, after {now - heard:.1f} s")
            elif piece.is_new_life and stopped:
                tell(stopped)
            heard, silent = now, False
            self.recording.add(piece)
            if not piece.is_full:  # otherwise more messages are waiting
                ended.wait(_QUERY_INTERVAL_S)
        self._catch_up()

    def _catch_up(self) -> None:
        """Record the messages published before the call, if the daemon still keeps them."""
        for _ in range(_MAX_LAST_PIECES):
            piece = self._row.next_piece()
            if piece is None:
                break
            self.recording.add(piece)
            if not piece.is_full:
                break
