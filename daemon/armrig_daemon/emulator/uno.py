"""The firmware's binary on a simulated Uno, with the arm at its pins.

`Uno` has the interface of `Device`: time is an argument, in integer nanoseconds, and never
decreases. Like a real board, the simulated board has only its line and its pins, so the voltage is
measured at the PWM pin.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final
from weakref import finalize

import numpy as np
from armrig_core.rig.description import Description
from armrig_protocol import decoder
from armrig_protocol.frame import Spoilt, Unknown
from armrig_protocol.messages import Cause, Event, State
from msgspec.structs import replace

from armrig_daemon.emulator.board import Board, Witness
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.harness import CYCLES_PER_US, Duty, Harness, Left, Violated
from armrig_daemon.emulator.layout import ARM, Layout
from armrig_daemon.emulator.pin import Pins
from armrig_daemon.emulator.sensors import CODE_BITS
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.uart import wire_ns

ADC_BITS: Final = 10
SKEW_CYCLES: Final = 128 * CYCLES_PER_US
"""Time between two conversions of a sample, in cycles."""
OPTIBOOT_NS: Final = 1_000_000_000
"""Time for which a boot loader runs and the program receives no bytes, in ns."""
ACTIVE_NS: Final = 20_000_000
"""Time after a byte during which the simulation is polled at shorter intervals, in ns."""
ACTIVE_POLL_NS, IDLE_POLL_NS = 250_000, 2_000_000
Stuck = Callable[[int, int], int | None]
"""Function of time and channel: reading of a stuck converter; None for a working converter."""


class Uno:
    """A simulated board with its firmware and a moving arm."""

    def __init__(
        self,
        program: Path,
        image: Path,
        settings: EmulatorSettings,
        now_ns: int = 0,
        witness: Witness | None = None,
        *,
        layout: Layout = ARM,
        boot_loader: bool = False,
        trace: Path | None = None,
        description: Description | None = None,
    ) -> None:
        """Switch the board on.

        `program` is the path of the harness, and `image` of the firmware as Intel HEX. From
        `settings`, only the arm, its sensors and the line's speed are used; the binary determines
        all other properties. `layout` contains the pins that the image uses. If `boot_loader` is
        True, a reset by the port starts Optiboot, which ignores bytes for a second and clears
        MCUSR. `trace` is a VCD file with the levels of the PWM pin and the enable line.
        `description` describes the rig; default: the arm.
        """
        noise, self._rng = (
            np.random.default_rng(s) for s in np.random.SeedSequence(settings.seed).spawn(2)
        )
        settings = replace(settings, adc_bits=ADC_BITS)
        self.board = Board(settings, now_ns, noise, witness, description)
        self._layout = layout
        self._channels = {layout.second: 1, layout.first: 0}
        """Channels by the analogue pin; with one pin only the first channel."""
        self._held_at = 0
        """Cycle of the newest hold of the only pin."""
        self._is_second = False
        self._baud = settings.baud
        self._origin_ns = now_ns
        self._line_free_ns = self._byte_ns = now_ns
        self._deaf = OPTIBOOT_NS * CYCLES_PER_US // 1000 if boot_loader else 0
        self._frame = bytearray()
        self._frames: list[tuple[int, bytes]] = []
        self.harness = Harness(program, image, baud=settings.baud, pwm=layout.pwm, trace=trace)
        finalize(self, self.harness.close)
        self.state = State.BOOT
        """State of the device in its newest frame."""
        self.cause = Cause.POWER_ON
        """Cause of the newest EVENT of the device."""
        self.violations: list[Violated] = []
        self._pins = Pins(self.violations.append, layout.period)
        self.stuck: Stuck = lambda t_ns, channel: None

    @property
    def duties(self) -> list[Duty]:
        """Changes of the pin since power-on."""
        return self._pins.duties

    def close(self) -> None:
        """Switch the board off."""
        self.harness.close()

    def ns(self, cycle: int) -> int:
        """Return the caller's time at the end of a cycle, in ns."""
        return self._origin_ns - (-cycle * 1000 // CYCLES_PER_US)

    def cycle(self, now_ns: int) -> int:
        """Return the cycle that is in progress at the caller's time `now_ns`."""
        return (now_ns - self._origin_ns) * CYCLES_PER_US // 1000

    def reset(self, now_ns: int) -> None:
        """Reset the processor, as opening an Uno's port does; bytes on the wires are lost."""
        self.advance(now_ns)
        self._frame.clear()
        self._line_free_ns = now_ns
        self.harness.reset(self._deaf)
        self._pins.reset(self.harness.cycle)
        self.state, self.cause = State.BOOT, Cause.POWER_ON

    def receive(self, now_ns: int, data: bytes) -> None:
        """Put bytes on the wire to the device; they arrive one by one from `now_ns` on."""
        self._line_free_ns = max(self._line_free_ns, now_ns) + wire_ns(len(data), self._baud)
        self._byte_ns = self._line_free_ns
        self.harness.send(self.cycle(now_ns), data)
        self._pins.send(self.harness.cycle, data)

    def rx_backlog_ns(self, now_ns: int) -> int:
        """Return the time for which the sent bytes still occupy the wire to the device, in ns."""
        return max(0, self._line_free_ns - now_ns)

    def visible_ns(self) -> int:
        """Return the time of the next poll, because the time of the next byte is unknown."""
        now_ns = self.ns(self.harness.cycle)
        is_active = now_ns - self._byte_ns < ACTIVE_NS
        return now_ns + (ACTIVE_POLL_NS if is_active else IDLE_POLL_NS)

    def advance(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Advance to a time; return the sent frames, each with the time of its last byte."""
        return self._run(now_ns, until_frame=False)

    def advance_until(self, limit_ns: int) -> tuple[int, list[tuple[int, bytes]]]:
        """Advance to `limit_ns` or, if earlier, to a sent frame; return the time and the frames."""
        frames = self._run(limit_ns, until_frame=True)
        return (min(limit_ns, frames[-1][0]) if frames else limit_ns), frames

    def _run(self, now_ns: int, *, until_frame: bool) -> list[tuple[int, bytes]]:
        target = self.cycle(now_ns)
        if target > self.harness.cycle:
            for record in self.harness.advance(target, self._reading, until_frame=until_frame):
                match record:
                    case Left(cycle, byte):
                        self._frame.append(byte)
                        if not byte:
                            self._note_sent_frame(self.ns(cycle))
                    case Duty():
                        self._apply(record)
                    case Violated():
                        self.violations.append(record)
            self._pins.look(self.harness.cycle)
        frames, self._frames = self._frames, []
        return frames

    def _note_sent_frame(self, t_ns: int) -> None:
        wire = bytes(self._frame)
        self._frame.clear()
        self._frames.append((t_ns, wire))
        self._byte_ns = t_ns
        begun = self.cycle(t_ns - wire_ns(len(wire), self._baud))
        for message in decoder.feed(b"", wire)[1]:
            self._pins.tell(begun, message)
            if isinstance(message, Spoilt | Unknown):
                continue
            self.state = State(message.state)
            if isinstance(message, Event):
                self.cause = Cause(message.cause)

    def _apply(self, duty: Duty) -> None:
        """Apply the measured duty to the motor; a duty is known only at the end of its period."""
        self._pins.measure(duty)
        now_ns, share = self.ns(duty.cycle), duty.high / self._layout.period
        enabled = duty.enabled or share > 0
        self.board.drive(now_ns, share, self.state, self.cause, enabled=enabled)

    def _reading(self, cycle: int, pin: int) -> int:
        t_ns = self.ns(cycle)
        channel = self._channels.get(pin)
        if channel == 0 and self._is_first(cycle):
            self._hold(cycle)
        reading = self.stuck(t_ns, pin if channel is None else channel)
        if reading is not None:
            return reading
        if channel is not None:
            return self.board.reading(channel, t_ns) >> (CODE_BITS - ADC_BITS)
        return int(self._rng.integers(1 << ADC_BITS))  # an open pin: noise

    def _hold(self, cycle: int) -> None:
        self._pins.hold(cycle)

    def _is_first(self, cycle: int) -> bool:
        """Return whether a conversion is of the first channel, and not of the second at its pin.

        A sample begins with the second channel; each further conversion is held one skew later.
        """
        if len(self._channels) == 2:
            return True
        follows = abs(cycle - self._held_at - SKEW_CYCLES) < CYCLES_PER_US
        self._is_second = follows and not self._is_second
        self._held_at = cycle
        return self._is_second


AnyDevice = Device | Uno
"""A device whose time is an argument: the emulated device, or the firmware's binary."""
