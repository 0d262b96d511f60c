"""Answers of odd devices, frame by frame; they are in `odd_devices.txt`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from armrig_daemon.conformance.host import BOOT_MS, LineHost
from armrig_daemon.conformance.line import VirtualLine
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol import messages as wire
from armrig_protocol.messages import Mode, State, Underrun

from tests.clients.said import compare
from tests.daemon.odd_bench import EMULATOR

DEVICES: dict[str, dict[str, Any]] = {
    "the odd one": EMULATOR,
    "ideal sensors, no rounding, the arm taken off": {
        "seed": 5,
        "baud": 1_000_000,
        "potentiometers": False,
        "pwm_bits": 0,
        "adc_bits": 0,
        "adc_noise_v": 0.0,
        "clock_ppm": -300.0,
        "arm_removed": True,
        "model_baud": False,
    },
    "a supply that breaks down": {
        "seed": 7,
        "brown_out_s": 0.95,
        "supply_v": 4.2,
        "driver_offset_v": -0.3,
        "theta_1_zero_deg": 350.0,
        "arm": {"K_lin": 4.0, "J_2": 0.001},
    },
}


def _line(message: wire.Message) -> str:
    fields: dict[str, Any] = message._asdict()
    shown = ", ".join(f"{name}={value}" for name, value in fields.items() if name != "seq")
    return f"  {type(message).__name__} {shown}"


class Heard:
    """A host that notes all messages except PONG."""

    def __init__(self, settings: dict[str, Any]) -> None:
        given = EmulatorSettings(**settings)
        self.device = Device(given, 0)
        self.host = LineHost(VirtualLine(self.device), given.baud)
        self.lines = [_line(self.host.hello(BOOT_MS))]

    def ask(self, kind: type[wire.Message], **fields: Any) -> None:
        """Note what answers a frame, and 30 ms of what comes then."""
        self.host.put(kind, **fields)
        self.listen(30)

    def listen(self, ms: float) -> None:
        """Note what comes within a time, with a sign of life now and then."""
        came = self.host.alive(ms) if ms > 40 else self.host.listen(ms)
        shown = [_line(message) for message in came if type(message).__name__ != "Pong"]
        shown = shown or ["  nothing"]
        self.lines += [*shown[:-1], f"{shown[-1]}; {self.device.board.volts:.5g} V"]


def _told(settings: dict[str, Any]) -> list[str]:
    heard = Heard(settings)
    host = heard.host
    for channel, n in ((0, 1), (1, 50), (0, 200)):
        heard.ask(wire.Cal, channel=channel, zero=0, n=n)
    host.reach(State.RUN, oversampling=4, rail_ticks=50, turns=40, u_max=60_000, watchdog_ms=200)
    for k, u in ((3, 0), (7, 30_001), (8, 30_001), (8, 5), (20, 59_999)):
        heard.ask(wire.Exchange, k=k, u=u)
    host.put_together(
        [wire.Exchange(0, 0, 21, 100), wire.Exchange(0, 0, 22, 50_000), wire.Ping(0, 0, 1)]
    )
    heard.listen(200)
    host.put(wire.Exchange, k=23, u=0)
    heard.ask(wire.Exchange, k=24, u=61_000)
    host.to_idle()
    config = {"mode": Mode.SCHEDULED, "ts_us": 7_000, "underrun": Underrun.HOLD, "hold": 2}
    host.configure(**config, slew=20_000, u_min=500, u_rest=500, watchdog_ms=120)
    heard.ask(wire.Arm)
    host.to_idle()
    host.configure(**config, slew=20_000, watchdog_ms=120)
    heard.ask(wire.Arm)
    for k0, u in (
        (0, [9_000, 19_000, 27_000]),
        (3, [8_000]),
        (9, [1_000]),
        (2, [27_000, 8_000, 60]),
    ):
        padded = (*u, *(0,) * (24 - len(u)))
        heard.ask(wire.Setpoints, k0=k0, n=len(u), zero=0, u=padded)
    host.put(wire.Start, k_stop=12)
    heard.listen(150)
    heard.ask(wire.Stop)
    heard.listen(1_200)
    heard.ask(wire.Estop)
    return heard.lines


def test_answers_of_unusual_devices_equal_the_stored_answers() -> None:
    lines = [line for name, settings in DEVICES.items() for line in (f"# {name}", *_told(settings))]

    compare(Path(__file__).with_name("odd_devices.txt"), "\n".join(lines) + "\n")
