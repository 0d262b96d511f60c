"""What a sampling time may be that a recording says of itself."""

from __future__ import annotations

from armrig_core.manifest import Manifest
from armrig_core.recording_file.budget import DamageError

TS_LEAST_S, TS_LIMIT_S = 1e-6, 86_400.0
"""No sampling time is shorter than the first, or as long as the second, in s."""


def check_sampling_time(manifest: Manifest) -> None:
    """Raise DamageError where a recording says of a sampling time that none has."""
    if not TS_LEAST_S <= manifest.Ts < TS_LIMIT_S:
        raise DamageError(
            f"its manifest says Ts={manifest.Ts!r} s, which must be from 1 µs to below a day"
        )
