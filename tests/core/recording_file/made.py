"""Recordings for the tests of the recorder, with samples of any number."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from armrig_core.commands.codes import COMPLETE, Ending
from armrig_core.recording_file.recorder import ActiveRecording
from armrig_core.telemetry.telemetry import Outgoing, Sample, encode_sample
from msgspec.structs import replace

from tests.clients.made_recordings import manifest

WITHIN_S = 30.0
Setter = Callable[..., None]
"""Function of the fixtures `pace` and `instead`."""
MANIFEST = manifest(details={"seed": 3}, samples=100, clock_offset_ns=10**18)


def sample(k: int, *, theta_1: float = 0.1, counts: tuple[int, int] = (1, 2)) -> Outgoing:
    """Return sample k, every 10 ms."""
    t_ns = k * 10_000_000
    device_us = k * 10_000
    values = Sample(k, t_ns, t_ns + 5, device_us, theta_1, 0.2, 1.0, 1.0, *counts, 3)
    return Outgoing("sample", t_ns + 5, t_ns, k, encode_sample(values))


def begun(
    path: Path,
    changed: threading.Event | None = None,
    part: int = 0,
    *,
    files: Mapping[str, bytes] = {"input.csv": b"u_v\n1.0\n"},
    t_first_ns: int = 5,
    **about: Any,
) -> ActiveRecording:
    """Begin a recording; `about` replaces fields of `MANIFEST`."""
    event = changed or threading.Event()
    filled = replace(MANIFEST, **about)
    return ActiveRecording.create(
        path,
        filled,
        dict(files),
        t_first_ns=t_first_ns,
        changed=event.set,
        part_samples=part,
    )


def finished(recording: ActiveRecording, ending: Ending = COMPLETE) -> ActiveRecording:
    """End a recording; return it once its file is complete or given up."""
    recording.finish(ending)
    recording.join(WITHIN_S)
    return recording


def until(is_true: Callable[[], object]) -> None:
    """Wait until `is_true`."""
    until_s = time.monotonic() + WITHIN_S
    while not is_true():
        assert time.monotonic() < until_s
        time.sleep(0.01)
