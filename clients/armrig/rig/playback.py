"""Playback of a recorded run: the daemon's messages, and a session that publishes them again."""

from __future__ import annotations

import heapq
import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zenoh
from armrig_core.access.owned_session import group_may_open, session_configuration
from armrig_core.errors import FileError
from armrig_core.recording_file.manifest import Manifest, description_of
from armrig_core.rig.channels import DeviceChannel
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.channels import CHANNELS
from armrig_core.telemetry.telemetry import Sample, encode_sample
from armrig_core.telemetry.topics import STREAMS, alive_key, schema_key, stream_key
from msgspec import UNSET
from numpy.typing import NDArray

from armrig.recordings.daemon_reports import RecordingClock
from armrig.recordings.files.container import Content, stream_messages
from armrig.recordings.files.loading import EVERYTHING, clock_of, files_of, origin_of, run_content
from armrig.rig.session import RigError

_BLOCK_SAMPLES = 4096  # samples converted to Python numbers in one step
_MAX_RECEIVED_BYTES = 1 << 16  # a listener sends its subscriptions only
_MAX_SLEEP_S = 1.0  # longer pauses are divided: time.sleep refuses very long ones
_LISTENER_INTERVAL_S = 0.05
Publish = Callable[[str, bytes], None]


class Published(NamedTuple):
    """A message of the daemon, with its stream and its time of publication."""

    t: float
    """Time of publication in s from the run's first sample; negative before this sample."""
    stream: str
    """Name of the stream, such as sample."""
    data: bytes
    """Encoded message."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedRun:
    """Messages of a run, in the order in which they were published."""

    manifest: Manifest
    """Manifest of the run."""
    damage: str
    """Reason why the file could not be read to its end; "" for a complete file."""
    samples: NDArray[np.void]
    """Samples, as recorded."""
    others: tuple[Published, ...]
    """All other messages, in the order of their times."""
    clock: RecordingClock
    """Conversion of the host's times to `t`."""
    channels: tuple[DeviceChannel, ...] = CHANNELS
    """Channels of the rig, which name fields of the samples."""

    def __len__(self) -> int:
        """Return the number of messages."""
        return int(self.samples.size) + len(self.others)

    @property
    def seconds(self) -> float:
        """Time from the first message to the last, in s."""
        ends = [self.others[0].t, self.others[-1].t] if self.others else []
        if self.samples.size:
            ends += [self.clock.seconds(int(t)) for t in self.samples["t_host_ns"][[0, -1]]]
        return max(ends) - min(ends) if ends else 0.0

    def messages(self) -> Iterator[Published]:
        """Yield all messages, sorted by time; a gap's message precedes the sample after the gap."""
        return heapq.merge(self.others, self._samples(), key=lambda message: message.t)

    def _samples(self) -> Iterator[Published]:
        for begin in range(0, self.samples.size, _BLOCK_SAMPLES):
            for row in self.samples[begin : begin + _BLOCK_SAMPLES].tolist():
                sample = Sample._make(row)
                t = self.clock.seconds(sample.t_host_ns)
                yield Published(t, "sample", encode_sample(sample))


def read_run(path: Path, start: float | None = None, stop: float | None = None) -> PublishedRun:
    """Return the messages of a recorded run, from a file or from the parts of the run.

    The range is start <= t < stop, in s from the run's first sample.

    Raises FileError if the file cannot be loaded (see `armrig.load`), or the range contains no
    message. Raises OSError if the file cannot be opened or read.
    """
    paths = files_of(path)
    run = run_content(paths, start, stop, digest=False)
    content, manifest = run.content, run.manifest
    if manifest.controller_sha256 is not UNSET:
        decisions = chain.from_iterable(stream_messages(part, "control") for part in paths)
        content.messages["control"] = [*decisions]
    clock = clock_of(content, manifest, origin_of(content, manifest))
    first, end = run.between
    k = content.samples["k"]
    samples = content.samples[np.searchsorted(k, first) : np.searchsorted(k, end)]
    others = sorted(_others(content, clock), key=lambda message: message.t)
    if run.between != EVERYTHING:
        low, high = start or 0.0, np.inf if stop is None else stop
        others = [message for message in others if low <= message.t < high]
    if not (samples.size or others):
        raise FileError(f"{path}: contains nothing to publish")
    return PublishedRun(
        manifest=manifest,
        damage=content.damage,
        samples=samples,
        others=tuple(others),
        clock=clock,
        channels=description_of(content.attachments).channels,
    )


def _others(content: Content, clock: RecordingClock) -> Iterator[Published]:
    for stream, messages in content.messages.items():
        for message in messages:
            t = clock.seconds(_host_ns(stream, message, content, clock))
            yield Published(t, stream, message.SerializeToString())


def _host_ns(stream: str, message: Any, content: Content, clock: RecordingClock) -> int:
    """Return the time at which a message was published, on the host's monotonic clock."""
    if stream == "event":
        stamp = message.timestamp
        return int(stamp.seconds) * 1_000_000_000 + int(stamp.nanos) - clock.offset_ns
    if stream != "gap":
        return int(message.t_host_ns)
    after = np.searchsorted(content.samples["k"], min(message.k_first, (1 << 63) - 1))
    if after == content.samples.size:
        return int(message.t_to_ns)
    return min(int(message.t_to_ns), int(content.samples["t_host_ns"][after]))


class Stage:
    """Session that publishes the messages of a recording; `open_stage` creates this session."""

    def __init__(
        self, session: zenoh.Session, rig: str, channels: tuple[DeviceChannel, ...]
    ) -> None:
        self._session = session
        self._publishers = {
            stream: session.declare_publisher(
                stream_key(rig, stream),
                encoding=f"application/protobuf;{protobuf.OF_STREAM[stream]}",
                congestion_control=zenoh.CongestionControl.DROP,
            )
            for stream in STREAMS
        }
        self._served = {
            schema_key(rig, name): protobuf.descriptor_set(name, channels)
            for name in protobuf.OF_STREAM.values()
        }
        # Other queries get no answer: a client that got a status would take this session for a rig.
        session.declare_queryable(schema_key(rig, "**"), self._serve_schema)
        self._alive = session.liveliness().declare_token(alive_key(rig))

    def wait_for_listener(self) -> None:
        """Wait until a client listens to the samples."""
        while True:
            status: Any = self._publishers["sample"].matching_status
            if getattr(status, "matching", status):  # an object, but a bool in the stubs
                return
            time.sleep(_LISTENER_INTERVAL_S)

    def publish(self, stream: str, data: bytes) -> None:
        """Publish a message; zenoh drops it if a subscriber is too slow."""
        self._publishers[stream].put(data)

    def _serve_schema(self, query: zenoh.Query) -> None:
        with query:
            for key, data in self._served.items():
                if query.key_expr.intersects(zenoh.KeyExpr(key)):
                    query.reply(key, data)


@contextmanager
def open_stage(
    where: str, rig: str, channels: tuple[DeviceChannel, ...] = CHANNELS
) -> Iterator[Stage]:
    """Yield a session that listens at an endpoint; clients cannot publish or answer queries there.

    `channels` name fields of the schema of a sample.

    Raises RigError if the endpoint is not valid, is in use, or cannot be created.
    """
    config = session_configuration(where, most_received=_MAX_RECEIVED_BYTES)
    try:
        with group_may_open():
            session = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    except zenoh.ZError as err:
        raise RigError(
            f"no session can listen at {where}: {rig} is played there already, or {where} is not a "
            "zenoh endpoint, such as tcp/127.0.0.1:7447; choose another endpoint with --listen"
        ) from err
    with session:
        yield Stage(session, rig, channels)


def play(run: PublishedRun, publish: Publish, *, speed: float) -> Iterator[Published]:
    """Publish the messages of a run when they are due; yield each message after its publication.

    `speed` is relative to the recording: 2 plays the run in half its time.
    """
    began_s, first_t = time.monotonic(), None
    for message in run.messages():
        first_t = message.t if first_t is None else first_t
        _sleep_until(began_s + (message.t - first_t) / speed)
        publish(message.stream, message.data)
        yield message


def rest(run: PublishedRun, *, speed: float) -> None:
    """Wait for one sampling time, divided by `speed`, before the next playback of a run."""
    _sleep_until(time.monotonic() + run.manifest.Ts / speed)


def _sleep_until(due_s: float) -> None:
    while (left_s := due_s - time.monotonic()) > 0:
        time.sleep(min(left_s, _MAX_SLEEP_S))
