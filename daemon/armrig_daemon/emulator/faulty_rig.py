"""A rig with faults, for tests and lessons: dead zone, swapped wires, loose arm, broken sensor."""

from __future__ import annotations

from math import copysign
from typing import TYPE_CHECKING

from armrig_core.rig.description import Description

from armrig_daemon.emulator.described_rig import DescribedRig
from armrig_daemon.emulator.settings import EmulatorSettings

if TYPE_CHECKING:
    from armrig_daemon.emulator.board import EmulatedArm

_MOVEMENT = 0.01  # change of a reading, as a share of its range, by which its output moves
_ENDS = {"low": -1.0, "high": 2.0}  # beyond the range by more than any noise


class FaultyRig:
    """Rig with the faults of the settings, which begin `fault_s` after the start of each run."""

    def __init__(
        self, rig: EmulatedArm | DescribedRig, settings: EmulatorSettings, description: Description
    ) -> None:
        """Put faults on a rig at rest; raise InputError if they do not fit the rig."""
        settings.check_rig(description)
        self._rig, self._settings, self.rest_v = rig, settings, rig.rest_v
        self._sensors = [*description.outputs]
        # The arm itself has the friction. Another rig gets a dead zone of its input instead.
        self._dead_v = 0.0 if description.arm else settings.friction_v or 0.0
        self._wait_ns = round((settings.fault_s or 0.0) * 1e9)
        self._now_ns = 0
        self._run_ns: int | None = None  # start of the run
        self._first: float | None = None  # reading at the beginning of the fault
        self._held: list[float | None] = []

    @property
    def state(self) -> tuple[float, ...]:
        """State of the rig."""
        return self._rig.state

    @property
    def is_broken(self) -> bool:
        """True while the faults are in force; without a `fault_s` they always are."""
        begun = self._run_ns is not None and self._now_ns - self._run_ns >= self._wait_ns
        return begun or not self._wait_ns

    def note_drive(self, *, is_running: bool) -> None:
        """Note the start of a run, or its end, at which the rig is repaired."""
        if not is_running:
            self._run_ns, self._first, self._held = None, None, []
        elif self._run_ns is None:
            self._run_ns = self._now_ns

    def advance(self, u: float, dt_ns: int) -> None:
        """Apply a constant voltage for a time; a fault begins with a call."""
        v = u - self.rest_v
        if self._settings.motor_reversed and self.is_broken:
            v = -v
        if self._dead_v:
            v = copysign(max(abs(v) - self._dead_v, 0.0), v)
        self._rig.is_loose = self.is_broken
        self._rig.advance(self.rest_v + v, dt_ns)
        self._now_ns += dt_ns

    def wiper(self, channel: int) -> float | None:
        """Return the sensor's voltage as a fraction of the reference; None in a dead band."""
        y, fault = self._rig.wiper(channel), self._settings.sensor_fault
        is_faulty = self._sensors[channel : channel + 1] == [self._settings.faulty_sensor]
        if not is_faulty or not fault or not self.is_broken:
            return y
        if fault in _ENDS:
            return _ENDS[fault]
        if fault == "reversed":
            return None if y is None else 1.0 - y
        self._first = (y or 0.0) if self._first is None else self._first
        has_moved = abs((y or 0.0) - self._first) > _MOVEMENT
        if not self._held and (fault == "stuck" or has_moved):
            self._held = [y]
        return self._held[0] if self._held else y
