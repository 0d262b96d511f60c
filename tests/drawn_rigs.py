"""Drawn rigs of one input and one or two outputs, and a judge that knows each rig's truth.

`python -m tests.drawn_rigs --seed 1 --count 100` prints the rigs judged wrong, and counts. Drawn
are unit, scale, offset and rest of the input, and the conversions of the sensors. Limits lie inside
and outside the range of a sensor, and a sensor may rest at an end. The judge computes voltages,
values and limits by itself.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import armrig
import numpy as np
from armrig_core.commands.commands import RunRequest
from armrig_core.errors import FileError, InputError, OperationError
from armrig_core.rig.description import Description, read_description
from armrig_daemon.config import Config, Limits, TimingTable
from armrig_daemon.emulator.device import Device
from armrig_daemon.service.virtual_service import LEASE, VirtualService
from msgspec.structs import replace
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import cont2discrete, dlsim

Vector = NDArray[np.float64]
FULL = 65536
EDGE = 64
"""Counts from each end of the range that are no reading."""
PWM_V = 5 / 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnOutput:
    """An output, and what is true of it."""

    name: str
    unit: str
    zero: float
    per_count: float
    rest: float
    """Value at rest, in the unit."""
    gain: float
    """Change by 1 V at the pin, in the unit."""
    valid_rail: str = ""
    low: float = -math.inf
    high: float = math.inf
    rail_is_outside: bool | None = None
    samples: int = 2

    def value(self, counts: float) -> float:
        """Return the value of a reading."""
        return (counts - self.zero) * self.per_count

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest value that is a reading."""
        first = 0 if self.valid_rail == "low" else EDGE
        last = FULL - 1 if self.valid_rail == "high" else FULL - 1 - EDGE
        low, high = sorted((self.value(first), self.value(last)))
        return low, high

    def stops_at_end(self, side: str) -> bool:
        """Return whether a reading at the end of the range is outside the limit before it."""
        ends = sorted((self.value(0), self.value(FULL - 1)))
        limit, end = (self.low, ends[0]) if side == "low" else (self.high, ends[1])
        if self.rail_is_outside is not None:
            return self.rail_is_outside
        return abs(limit - end) <= 0.05 * (ends[1] - ends[0])

    def faults(self) -> list[str]:
        """Return why the description of this output must be refused."""
        least, most = self.ends
        found = []
        if not self.low < self.high:
            found.append("limits")
        for side, limit, inside in (
            ("low", self.low, least < self.low),
            ("high", self.high, self.high < most),
        ):
            if math.isfinite(limit) and not inside and not self.stops_at_end(side):
                found.append(f"{side} is never reached")
        if self.low > max(self.value(0), self.value(FULL - 1)):
            found.append("always outside")
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnRig:
    """A rig, and what is true of it."""

    name: str
    unit: str
    per_volt: float
    offset: float
    rest_v: float
    u_max_v: float
    limit_v: float
    """`[limits] u_max_v` of the configuration, which may be wider than the description's."""
    tau: tuple[float, ...]
    """Time constants of all outputs, in s."""
    outputs: tuple[DrawnOutput, ...]
    modelled: bool
    """True if the description has the model, so that runs are rehearsed."""
    Ts: float
    seed: int

    def own(self, u: Any) -> Any:
        """Return the value of a voltage at the pin."""
        return self.per_volt * u + self.offset

    def text(self, *, model: bool) -> str:
        """Return the description."""
        lines = ['[rig]\nname = "drawn"\n[input]', f'name = "{self.name}"\nunit = "{self.unit}"']
        lines += [f"per_volt = {self.per_volt!r}\noffset = {self.offset!r}"]
        lines += [f"rest_v = {self.rest_v!r}\nu_max_v = {self.u_max_v!r}"]
        for o in self.outputs:
            lines += [f'[outputs.{o.name}]\nunit = "{o.unit}"\nzero_counts = {o.zero!r}']
            lines += [f"per_count = {o.per_count!r}\nsamples = {o.samples}"]
            lines += [f"low = {o.low!r}"] if math.isfinite(o.low) else []
            lines += [f"high = {o.high!r}"] if math.isfinite(o.high) else []
            lines += [f'valid_rail = "{o.valid_rail}"'] if o.valid_rail else []
            if o.rail_is_outside is not None:
                lines += [f"rail_is_outside = {str(o.rail_is_outside).lower()}"]
        if model:
            poles = [-1 / t for t in self.tau]
            n = len(poles)
            A = [[poles[i] if i == j else 0.0 for j in range(n)] for i in range(n)]
            for i in range(1, n):
                A[i][i - 1] = -poles[i]
            B = [[-poles[0]]] + [[0.0]] * (n - 1)
            C = [[0.0] * (n - 1) + [o.gain] for o in self.outputs]
            rest = [o.rest for o in self.outputs]
            lines += [f"[model]\nA = {A}\nB = {B}\nC = {C}\noffset = {rest}"]
        return "\n".join(lines) + "\n"

    def response(self, u: Vector) -> list[Vector]:
        """Return the outputs at the samples, without converter and noise."""
        n = len(self.tau)
        A = np.diag([-1 / t for t in self.tau])
        for i in range(1, n):
            A[i, i - 1] = 1 / self.tau[i]
        B = np.zeros((n, 1))
        B[0] = 1 / self.tau[0]
        C = np.zeros((1, n))
        C[0, -1] = 1
        system = cont2discrete((A, B, C, np.zeros((1, 1))), self.Ts)
        _, y, _ = dlsim(system, u - self.rest_v)
        return [o.rest + o.gain * y[:, 0] for o in self.outputs]


def drawn_rig(rng: Generator) -> DrawnRig:
    """Return a rig; one in four has a limit that is never reached, or another fault."""
    unit, per_volt = [
        ("%", 20.0),
        ("V", 2.0),
        ("V", 4.8),
        ("A", 0.35),
        ("rpm", -840.0),
        ("V", 1.0),
    ][rng.integers(6)]
    u_max_v = float(rng.choice([5.0, 5.0, 3.92]))
    rest_v = float(rng.choice([0.0, 0.0, 0.5, 0.25])) * u_max_v
    offset = float(rng.choice([0.0, 0.0, -per_volt * rest_v, 12.5]))
    tau = tuple(float(t) for t in rng.uniform(3, 15, rng.integers(1, 3)))
    Ts = float(rng.choice([0.01, 0.05, 0.5]))
    outputs = tuple(
        _drawn_output(rng, name, rest_v, u_max_v) for name in "pq"[: rng.integers(1, 3)]
    )
    return DrawnRig(
        name=str(rng.choice(["power", "drive", "valve"])),
        unit=unit,
        per_volt=per_volt,
        offset=offset,
        rest_v=rest_v,
        u_max_v=u_max_v,
        limit_v=float(rng.choice([u_max_v, 0.8 * u_max_v, 5.0])),
        tau=tuple(Ts * t for t in tau),
        outputs=outputs,
        modelled=bool(rng.random() < 0.5),
        Ts=Ts,
        seed=int(rng.integers(1 << 30)),
    )


def _drawn_output(rng: Generator, name: str, rest_v: float, u_max_v: float) -> DrawnOutput:
    per_count = float(rng.choice([1, -1]) * 10 ** rng.uniform(-5, 0))
    unit = str(rng.choice(["degC", "cm", "V", "mbar"]))
    # In counts: where the sensor rests, and how far the largest input moves it.
    at_end = rng.random() < 0.25
    end = str(rng.choice(["low", "high"])) if at_end else ""
    counts = {"low": 0.0, "high": FULL - 1.0, "": float(rng.uniform(0.3, 0.7)) * FULL}[end]
    reach = float(rng.uniform(0.4, 0.9) if rng.random() < 0.8 else 1.8)
    room = {"low": 1.0, "high": -1.0, "": float(rng.choice([1, -1])) * 0.3}[end] * FULL
    # At an end, the input may move the output only away from it.
    span = max(u_max_v - rest_v, rest_v) if not end else u_max_v - rest_v
    zero = float(rng.choice([0.0, 6553.6, FULL / 2]))
    rest, gain = (counts - zero) * per_count, reach * room * per_count / max(span, 0.5)
    drawn = DrawnOutput(
        name=name, unit=unit, zero=zero, per_count=per_count, rest=rest, gain=gain,
        valid_rail=end, samples=int(rng.choice([1, 2, 5])),
    )  # fmt: skip
    if reach > 1:
        # The output goes beyond the end of the sensor, and the limit is near this end.
        side, up = ("high", 1) if gain > 0 else ("low", -1)
        ends = sorted((drawn.value(0), drawn.value(FULL - 1)))
        limit = ends[up > 0] + up * 0.03 * (ends[1] - ends[0])
        moved = rest + gain * (u_max_v - rest_v)
        if u_max_v > rest_v and (moved - ends[up > 0]) * up > 0:
            return DrawnOutput(**{f: getattr(drawn, f) for f in drawn.__slots__} | {side: limit})
    if rng.random() < 0.5:
        return drawn
    # A limit on the side to which the largest input moves the output, or beyond the sensor.
    side = "high" if gain > 0 else "low"
    share = float(rng.choice([0.4, 0.7, 1.6, 3.0]))
    limit = rest + share * gain * (u_max_v - rest_v or -rest_v)
    if (limit > rest) != (side == "high"):
        return drawn
    outside: bool | None = [None, None, True][rng.integers(3)]
    limits = {side: limit, "rail_is_outside": outside}
    return DrawnOutput(**{f: getattr(drawn, f) for f in drawn.__slots__} | limits)


@dataclass(slots=True)
class Verdict:
    """Outcome of a rig in armrig, and each fault."""

    outcome: str = ""
    wrong: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    """Sure sentences that are false, as happens at the level that they print."""


def judged(rig: DrawnRig, folder: Path) -> Verdict:
    """Check, record and identify a rig; compare with its truth."""
    found = Verdict()
    path = folder / "drawn.toml"
    path.write_text(rig.text(model=True))
    faults = [f for o in rig.outputs for f in o.faults()]
    try:
        plant = read_description(path)
    except FileError as err:
        found.outcome = "refused by check"
        if not faults:
            found.wrong.append(f"refused a good description: {err}")
        return found
    if faults:
        found.wrong.append(f"accepted {faults}")
        return found
    described = plant if rig.modelled else Description.of(rig.text(model=False).encode())
    rng = np.random.default_rng(rig.seed)
    # A telegraph signal up to the description's range, one in three beyond [limits].
    top = min(rig.limit_v, rig.u_max_v)
    low = rig.rest_v if any(o.valid_rail for o in rig.outputs) else 0.2 * rig.rest_v
    high = top if rng.random() < 0.7 else rig.u_max_v
    levels = rng.random(400) < 0.1
    u = np.where(np.cumsum(levels) % 2 == 0, high, low)
    allowed = high <= top + 1e-9
    try:
        config = Config(timing=TimingTable(Ts=rig.Ts), limits=Limits(u_max_v=rig.limit_v))
        config.check_limits(plant, {"u_max_v": "drawn"})
    except InputError:
        found.outcome = "limit wider than the rig's refused"
        if rig.limit_v <= rig.u_max_v and rig.rest_v <= rig.limit_v:
            found.wrong.append("refused a narrower limit")
        return found
    if rig.limit_v > rig.u_max_v or rig.rest_v > rig.limit_v:
        found.wrong.append(f"accepted [limits] u_max_v = {rig.limit_v}")
        return found
    config = replace(config, emulator=replace(config.emulator, adc_noise_v=0.0))
    service = VirtualService(
        config, folder, seed=rig.seed % 1000, description=described,
        switch_on=partial(Device, description=plant),
    )  # fmt: skip
    expected = stopped(rig, u)
    try:
        file = service.record(RunRequest(lease=LEASE, n=1, u=u.tolist(), experiment="drawn"))
    except (OperationError, InputError) as err:
        found.outcome = "stopped or refused in time"
        if allowed and expected is False:
            found.wrong.append(f"stopped a good run: {err}")
        return found
    if not allowed:
        found.wrong.append(f"played {high} V, {top} V are allowed")
    if expected:
        found.wrong.append("an output left its limits, and the run is complete")
    found.outcome = "identified"
    _judge_recording(rig, u, armrig.load(file), found)
    return found


def stopped(rig: DrawnRig, u: Vector) -> bool | None:
    """Return whether a limit must stop the run; None if it is too near."""
    unsure = False
    for o, y in zip(rig.outputs, rig.response(u), strict=True):
        least, most = o.ends
        margin = 3e-3 * (most - least)
        outside = np.zeros(y.size)
        for side, limit, sign in (("low", o.low, -1), ("high", o.high, 1)):
            if not math.isfinite(limit):
                continue
            by_value = sign * (np.clip(y, least, most) - limit)
            end = least if sign < 0 else most
            if o.stops_at_end(side):
                by_end = sign * (y - end)
                by_value = np.maximum(by_value, by_end)
            unsure |= bool(np.any(np.abs(by_value) < margin))
            outside = np.where(by_value > margin, 1.0, outside)
        runs = np.convolve(outside, np.ones(o.samples))[: y.size]
        if np.any(runs >= o.samples):
            return True
        # Beyond the sensor's end there is no value: with a limit the run stops when it is blind.
        blind = (y < least) | (y > most)
        if (math.isfinite(o.low) or math.isfinite(o.high)) and np.any(blind):
            unsure = True
    return None if unsure else False


def _judge_recording(rig: DrawnRig, u: Vector, rec: armrig.Recording, found: Verdict) -> None:
    """Compare name, unit and value of the input, and the gain of each channel, with the truth."""
    for o in rig.outputs:
        data = rec.dataset(o.name)
        if (data.input, data.input_unit) != (rig.name, rig.unit):
            found.wrong.append(f"the input is {data.input} in {data.input_unit}")
        size = abs(rig.per_volt) * PWM_V
        if not np.allclose(data.u, rig.own(u)[: data.N], atol=0.51 * size):
            found.wrong.append(
                f"{rig.name} is {data.u[:3]} in place of {rig.own(u)[:3]} {rig.unit}"
            )
        before = rec.samples[rec.samples["flags"] & 1 == 0]
        if before.size and abs(before["u_applied_v"] - rig.rest_v).max() > 1e-3:
            found.wrong.append("samples outside RUN do not show the rest")
        if not data.valid.all():
            found.outcome = "without a value at an end"
            continue
        n = len(rig.tau)
        fit = armrig.oe(data, nb=n, nf=n, offset=True)
        gain = float(np.sum(fit.B) / np.sum(fit.F))
        true = o.gain / rig.per_volt
        if abs(gain / true - 1) > 0.02:
            found.wrong.append(f"gain {gain:.4g} in place of {true:.4g} {o.unit}/{rig.unit}")
        if f"{rig.name} [{rig.unit}] to {o.name} [{o.unit}]" not in str(fit):
            found.wrong.append(f"the model says {str(fit).splitlines()[0]}")


def run(seed: int, i: int) -> tuple[DrawnRig, Verdict]:
    """Draw and judge case i of a seed."""
    rig = drawn_rig(np.random.default_rng([seed, i]))
    with tempfile.TemporaryDirectory() as folder:
        return rig, judged(rig, Path(folder))


def main() -> None:
    """Print the wrong cases, the outcomes and the processor time."""
    parser = argparse.ArgumentParser(prog="python -m tests.drawn_rigs", description=__doc__)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=100)
    asked = parser.parse_args()
    outcomes: Counter[str] = Counter()
    wrong = 0
    for i in range(asked.count):
        rig, found = run(asked.seed, i)
        outcomes[found.outcome] += 1
        wrong += bool(found.wrong)
        for text in found.wrong:
            print(f"case {i}: {text}\n  {rig}")
    print(f"{wrong} of {asked.count} wrong; {dict(outcomes)}; {time.process_time():.0f} s")


if __name__ == "__main__":
    main()
