"""The Uno's binary in simavr for tests: built once, and a host that talks to it by hand."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from armrig_core.rig.firmware_image import image_path
from armrig_daemon.emulator.harness import Duty
from armrig_daemon.emulator.layout import LAYOUTS
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.uart import wire_ns
from armrig_daemon.emulator.uno import Uno
from armrig_protocol import decoder
from armrig_protocol import messages as wire
from armrig_protocol.frame import Spoilt, Unknown, encode
from armrig_protocol.messages import SCHEMA_HASH, VERSION, Mode, State

ROOT = Path(__file__).parents[2]
FIL = ROOT / "firmware_protocol" / "simavr"
HEX = ROOT / "firmware_protocol" / "firmware" / "armrig-uno.hex"
MS = 1_000_000
BOOT_NS = 250 * MS
"""Time after which the Uno has booted and answers."""
PERIOD_NS = 64_000
"""Period of the PWM, in ns."""
BAUD = EmulatorSettings().baud
"""Baud rate of the checkout's firmware."""
pins: list[Path] | None = None
"""VCD files of the pins of each Uno in this test, in the order of their starts."""


@cache
def harness() -> Path:
    """Return the harness, built where its sources are newer."""
    subprocess.run(["make", "-s", "-C", str(FIL)], check=True)
    return FIL / "fil"


@cache
def image(baud: int, name: str = "uno") -> Path:
    """Return the firmware for a speed of the line: the checkout's, or one built for it."""
    if baud == BAUD:
        return image_path(name)
    folder = Path(_folder().name)
    made = folder / f"{baud}.hex"
    here = ROOT / "firmware_protocol" / "firmware" / "boards" / "uno"
    given = [f"HEX={made}", f"BUILD={folder / str(baud)}", f"BAUD={baud}"]
    subprocess.run(["make", "-s", "-C", str(here), *given], check=True, stdout=subprocess.DEVNULL)
    return made


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="armrig-uno-")


def broken(folder: Path, file: str, old: str, new: str, layout: str = "uno") -> Path:
    """Return an image of a layout, built in `folder`, with a piece of one file replaced."""
    sources = folder / "firmware"
    shutil.copytree(HEX.parent, sources, ignore=shutil.ignore_patterns("build"))
    text = (sources / file).read_text(encoding="utf-8")
    assert text.count(old) == 1, f"{file} has {text.count(old)} times: {old}"
    (sources / file).write_text(text.replace(old, new), encoding="utf-8")
    image = folder / "broken.hex"
    make = ["make", "-s", "-C", str(sources / "boards" / "uno"), f"HEX={image}", f"BUILD={folder}"]
    make.append(f"LAYOUT={layout}")
    subprocess.run(make, check=True, capture_output=True)
    return image


def switch_on(settings: EmulatorSettings, now_ns: int, name: str = "uno", **kwargs: Any) -> Uno:
    """Return a simulated Uno with an image of the checkout; its pins are traced in a test."""
    if pins is not None:
        pins.append(new_trace())
        kwargs["trace"] = pins[-1]
    firmware = image(settings.baud, name)
    return Uno(harness(), firmware, settings, now_ns, layout=LAYOUTS[name], **kwargs)


def new_trace() -> Path:
    """Return a new file for the trace of one Uno's pins."""
    number, name = tempfile.mkstemp(prefix="armrig-uno-", suffix=".vcd")
    os.close(number)
    return Path(name)


class Host:
    """Host at the other end of the Uno's line; it sends what the test orders."""

    def __init__(self, uno: Uno) -> None:
        self.uno = uno
        self.now = 0
        self.seq = 0
        self.heard: list[tuple[int, wire.Message]] = []
        """Messages that came, each with the time of its last byte."""
        self.spoilt = 0
        self.starts: list[int] = []
        """Times at which each START had arrived."""
        self._pending = b""

    def wait(self, ms: float) -> None:
        """Let time pass."""
        self.now += round(ms * MS)
        for t_ns, data in self.uno.advance(self.now):
            self._pending, received = decoder.feed(self._pending, data)
            for one in received:
                if isinstance(one, Spoilt | Unknown):
                    self.spoilt += 1
                else:
                    self.heard.append((t_ns, one))

    def say(self, kind: type[wire.Message], *fields: Any) -> int:
        """Send a frame; return when it will have arrived."""
        self.seq = (self.seq + 1) & 0xFFFF
        return self.put(encode(kind(0, self.seq, *fields)), starts=kind is wire.Start)

    def put(self, data: bytes, *, starts: bool = False) -> int:
        """Put bytes on the line; return when they will have arrived."""
        self.uno.receive(self.now, data)
        arrived_ns = self.now + self.uno.rx_backlog_ns(self.now)
        if starts:
            self.starts.append(arrived_ns)
        return arrived_ns

    def last(self, kind: type[wire.Message]) -> Any:
        """Return the newest message of a kind."""
        return next(m for _, m in reversed(self.heard) if isinstance(m, kind))

    def of(self, kind: type[wire.Message]) -> list[Any]:
        """Return all messages of a kind."""
        return [m for _, m in self.heard if isinstance(m, kind)]

    def hello(self) -> wire.HelloReply:
        """Shake hands, with a 00 first."""
        self.put(b"\0")
        self.say(wire.Hello, VERSION, SCHEMA_HASH)
        self.wait(5)
        reply: wire.HelloReply = self.last(wire.HelloReply)
        return reply

    def arm(self, **config: int) -> None:
        """Advance to ARMED, in exchange mode by default."""
        hello = self.hello()
        reply = self.configure(**config)
        self.say(wire.Arm, hello.boot_id, reply.config_crc, reply.nonce)
        self.wait(4)

    def configure(self, **config: int) -> wire.ConfigReply:
        """Send CONFIG and return its answer."""
        fields = {
            **{"ts_us": 2000, "u_min": 0, "u_max": 65535, "u_rest": 0, "slew": 0},
            **{"watchdog_ms": 100, "mode": int(Mode.EXCHANGE), "underrun": 0, "hold": 0},
            **{"oversampling": 1, "rail_ticks": 0, "turns": 0},
        } | config
        self.say(wire.Config, *fields.values())
        self.wait(5)
        reply: wire.ConfigReply = self.last(wire.ConfigReply)
        return reply

    def start(self, k_stop: int = 0, **config: int) -> None:
        """Come as far as RUN."""
        self.arm(**config)
        self.say(wire.Start, k_stop, self.last(wire.ConfigReply).nonce)
        self.wait(4)

    def drive(self, u: int, n: int, k: int = 1) -> int:
        """Exchange n samples with u; return when the last frame had arrived."""
        arrived_ns = 0
        for i in range(n):
            arrived_ns = self.say(wire.Exchange, k + i, u)
            self.wait(2)
        return arrived_ns


@contextmanager
def powered(seed: int = 1, baud: int = BAUD, **kwargs: Any) -> Iterator[Host]:
    """Switch an Uno on, wait until it has booted, and give its host; switch it off."""
    uno = switch_on(EmulatorSettings(seed=seed, baud=baud), 0, **kwargs)
    try:
        host = Host(uno)
        host.wait(BOOT_NS / MS)
        yield host
    finally:
        uno.close()


def high_from(uno: Uno, since_ns: int, until_ns: int) -> list[Duty]:
    """Return the high time of the pin in an interval; a period counts by its beginning."""
    ends = [d.cycle for d in uno.duties[1:]] + [uno.harness.cycle]
    return [
        duty
        for duty, end in zip(uno.duties, ends, strict=True)
        if duty.high and uno.ns(end) > since_ns and uno.ns(duty.cycle) < until_ns
    ]


def assert_low_outside_run(host: Host) -> None:
    """Check that the pin was low whenever the device reported another state than RUN."""
    uno = host.uno
    assert uno.violations == []
    for t_ns, message in host.heard:
        if message.state == State.RUN:
            continue
        left_ns = t_ns - wire_ns(len(encode(message)), 500_000)
        until_ns = min((t for t in host.starts if t > left_ns), default=1 << 62)
        assert high_from(uno, left_ns, until_ns) == [], message
