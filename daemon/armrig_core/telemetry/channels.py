"""Channels of the arm, the default rig, and the fields of its samples."""

from __future__ import annotations

from typing import Final, Literal

from armrig_core.rig.description import shipped
from armrig_core.telemetry.telemetry import sample_fields

THETA_1: Final = "theta_1"
ALPHA: Final = "alpha"
VELOCITY: Final = "velocity"
ChannelName = Literal["theta_1", "alpha"]
OutputName = Literal["theta_1", "alpha", "velocity"]
"""Name of a model's output: a channel, or the rate of a channel."""

CHANNELS = shipped("arm").channels
"""Channels of the arm, in addition to u."""
SAMPLE_FIELDS = sample_fields(CHANNELS)
"""Name and protobuf type of each field of the arm's `armrig.v1.Sample`, numbered from 1."""
SAMPLE_NAMES = tuple(name for name, _ in SAMPLE_FIELDS)
"""Names of the fields of the arm's `armrig.v1.Sample`."""
