"""A rig recorded from afar: what its daemon publishes, in the same files as the daemon's own."""

from __future__ import annotations

import json
import platform
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from armrig_core import protobuf
from armrig_core.manifest import Manifest
from armrig_core.recording_file.outgoing import Outgoing
from armrig_core.recording_file.recorder import Recording
from armrig_core.telemetry import Sample
from google.protobuf.message import DecodeError

from armrig.rig.live_gaps import LiveGap, gaps_between
from armrig.rig.remote_source import Piece
from armrig.rig.session import RigError
from armrig.rig.telemetry_stream import decoded

EXPERIMENT = "remote"
"""Kind of what is recorded from afar: whatever the rig did."""
CUT_OFF = "the recorder was cut off for longer than the daemon keeps what it published"
STARTED_ANEW = "the daemon was started anew, and counts anew"
_FINISH_S = 60.0
_MOST_WAITING = 100_000  # messages until a state says the sampling time; it comes once a second
Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedFile:
    """A file that is complete."""

    path: Path
    outcome: str
    samples: int
    missing: int


@dataclass(slots=True, kw_only=True)
class RemoteRecording:
    """Writes what comes; a new file begins where samples count anew or come at another rate."""

    path: Path
    """Of the first file; the second is NAME-2.mcap."""
    rig: str
    endpoint: str
    tell: Tell
    """Called with a line for a person."""
    done: list[RecordedFile] = field(default_factory=list)
    """Files that are complete."""
    samples: int = 0
    """Recorded so far, in all files."""
    _file: Recording | None = None
    _last: Sample | None = None
    _told: list[Any] = field(default_factory=list)
    _waiting: list[Outgoing] = field(default_factory=list)
    _state: Any = None
    _offset_ns: int = 0

    def add(self, piece: Piece) -> None:
        """Record what came.

        Raises
        ------
        RigError
            A message is not armrigd's, or nothing more can be written.
        """
        self._offset_ns = piece.past.clock_offset_ns
        if piece.is_new_life:
            self.tell(STARTED_ANEW)
            self._end(STARTED_ANEW)
            self._state = None
        if piece.lost:
            self._warn(f"{CUT_OFF}: {piece.lost} messages are lost")
        for stream, data in piece.past.messages:
            try:
                self._take(stream, data)
            except (ValueError, DecodeError) as err:
                msg = f"{len(data)} B of the stream {stream!r} are no message of armrigd's ({err})"
                raise RigError(msg) from err
        if self._file is not None and self._waiting:
            self._file.add(self._waiting)
            self._waiting = []
        if self._file is not None and self._file.error:
            raise RigError(self._file.error)
        if len(self._waiting) > _MOST_WAITING:
            msg = f"rig {self.rig}: no state came with {_MOST_WAITING} messages, so its sampling "
            raise RigError(msg + "time is not known; what answers there is no armrigd")

    def finish(self, outcome: str) -> None:
        """Complete the file."""
        self._end(outcome)

    def _warn(self, text: str) -> None:
        """Say something to the person, and in the file."""
        self.tell(text)
        now_ns = time.time_ns()
        message = protobuf.message_class(protobuf.LOG)(
            level=protobuf.LEVELS["warning"], message=text, name="armrig record"
        )
        message.timestamp.FromNanoseconds(now_ns)
        self._write("event", now_ns - self._offset_ns, message.SerializeToString())

    def _take(self, stream: str, data: bytes) -> None:
        message = decoded(stream, data)
        if stream == "sample":
            self._take_sample(message, data)
            return
        if stream == "state":
            if self._state is not None and self._state.Ts_s != message.Ts_s:
                self._end(f"the sampling time became {message.Ts_s:g} s")
            self._state = message
        if stream == "gap":
            self._told.append(message)
        self._write(stream, _host_ns(stream, message, self._offset_ns), data)

    def _take_sample(self, sample: Sample, data: bytes) -> None:
        last = self._last
        if last is not None and sample.k <= last.k:
            self._end(STARTED_ANEW)
        elif last is not None:
            for gap in gaps_between(last, sample, self._told):
                if gap.published:
                    self._write("gap", gap.t_to_ns, _gap(gap))
        if self._file is None and self._state is not None and self._state.Ts_s > 0:
            self._begin(sample)
        self._last, self._told = sample, []
        self._write("sample", sample.t_host_ns, data, sample)
        self.samples += 1

    def _write(self, stream: str, t_ns: int, data: bytes, sample: Sample | None = None) -> None:
        due_ns, number = (sample.t_sched_ns, sample.k) if sample else (t_ns, 0)
        self._waiting.append(Outgoing(stream, t_ns, due_ns, number, data))

    def _begin(self, sample: Sample) -> None:
        number = len(self.done) + 1
        path = self.path if number == 1 else self.path.with_stem(f"{self.path.stem}-{number}")
        self._file = Recording(
            path, self._manifest(), {}, t_first_ns=sample.t_host_ns, changed=lambda: None
        )

    def _manifest(self) -> Manifest:
        uname = platform.uname()
        return Manifest(
            rig=self.rig,
            run_id=secrets.token_hex(4),
            experiment=EXPERIMENT,
            details={"recorded_from": self.endpoint},
            Ts=self._state.Ts_s,
            samples=0,  # nobody asked for a number of them
            started=datetime.now(UTC).astimezone().isoformat(timespec="milliseconds"),
            clock_offset_ns=self._offset_ns,
            armrig=version("armrig"),
            protocol="",
            device=_device(self._state.device),
            host={"kernel": f"{uname.system} {uname.release} {uname.version}"},
        )

    def _end(self, outcome: str) -> None:
        file, self._file = self._file, None
        waiting, self._waiting = self._waiting, []
        self._last, self._told = None, []
        if file is None:
            return
        file.add(waiting)
        file.finish(outcome)
        file.join(_FINISH_S)
        if file.error:
            raise RigError(file.error)
        self.done.append(
            RecordedFile(path=file.kept, outcome=outcome, samples=file.synced, missing=file.missing)
        )


def _device(text: str) -> dict[str, Any]:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _gap(gap: LiveGap) -> bytes:
    message = protobuf.message_class(protobuf.GAP)(
        k_first=gap.k_first,
        count=gap.count,
        t_from_ns=gap.t_from_ns,
        t_to_ns=gap.t_to_ns,
        u_held_v=gap.u_held_v,
        reason=CUT_OFF,
    )
    return bytes(message.SerializeToString())


def _host_ns(stream: str, message: Any, clock_offset_ns: int) -> int:
    """Return when a message was published, on the host's monotonic clock."""
    if stream == "event":
        stamp = message.timestamp
        return int(stamp.seconds) * 1_000_000_000 + int(stamp.nanos) - clock_offset_ns
    return int(message.t_to_ns if stream == "gap" else message.t_host_ns)
