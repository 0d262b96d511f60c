"""Messages that the daemon published during a recorded run."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from armrig_core.errors import FileError
from armrig_core.manifest import Manifest
from armrig_core.telemetry import Sample, encode_sample
from numpy.typing import NDArray

from armrig.recordings.container import Content
from armrig.recordings.daemon_reports import Clock
from armrig.recordings.loading import EVERYTHING, clock_of, files_of, origin_of, run_content

_BLOCK_SAMPLES = 4096  # samples converted to Python numbers in one step


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
    clock: Clock
    """Conversion of the host's times to `t`."""

    def __len__(self) -> int:
        """Return the number of messages."""
        return int(self.samples.size) + len(self.others)

    @property
    def seconds(self) -> float:
        """Time from the first message to the last, in s."""
        ends = [self.others[0].t, self.others[-1].t] if self.others else []
        ends += [self._t(int(row["t_host_ns"])) for row in self.samples[[0, -1]]] * (
            self.samples.size > 0
        )
        return max(ends) - min(ends) if ends else 0.0

    def messages(self) -> Iterator[Published]:
        """Yield all messages, sorted by time; a gap's message precedes the sample after the gap."""
        return heapq.merge(self.others, self._samples(), key=lambda message: message.t)

    def _samples(self) -> Iterator[Published]:
        for begin in range(0, self.samples.size, _BLOCK_SAMPLES):
            for row in self.samples[begin : begin + _BLOCK_SAMPLES].tolist():
                sample = Sample._make(row)
                yield Published(self._t(sample.t_host_ns), "sample", encode_sample(sample))

    def _t(self, host_ns: int) -> float:
        return self.clock.seconds(host_ns)


def published(path: Path, start: float | None = None, stop: float | None = None) -> PublishedRun:
    """Return the messages of a recorded run, from a file or from the parts of the run.

    Parameters
    ----------
    start, stop : float, optional
        Range of messages, start <= t < stop, in s from the run's first sample.

    Raises
    ------
    FileError
        The file cannot be loaded (see `armrig.load`), or the range contains no message.
    OSError
        The file cannot be opened or read.
    """
    found = run_content(files_of(path), start, stop, digest=False)
    content, manifest = found.content, found.manifest
    clock = clock_of(content, manifest, origin_of(content, manifest))
    first, end = found.between
    k = content.samples["k"]
    samples = content.samples[np.searchsorted(k, first) : np.searchsorted(k, end)]
    others = sorted(_others(content, clock), key=lambda message: message.t)
    if found.between != EVERYTHING:
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
    )


def _others(content: Content, clock: Clock) -> Iterator[Published]:
    for stream, messages in content.messages.items():
        for message in messages:
            t = clock.seconds(_host_ns(stream, message, content, clock))
            yield Published(t, stream, message.SerializeToString())


def _host_ns(stream: str, message: Any, content: Content, clock: Clock) -> int:
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
