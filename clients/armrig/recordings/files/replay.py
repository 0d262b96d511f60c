"""Replay of a recorded run: the daemon's core repeats the decisions of the run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, takewhile
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.errors import FileError, InputError
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.manifest import INPUT, RUN, Manifest, description_of
from armrig_core.rig.volts import codes_of
from armrig_daemon.decisions import step as core_step
from armrig_daemon.decisions import trace
from armrig_daemon.decisions.state import Action, DecisionState, Emit, Publish, Send
from armrig_daemon.pipe import Log, RunEnded
from armrig_protocol.frame import Spoilt, Unknown, decode

from armrig.numerics.quantities import plural
from armrig.recordings.files.container import Content, read, stream_messages
from armrig.recordings.files.control_run import law_of
from armrig.recordings.files.input_attachment import read_input
from armrig.recordings.files.loading import check_attachments, files_of, run_content
from armrig.recordings.files.recording_summary import is_foreign
from armrig.recordings.files.sample_rows import SAMPLE_DTYPE

if TYPE_CHECKING:
    from pathlib import Path

    from armrig_core.control.control_law import ControlLaw
    from armrig_core.rig.description import Description

MAX_CHUNK_BYTES = 4096
"""Largest size of a chunk of the core's steps, in B."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CoreMessage:
    """A warning or an error of the core in the replay."""

    t: float
    """Time of the message, in s from the first step."""
    level: str
    """Level: debug, info, warning or error."""
    message: str
    """Text of the message."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """Result of a replay: the repeated decisions, compared with the recorded decisions."""

    steps: int
    """Number of calls of the core."""
    frames: int
    """Number of frames to the device that equal the recorded frames."""
    samples: int
    """Number of samples that equal the recorded samples to the last bit."""
    seconds: float
    """Time from the first step to the last, in s."""
    difference: str
    """First difference from the recording; empty without a difference."""
    until: str
    """Damage of the file at which the replay ends; empty for a complete file."""
    said: tuple[CoreMessage, ...]
    """Warnings and errors of the core during the replay, including safety trips."""


def replay(path: Path) -> Replay:
    """Repeat the core's decisions for a recorded run, and compare them with the recording.

    `path` is a file. To replay all parts of a run, give the name of the run. The replay compares
    all frames to the device and all samples in the file.

    Raises FileError if the file is not a recording of armrig, or its core steps are missing or of
    another release. Raises FileError, too, if an attachment does not have the hash in the manifest.
    Raises OSError if the file cannot be read.
    """
    try:
        paths = files_of(path)
        content = read(path) if paths == [path] else run_content(paths, digest=False).content
    except DamageError as err:
        raise FileError(f"{path}: {err}") from err
    if content is None or is_foreign(paths[0]):
        raise FileError(f"{path}: not made by armrig; replay reads recordings of armrigd (*.mcap)")
    first = next(_chunks_of(paths), None)
    if first is None or not first.state:
        why = "the file may be older than `armrig replay`"
        if content.damage:
            why = f"{content.damage}; nothing before the damage can be replayed"
        raise FileError(f"{path}: nothing to replay: {why}")
    try:
        return _replay(paths, content, first)
    except FileError:
        raise
    except Exception as err:  # the steps in the file may be anything, so any exception may occur
        by = content.metadata.get(RUN, {}).get("armrig", "another release")
        raise FileError(
            f"{path}: its steps do not fit the core of this release (recorded by {by}): {err}"
        ) from err


def _chunks_of(paths: Sequence[Path]) -> Iterator[Any]:
    return chain.from_iterable(stream_messages(path, "trace") for path in paths)


def _replay(paths: Sequence[Path], content: Content, begin: Any) -> Replay:
    manifest = Manifest.of(content.metadata[RUN])
    check_attachments(paths[0], content, manifest)
    if content.input is None:
        raise InputError("no input is attached")
    u = read_input(paths[0], content.input, manifest.samples)
    law = law_of(content.attachments)
    source = codes_of(u.tolist()) if manifest.source == INPUT else u.astype("<f8").tobytes()
    state = trace.decode_state(begin.state, source, begin.version)
    if law is not None:
        _check_law(state, law, description_of(content.attachments))
    # Samples read together with the answer to START precede the first step.
    k = content.samples["k"]
    theirs = content.samples[k > state.last_reported_k]
    ours = same = 0  # replayed samples, and equal samples before the first difference
    chunks, numbers = _chunks_of(paths), list[int]()
    difference, frames, messages = "", 0, []
    first = now_ns = None
    n = 0
    for n, step in enumerate(_steps(chunks, numbers), 1):
        now_ns = step.now_ns
        first = now_ns if first is None else first
        state, actions = core_step.step(state, now_ns, step.events)
        sent = tuple(a.data for a in actions if isinstance(a, Send))
        if sent != step.sent:
            difference = f"step {n}, {(now_ns - first) / 1e9:.4f} s: "
            difference += f"sent {_names(step.sent)}, now decides {_names(sent)}"
            break
        frames += len(sent)
        of_run = takewhile(lambda a: not isinstance(getattr(a, "record", None), RunEnded), actions)
        for sample in (a.sample for a in of_run if isinstance(a, Publish)):
            if manifest.k_first <= sample.k < manifest.k_first + manifest.samples:
                row = np.array([tuple(sample)], SAMPLE_DTYPE)
                same += same == ours and row.tobytes() == theirs[ours : ours + 1].tobytes()
                ours += 1
        messages += list(_messages(actions, first))
    numbers += [int(chunk.number) for chunk in chunks]
    holes = numbers[-1] + 1 - len(numbers)
    if not difference and holes:  # then samples are missing, too
        verb = "is" if holes == 1 else "are"
        difference = f"{plural(holes, 'chunk')} of steps {verb} missing from the file"
    # In a file that is cut off, the last sample may be later or earlier than the last step.
    reach = (min if content.cut_off else max)(ours, theirs.size)
    if not difference and same != reach:
        difference = f"the file has {plural(theirs.size, 'sample')}, the replay has {ours}"
        difference += f"; the first {same} are the same"
    return Replay(
        steps=n,
        frames=frames,
        samples=same,
        seconds=0.0 if first is None or now_ns is None else (now_ns - first) / 1e9,
        difference=difference,
        until=content.damage,
        said=tuple(messages),
    )


def _check_law(state: DecisionState, law: ControlLaw, rig: Description) -> None:
    """Refuse core steps of another law than the attached one."""
    control = state.run.control if state.run else None
    if not control or control.law != law.program(rig):
        raise InputError("the steps belong to another law than the attached controller.json")


def _steps(chunks: Iterator[Any], numbers: list[int]) -> Iterator[trace.DecisionStep]:
    """Yield the core's steps up to the first missing chunk; add the numbers of the chunks read."""
    for chunk in chunks:
        numbers.append(int(chunk.number))
        if numbers[-1] != len(numbers) - 1:
            return
        if len(chunk.steps) > MAX_CHUNK_BYTES:
            raise InputError(
                f"a chunk of steps has {len(chunk.steps)} B; "
                f"the daemon writes at most {MAX_CHUNK_BYTES} B"
            )
        yield from trace.steps_of(chunk.steps, chunk.version)


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
