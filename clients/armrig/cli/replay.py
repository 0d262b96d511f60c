"""The replay of a recorded run: the daemon's own function decides it once more."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from armrig_core.manifest import INPUT, RUN, manifest_of
from armrig_core.volts import code_of
from armrig_daemon.core import step as core_step
from armrig_daemon.core import trace
from armrig_daemon.core.state import Action, Emit, Publish, Send
from armrig_daemon.pipe import Log
from armrig_protocol.frame import Spoilt, Unknown, decode

from armrig.recordings.container import READ, Content, read
from armrig.recordings.recording import RecordingError
from armrig.recordings.sample_rows import SAMPLE_DTYPE, DamageError

MOST_CHUNK = 4096
"""Bytes of steps in one chunk; with so few there cannot be many."""
MOST = 1 << 28
"""Bytes of messages that are read; a run of ten minutes at 1 kHz has a quarter of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CoreMessage:
    """A warning or an error of the core in the replay."""

    t: float
    """When, in s from the first step."""
    level: str
    """debug, info, warning or error."""
    message: str
    """Its text."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """The decisions of a recorded run, made once more and compared."""

    steps: int
    """Calls of the core."""
    frames: int
    """Frames to the device that were decided as recorded."""
    samples: int
    """Samples that came out as recorded, to the last bit."""
    seconds: float
    """From the first step to the last, in s."""
    difference: str
    """Where the replay first differs from the recording; empty where it does not."""
    until: str
    """What is wrong with the file where the replay ends before the run; empty for a whole file."""
    said: tuple[CoreMessage, ...]
    """Warnings and errors of the core during the replay, trips among them."""


def replay(path: str | Path) -> Replay:
    """Run the core through a recorded run and compare what it decides with what was decided.

    Compared are all frames to the device, and all samples in the file.

    Raises
    ------
    RecordingError
        The file is no recording of armrig, holds no steps, or those of another release.
    """
    path = Path(path)
    try:
        content = read(path, streams=(*READ, "trace"), most=MOST)
    except (OSError, DamageError) as err:
        msg = f"{path}: {getattr(err, 'strerror', None) or err}"
        raise RecordingError(msg) from err
    if content is None:
        msg = f"{path}: is no MCAP file; replay reads what armrigd has recorded (*.mcap)"
        raise RecordingError(msg)
    chunks = content.messages.get("trace", [])
    if not chunks or not chunks[0].state:
        why = "recorded before replay was built?"
        if content.damage:
            why = f"{content.damage}, and they would stand behind it"
        msg = f"{path}: holds no steps of the daemon's core: {why}"
        raise RecordingError(msg)
    try:
        return _replayed(content, chunks)
    except Exception as err:  # the core runs on what somebody wrote there: anything may be raised
        by = content.metadata.get(RUN, {}).get("armrig", "another release")
        msg = f"{path}: its steps are not of this release's core (recorded by {by}): {err}"
        raise RecordingError(msg) from err


def _replayed(content: Content, chunks: Sequence[Any]) -> Replay:
    state = trace.restored(chunks[0].state, _codes(content.attachments[INPUT]))
    told = state.told
    manifest = manifest_of(content.metadata[RUN])
    difference, frames, published, said = "", 0, [], []
    first = now_ns = None
    n = 0
    for n, step in enumerate(_steps(chunks), 1):
        now_ns = step.now_ns
        first = now_ns if first is None else first
        state, actions = core_step.step(state, now_ns, step.events)
        sent = tuple(a.data for a in actions if isinstance(a, Send))
        if sent != step.sent:
            difference = f"step {n}, {(now_ns - first) / 1e9:.4f} s: "
            difference += f"sent {_names(step.sent)}, now decides {_names(sent)}"
            break
        frames += len(sent)
        published += [a.sample for a in actions if isinstance(a, Publish)]
        said += list(_messages(actions, first))
    ours = np.array([tuple(s) for s in published], dtype=SAMPLE_DTYPE)
    end = manifest.k_first + manifest.samples
    ours = ours[(ours["k"] >= manifest.k_first) & (ours["k"] < end)]
    # Samples read together with the answer to START belong to the step before the first.
    theirs = content.samples[content.samples["k"] > told]
    same = _same_rows(ours, theirs)
    # In a file that is cut off, the samples may reach further than the steps, or less far.
    reached = same == (min if content.cut_off else max)(ours.size, theirs.size)
    if not difference and not reached:
        difference = f"the file has {theirs.size} samples, the replay {ours.size}; "
        difference += f"{same} are the same"
    if not difference and _holes(chunks):
        difference = f"{_holes(chunks)} chunks of steps are missing from the file"
    return Replay(
        steps=n,
        frames=frames,
        samples=same,
        seconds=0.0 if first is None or now_ns is None else (now_ns - first) / 1e9,
        difference=difference,
        until=content.damage,
        said=tuple(said),
    )


def _steps(chunks: Sequence[Any]) -> Iterator[trace.Step]:
    """Return the steps up to the first hole."""
    for number, chunk in enumerate(chunks):
        if chunk.number != number:
            return
        if len(chunk.steps) > MOST_CHUNK:
            msg = (
                f"a chunk of steps has {len(chunk.steps)} B; the daemon writes {MOST_CHUNK} at most"
            )
            raise ValueError(msg)
        yield from trace.steps_of(chunk.steps)


def _holes(chunks: Sequence[Any]) -> int:
    return int(chunks[-1].number) + 1 - len(chunks)


def _same_rows(ours: Any, theirs: Any) -> int:
    """Return how many samples from the first on are the same to the last bit."""
    n = min(ours.size, theirs.size)
    if not n:
        return 0
    a, b = (np.frombuffer(x[:n].tobytes(), np.uint8).reshape(n, -1) for x in (ours, theirs))
    different = np.flatnonzero((a != b).any(axis=1))
    return int(different[0]) if different.size else n


def _codes(csv: bytes) -> bytes:
    """Return the codes of an attached input, as the daemon made them of it."""
    codes = [code_of(float(line)) for line in csv.decode().splitlines()[1:]]
    return np.asarray(codes, dtype="<u2").tobytes()


def _names(frames: Sequence[bytes]) -> str:
    return ", ".join(_name(frame) for frame in frames) or "nothing"


def _name(frame: bytes) -> str:
    message = decode(frame.strip(b"\0"))
    if isinstance(message, Spoilt | Unknown):
        return str(message)
    body = {k: v for k, v in message._asdict().items() if k != "state"}
    return f"{type(message).__name__}({', '.join(f'{k}={v}' for k, v in body.items())})"


def _messages(actions: Sequence[Action], first_ns: int) -> Iterator[CoreMessage]:
    for action in actions:
        if isinstance(action, Emit) and isinstance(action.record, Log):
            log = action.record
            if log.level in ("warning", "error"):
                t = (log.t_host_ns - first_ns) / 1e9
                yield CoreMessage(t=t, level=log.level, message=log.message)
