"""The manifest of a recording made from afar: what a state of the daemon tells of its rig."""

from __future__ import annotations

import platform
import secrets
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import msgspec
from armrig_core.manifest import Manifest, check_whole_numbers

from armrig.recordings.recording_summary import REMOTE


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
