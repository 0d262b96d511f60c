"""Table of all transitions between phases; docs/safety.md shows the table as a diagram."""

from __future__ import annotations

from enum import Enum
from typing import Any

from msgspec.structs import replace

from armrig_daemon.decisions.state import DecisionState, Phase


class On(Enum):
    """Cause of a transition between phases; its value is the text in the diagram."""

    CONFIGURED = "the device is at rest and has accepted its configuration"
    ARMED = "the device is armed for an owner"
    STARTED = "the first command of the owner has started the motor"
    TRIPPED = "a fault"
    RESET = "a reset, after which the device has accepted its configuration"
    LOST = "no device answers, or it was reset"
    ENDED = "the daemon ends"


_INIT, _SAFE, _ARMED, _ACTIVE, _FAULT = Phase
TRANSITIONS: dict[On, dict[Phase, Phase]] = {
    On.CONFIGURED: {_INIT: _SAFE, _SAFE: _SAFE, _ARMED: _SAFE, _ACTIVE: _SAFE},
    On.ARMED: {_SAFE: _ARMED},
    On.STARTED: {_ARMED: _ACTIVE},
    On.TRIPPED: dict.fromkeys(Phase, _FAULT),
    On.RESET: {_FAULT: _SAFE},
    # The loss of a device whose motor may turn causes a fault, TRIPPED, first.
    On.LOST: {_INIT: _INIT, _SAFE: _INIT, _FAULT: _FAULT},
    On.ENDED: {_INIT: _INIT, _SAFE: _INIT, _ARMED: _INIT, _ACTIVE: _INIT, _FAULT: _FAULT},
}
"""Next phase for each cause and phase.

Any other pair raises an exception; the loop then stops the motor and ends.
"""


def change_phase(state: DecisionState, on: On, **changes: Any) -> DecisionState:
    """Return the state with the next phase after `on`, and with `changes`."""
    return replace(state, phase=TRANSITIONS[on][state.phase], **changes)
