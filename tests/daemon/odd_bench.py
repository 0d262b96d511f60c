"""A virtual rig that is unlike those of other tests, and the story of a bad afternoon with it.

Nothing is at its default: slow wire, slow clock, narrow limits, wipers the other way, a driver with
an offset, friction. The host is late at times, and the line loses and spoils what goes over it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import msgspec
from armrig_core.rig.calibration import Calibration, Driver, Potentiometer
from armrig_core.telemetry.telemetry import Sample, decode_sample
from armrig_daemon.config import (
    ArmSettings,
    Config,
    DeviceTable,
    Limits,
    RecordingTable,
    RigIdentity,
    TimingTable,
)
from armrig_daemon.decisions.state import ServiceGone
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.pipe import Arm, Calibrate, Reset, Run, Set, Stop, Trace

from tests.daemon.virtual_bench import LEASE, MS, Bench, codes

EMULATOR: dict[str, Any] = {
    "seed": 11,
    "boot_ms": 30.0,
    "baud": 250_000,
    "conversion_us": 60.0,
    "clock_ppm": 150.0,
    "pwm_bits": 9,
    "adc_bits": 12,
    "adc_noise_v": 0.004,
    "theta_1_range_deg": 340.0,
    "theta_1_zero_deg": 300.0,
    "alpha_range_deg": 270.0,
    "alpha_zero_deg": 100.0,
    "theta_1_low_v": 0.2,
    "theta_1_high_v": 4.7,
    "theta_1_reversed": True,
    "alpha_low_v": 0.4,
    "alpha_high_v": 4.9,
    "alpha_reversed": True,
    "driver_gain": 0.9,
    "driver_offset_v": 0.15,
    "queue": 100,
    "coulomb_nm": 0.02,
    "stiffening": 40.0,
    "arm": {"J_1": 0.02, "b_1": 0.05},
}
CONFIG = Config(
    rig=RigIdentity(id="lab-2"),
    device=DeviceTable(baud=250_000, watchdog_ms=130),
    timing=TimingTable(Ts=0.008, stop_after=6),
    limits=Limits(u_min_v=0.2, u_max_v=4.4, slew_v=3.0, revolutions=2.5, alpha_rad=1.5),
    arm=ArmSettings(J_1=0.02, b_1=0.05),
    recording=RecordingTable(part_minutes=0.01),
    calibration=Calibration(
        theta_1=Potentiometer(zero_counts=9_000.0, rad_per_count=-9.6e-5),
        alpha=Potentiometer(zero_counts=41_000.0, rad_per_count=-7.6e-5, wraps=False),
        driver=Driver(gain=0.9, offset_v=0.15),
    ),
    emulator=EmulatorSettings(**EMULATOR),
)


def lines_of(records: list[Any], every: int, device: Any = None) -> Iterator[str]:
    """Give a line for each record, but for some samples only; numbers have six digits.

    `device` is the previous state's report of the device.
    """
    seen = 0
    for record in records:
        if isinstance(record, bytes):
            sample = decode_sample(record)
            seen += 1
            if sample is not None and seen % every == 1:
                yield f"  {_fields(sample)}"
        elif not isinstance(record, Trace):
            about = _fields(record).replace(str(device), "the same") if device else _fields(record)
            device = getattr(record, "device", None) or device
            yield f"  {type(record).__name__} {about}"


def _fields(value: Any) -> str:
    if isinstance(value, Sample):
        return "sample " + ", ".join(show(x) for x in value)
    named = msgspec.structs.asdict(value) if not is_dataclass(value) else _asdict(value)
    return ", ".join(f"{name}={show(x)}" for name, x in named.items() if x not in ("", {}, None))


def _asdict(value: Any) -> dict[str, Any]:
    return {field.name: getattr(value, field.name) for field in fields(value)}


def show(value: Any) -> str:
    """Return a value as text, numbers with six digits."""
    if isinstance(value, msgspec.Struct):
        return f"({_fields(value)})"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name}: {show(x)}" for name, x in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(show, value)) + "]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


class Faults:
    """Spoils, drops and doubles frames by their numbers."""

    def __init__(self, **faults: tuple[int, ...]) -> None:
        self._faults, self._n = faults, 0

    def __call__(self, data: bytes) -> bytes:
        """Return the bytes that the line delivers for a frame."""
        self._n += 1
        if self._n in self._faults.get("lost", ()):
            return b""
        if self._n in self._faults.get("spoilt", ()):
            return data[:3] + bytes([data[3] ^ 4]) + data[4:]
        return data * (2 if self._n in self._faults.get("doubled", ()) else 1)


class Afternoon:
    """The story: each step gives the records that the service received."""

    def __init__(self) -> None:
        self.bench = Bench(CONFIG, k=2**32 - 40, switched_on_ns=-2 * MS, **EMULATOR)
        self.lines: list[str] = []
        self._told = self._orders = 0
        self._device: Any = None

    def step(self, what: str, every: int = 40) -> None:
        """Note the records since the last step, under a name."""
        records = self.bench.records[self._told :]
        self._told = len(self.bench.records)
        self.lines += [f"# {what}", *lines_of(records, every, self._device)]
        self._device = next((r.device for r in records if getattr(r, "device", 0)), self._device)

    def ask(self, kind: type[Any], **fields: Any) -> None:
        """Give an order, and let 20 ms pass; its answer is among the records."""
        self._orders += 1
        self.bench.order(kind(order=self._orders, **fields))
        self.bench.run_for(20)


def afternoon() -> list[str]:
    """Return all records of a bad afternoon."""
    day = Afternoon()
    bench, line = day.bench, day.bench.ports
    day.step("it is plugged in")
    day.ask(Set, lease=LEASE, n=1, code=10_000)
    day.ask(Arm, owner="Ada", lease=LEASE, ts_us=5_001)
    day.ask(Arm, owner="Bob", lease="b" * 32, ts_us=0)
    bench.lateness_ns = 2_345_678
    for n, code in ((3, 20_000), (3, 20_000), (5, 58_000), (6, 58_000), (7, 2_000)):
        day.ask(Set, lease=LEASE, n=n, code=code)
    bench.lateness_ns = 0
    bench.run_for(150)
    day.step("driven by hand, too slowly", every=15)
    day.ask(Reset)
    day.ask(Arm, owner="Bob", lease="b" * 32, ts_us=0)
    line.to_device, line.from_device = Faults(lost=(9,), spoilt=(15,)), Faults(lost=(40, 41, 70))
    u = [0.2 + 0.7 * (k // 9 % 4) for k in range(130)]
    day.ask(Run, lease="b" * 32, n=1, run_id="r-1", codes=codes(*u), scheduled=True)
    bench.run_for(1300)
    day.step("a run that the device paces, over a bad line", every=24)
    day.ask(Calibrate, calibration=Calibration(driver=Driver(gain=1.1)))
    day.ask(Arm, owner="Eve", lease=LEASE, ts_us=20_000)
    line.to_device, line.from_device = Faults(doubled=(12,)), Faults(spoilt=(20,), lost=(33,))
    day.ask(Run, lease=LEASE, n=1, run_id="r-2", codes=codes(*u[:60]), scheduled=False)
    bench.run_for(500)
    bench.lateness_ns = 45_000_000
    bench.run_for(150)
    bench.lateness_ns = 0
    bench.run_for(900)
    day.step("a run that the host paces, late", every=24)
    line.from_device = Faults()
    day.ask(Reset)
    day.ask(Arm, owner="Eve", lease=LEASE, ts_us=0)
    day.ask(Run, lease=LEASE, n=1, run_id="r-3", codes=codes(*[3.0] * 400), scheduled=True)
    bench.run_for(250)
    day.ask(Stop, reason="stopped by Bob")
    bench.run_for(200)
    day.step("a run that somebody stops")
    day.ask(Arm, owner="Eve", lease=LEASE, ts_us=0)
    day.ask(Set, lease=LEASE, n=1, code=30_000)
    line.from_device = lambda data: b""
    bench.run_for(400)
    line.from_device = lambda data: data
    bench.run_for(100)
    day.step("the device falls silent")
    day.ask(Reset)
    day.ask(Arm, owner="Eve", lease=LEASE, ts_us=16_000)
    day.ask(Run, lease=LEASE, n=1, run_id="r-4", codes=codes(2.0, *[4.3] * 300), scheduled=True)
    bench.run_for(4000)
    day.step("a run in which the chassis turns too far", every=40)
    day.ask(Reset)
    day.ask(Arm, owner="Eve", lease=LEASE, ts_us=16_000)
    bench.run_for(900)
    day.ask(Run, lease=LEASE, n=1, run_id="r-5", codes=codes(4.3, 0.3), scheduled=True)
    day.step("an input that steps too far, of a rig that waited", every=40)
    day.ask(Reset)
    bench.ports.send(bench.ports.now, ServiceGone())
    bench.run_for(300)
    day.step("the service is gone")
    return day.lines
