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

ARM_OUTPUTS = frozenset({THETA_1, ALPHA, VELOCITY})
"""Outputs of the arm, of which more is known than of those of other rigs."""
INTEGRATING_OUTPUTS = frozenset({THETA_1})
"""Outputs that integrate by construction, whatever the result of a test on a short record."""
SECOND_ORDER_OUTPUTS = frozenset({THETA_1, ALPHA})
"""Outputs whose second derivative jumps at a voltage step, with a continuous first derivative."""
RATES = {THETA_1: VELOCITY}
"""Rates that have a name, by output."""
SYMBOLS = {THETA_1: r"$\theta_1$", ALPHA: r"$\alpha$", VELOCITY: r"$\dot\theta_1$"}
"""Symbols of the outputs in figures."""

CHANNELS = shipped("arm").channels
"""Channels of the arm, in addition to u."""
BODIES = {channel.name: channel.body for channel in CHANNELS}
"""Part of the arm whose motion each channel shows."""
SAMPLE_FIELDS = sample_fields(CHANNELS)
"""Name and protobuf type of each field of the arm's `armrig.v1.Sample`, numbered from 1."""
SAMPLE_NAMES = tuple(name for name, _ in SAMPLE_FIELDS)
"""Names of the fields of the arm's `armrig.v1.Sample`."""
