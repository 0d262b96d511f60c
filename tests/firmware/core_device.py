"""The emulated device with the C core in it, on the emulated board.

Clock, wires, converter and timer are those of boards/pc, in C; arm and potentiometers are the
emulator's own. So this device and `Device` must send the same bytes at the same times.
"""

from __future__ import annotations

import ctypes
from struct import Struct
from types import SimpleNamespace
from typing import Any

from armrig_core.rig.volts import duty
from armrig_daemon.emulator import clock
from armrig_daemon.emulator.board import VoltageError
from armrig_daemon.emulator.clock import U32, EmulatedClock
from armrig_daemon.emulator.device import Device
from armrig_protocol.messages import Cause, State

from tests.firmware.library import CoreState, Setup, library

_CAUSES, _STATES, _RUN = tuple(Cause), tuple(State), int(State.RUN)
_SENT = Struct("=qB")


class CoreFirmware:
    """Properties of the core that watchers and tests need, as of `Firmware`."""

    def __init__(self, device: CoreDevice) -> None:
        """Look at the core of `device`."""
        self._device = device

    @property
    def _state(self) -> CoreState:
        self._device.use()
        return self._device.core.state

    @property
    def _c(self) -> Any:
        return self._device.use()

    @property
    def state(self) -> State:
        """State of the core."""
        return State.BOOT if self._state.is_booting else _STATES[self._c.pc_state()]

    @property
    def cause(self) -> Cause:
        """Cause of the last transition."""
        return Cause.POWER_ON if self._state.is_booting else _CAUSES[self._c.pc_cause()]

    @property
    def clock(self) -> EmulatedClock:
        """The device's clock."""
        return EmulatedClock(self._state.reset_ns, self._state.second_ns)

    @clock.setter
    def clock(self, new: EmulatedClock) -> None:
        self._state.reset_ns, self._state.second_ns = new.reset_ns, new.second_ns

    @property
    def timer(self) -> Any:
        """In RUN of scheduled mode; its fields can be set."""
        return self._state.timer if self._state.is_timed else None

    @property
    def u_seq(self) -> int:
        """Frame that the code in force came from."""
        return int(self._c.pc_u_seq())

    @property
    def pending(self) -> list[SimpleNamespace]:
        """Sample under way, if any."""
        state = self._state
        if not state.pending_count:
            return []
        return [SimpleNamespace(k=state.pending_k, seq=state.pending_seq)]

    @property
    def boot_id(self) -> int:
        """boot_id of this boot."""
        return self._device._boot_id

    @boot_id.setter
    def boot_id(self, boot_id: int) -> None:
        self._c.pc_set_boot_id(boot_id)

    @property
    def queue(self) -> CoreFirmware:
        """The queue, of which `next` can be reached."""
        return self

    @property
    def next(self) -> int:
        """Index of the next sample to be latched."""
        return int(self._c.pc_next())

    @next.setter
    def next(self, k: int) -> None:
        self._c.pc_set_next(k)


class CoreDevice(Device):
    """An emulated rig whose firmware is the C core."""

    is_watched = False
    build = "librig.so"
    image: Any = None
    """The device's state while another's is in the library."""
    _fw: Any

    def _begin(self, now_ns: int, mcusr: int) -> None:
        last = self._boot_id
        while self._boot_id == 0 or not (self._boot_id ^ last) & 0xFFFF:
            self._boot_id = int(self._rng.integers(1, U32, endpoint=True))
        self.core = library(self._hardware, self.build)
        self._fw = CoreFirmware(self)
        started = clock.clock_at_reset(self._settings, now_ns)
        setup = Setup(
            now_ns=now_ns,
            reset_ns=started.reset_ns,
            second_ns=started.second_ns,
            boot_ns=self._boot_ns,
            conversion_ns=self._hardware.conversion_ns,
            hold_ns=self._hardware.hold_ns,
            baud=self._baud,
            boot_id=self._boot_id,
            reset_flags=mcusr,
            is_watched=self.is_watched,
        )
        self.use().pc_device_begin(ctypes.byref(setup))
        self.board.release(now_ns, State.BOOT, Cause.POWER_ON)
        self._next_ns = self.core.state.next_ns

    def use(self) -> Any:
        """Return the library's functions, with the state of this device in it."""
        return self.core.use(self)

    @property
    def is_running(self) -> bool:
        """Return whether the core is in RUN; for calls from C, during which its state is valid."""
        return bool(self.core.functions.pc_state() == _RUN)

    # -- as `Device` -----------------------------------------------------------------------------

    def receive(self, now_ns: int, data: bytes) -> None:
        """Put bytes on the wire to the device."""
        self.use().pc_device_receive(now_ns, data, len(data))
        self._next_ns = self.core.state.next_ns

    def rx_backlog_ns(self, now_ns: int) -> int:
        """Return how long the bytes given so far still occupy the wire to the device."""
        return max(0, int(self.use().pc_device_busy_ns()) - now_ns)

    def visible_ns(self) -> int:
        """Return when something can happen next, which is early enough."""
        return self._next_ns

    def advance(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Do everything due until `now_ns`; return frames, each with its last byte's departure."""
        frames: list[tuple[int, bytes]] = []
        while self._next_ns <= now_ns:
            frames += self._advance(now_ns, to_frame=False)
        return frames

    def advance_to_frame(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Do everything due until `now_ns` or the next frame, whichever is first."""
        return self._advance(now_ns, to_frame=True) if self._next_ns <= now_ns else []

    def _advance(self, now_ns: int, *, to_frame: bool) -> list[tuple[int, bytes]]:
        n = self.use().pc_device_advance(now_ns, to_frame)
        self._next_ns = self.core.state.next_ns
        self.core.raise_error()
        frames, at, sent = [], 0, self.core.sent[:n]
        while at < n:
            end_ns, length = _SENT.unpack_from(sent, at)
            at += _SENT.size + length
            frames.append((end_ns, sent[at - length : at]))
        return frames

    # -- what C asks of the world; see boards/pc/pc_device.h -------------------------------------

    def read(self, t_ns: int, channel: int) -> int:
        """Return the converter's reading of an input."""
        return self.board.reading(channel, t_ns)

    def drive(self, t_ns: int, steps: int, code: int) -> None:
        """Give the pin the duty of `code`."""
        bits = self._hardware.pwm_bits
        wanted = duty(code, bits) if bits < 16 else code
        if steps != wanted or not self.is_running:
            raise VoltageError(f"{steps} steps for code {code} in state {self._fw.state.name}")
        self.board.latch(t_ns, code, Cause.REQUEST)

    def release(self, t_ns: int) -> None:
        """Let the pin be low."""
        self.board.release(t_ns, self._fw.state, self._fw.cause)

    def supply(self, t_ns: int) -> int:
        return self.board.supply_mv(t_ns)

    def token(self) -> int:
        """Draw a token."""
        return int(self._rng.integers(1, U32, endpoint=True))
