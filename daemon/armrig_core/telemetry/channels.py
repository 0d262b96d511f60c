"""Channels of the arm, the default rig, and the fields of its samples."""

from __future__ import annotations

from armrig_core.rig.channels import tex_symbol
from armrig_core.rig.description import builtin
from armrig_core.telemetry.telemetry import sample_fields

CHANNELS = builtin("arm").channels
"""Channels of the arm, in addition to u."""
RATES = {channel.name: channel.rate for channel in CHANNELS if channel.rate}
"""Rates that have a name, by output."""
SECOND_ORDER_OUTPUTS = frozenset(channel.name for channel in CHANNELS)
"""Outputs whose second derivative jumps at a voltage step, with a continuous first derivative."""
ARM_OUTPUTS = SECOND_ORDER_OUTPUTS.union(RATES.values())
"""Outputs of the arm, of which more is known than of those of other rigs."""
INTEGRATING_OUTPUTS = frozenset(channel.name for channel in CHANNELS if channel.turns)
"""Outputs that integrate by construction, whatever the result of a test on a short record."""
SYMBOLS = {channel.name: f"${tex_symbol(channel.name)}$" for channel in CHANNELS} | {
    rate: rf"$\dot{tex_symbol(output)}$" for output, rate in RATES.items()
}
"""Symbols of the outputs in figures."""
BODIES = {channel.name: channel.body for channel in CHANNELS}
"""Part of the arm whose motion each channel shows."""
SAMPLE_FIELDS = sample_fields(CHANNELS)
"""Name and protobuf type of each field of the arm's `armrig.v1.Sample`, numbered from 1."""
SAMPLE_NAMES = tuple(name for name, _ in SAMPLE_FIELDS)
"""Names of the fields of the arm's `armrig.v1.Sample`."""
