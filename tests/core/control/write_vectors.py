"""Write vectors.json, the golden vectors of the evaluation of control laws.

The vectors follow from the equations of a law, without any code of armrig. Every value is computed
from the beginning of the run again: x[k] by k steps from x0. The sums are ordered: from 0, products
are added from left to right. Run `python -m tests.core.control.write_vectors`.
"""

from __future__ import annotations

import json
import random
from fractions import Fraction
from math import floor, isfinite, isnan, pi
from pathlib import Path
from typing import Any

VECTORS = Path(__file__).with_name("vectors.json")
Value = float | None
Samples = dict[int, list[Value]]


def ordered_sum(row: list[float], z: list[float]) -> float:
    total = 0.0
    for i in range(len(row)):
        total = total + row[i] * z[i]
    return total


def latched_volts(code: int, bits: int) -> float:
    """Return the voltage of the nearest code that the duty of a PWM can have."""
    duty = floor(Fraction(code * 2**bits, 65535) + Fraction(1, 2))
    applied = floor(Fraction(duty * 65535, 2**bits) + Fraction(1, 2))
    return applied / 65535 * 5.0


class Monitored:
    """The equations of a monitor in a run."""

    def __init__(self, monitor: dict[str, Any]) -> None:
        self.monitor = monitor
        ny = len(monitor["C"])
        self.x, self.free = monitor["x0"], monitor["x0"]  # with the gains L, and without them
        self.zeros: list[Value] = [None] * ny
        self.simulated = [self.outputs(self.free)]
        self.counts = {"innovation": [0] * ny, "simulation": [0] * ny}
        self.missing, self.seen = [0] * ny, self.outputs(self.x)

    def outputs(self, x: list[float]) -> list[float]:
        return [ordered_sum(row, x) for row in self.monitor["C"]]

    def predictions(self) -> list[float]:
        pairs = zip(self.outputs(self.x), self.zeros, strict=True)
        return [y if zero is None else y + zero for y, zero in pairs]

    def next(self, x: list[float], volts: float, e: list[float]) -> list[float]:
        m = self.monitor
        sides = zip(m["A"], m["B"], m["L"], strict=True)
        return [ordered_sum([*a, b, *row], [*x, volts - m["u0"], *e]) for a, b, row in sides]

    def take(self, y: list[float], valid: list[bool], volts: float) -> None:
        expected, free = self.outputs(self.x), self.outputs(self.free)
        if any(self.monitor["settling"]):
            self.simulated.append(free)
        e = [0.0] * len(y)
        for i in range(len(y)):
            self.missing[i] = 0 if valid[i] else self.missing[i] + 1
            if not valid[i]:
                continue
            self.seen[i] = y[i]
            zero = self.zeros[i]
            if zero is None:
                zero = self.zeros[i] = y[i] - expected[i]
            e[i] = y[i] - zero - expected[i]
            six = 6 * self.monitor["deviations"][i]
            self.count("innovation", i, abs(e[i]) <= six)
            if self.monitor["settling"][i]:
                low, high = self.range_of(i)
                within = max(six, 0.25 * (high - low)) if isfinite(high - low) else six
                within += abs(zero) if abs(zero) > six else 0.0
                self.count("simulation", i, abs(y[i] - zero - free[i]) <= within)
        self.x = self.next(self.x, volts, e)
        if any(self.monitor["settling"]):
            self.free = self.next(self.free, volts, [0.0] * len(y))

    def count(self, gate: str, i: int, is_within: bool) -> None:
        self.counts[gate][i] = 0 if is_within else self.counts[gate][i] + 1

    def range_of(self, i: int) -> tuple[float, float]:
        numbers = [y[i] for y in self.simulated if not isnan(y[i])]
        return min(numbers), max(numbers)

    def alarm(self) -> list[Any] | None:
        """Return the first gate that has tripped, and the number of its output."""
        for gate, counts in self.counts.items():
            for i, count in enumerate(counts):
                if count >= 5:
                    return [gate, i]
        return None

    def lost(self) -> str:
        """Return the first output that has had no valid value for too long."""
        for i, now in enumerate(self.predictions()):
            turn = self.monitor["most_turned"][i]
            n, turned = self.missing[i], abs(now - self.seen[i])
            too_long = n >= self.monitor["most_blind"]
            if n and (too_long if turn is None else turned * (n - 2) > turn * n):
                return ("first", "second")[i]
        return ""

    def state(self) -> dict[str, Any]:
        ranges = [self.range_of(i) for i in range(len(self.zeros))]
        numbers = {"x": self.x, "simulated": self.free}
        numbers |= {"low": [low for low, _ in ranges], "high": [high for _, high in ranges]}
        texts = {key: [repr(float(x)) for x in row] for key, row in numbers.items()}
        return {
            **texts,
            "zeros": self.zeros,
            **self.counts,
            "alarm": self.alarm(),
            "lost": self.lost(),
        }


class Definition:
    """The equations of a law in a run."""

    def __init__(self, law: dict[str, Any], rig: dict[str, Any], r: list[float]) -> None:
        self.law, self.rig, self.r = law, rig, r
        self.codes: dict[int, int] = {}
        self.samples: Samples = {}
        self.limited = 0
        self.monitor = law.get("monitor")
        self.prelude = self.monitor["prelude"] if self.monitor else 0

    def code(self, k: int) -> int:
        """Return u[k]: rest before the run, and after the law has ended it."""
        return self.codes.get(k, int(self.rig["rest_code"]))

    def course(self, end: int) -> dict[str, Any]:
        """Return x[end], and Δy and the counts before it."""
        law = self.law
        x, y = list(law["x0"]), [0.0] * len(law["y0"])
        zeros: list[Value] = [None] * len(y)
        blind = astray = 0
        monitored = Monitored(self.monitor) if self.monitor else None
        for k in range(end):
            values = self.samples.get(k)
            if law["F"] is not None:
                y = [ordered_sum(row, x) for row in law["F"]]
            elif monitored:
                y = monitored.predictions()
            valid = [False] * len(y)
            for i, channel in enumerate(law["channels"]):
                value = None if values is None else values[channel]
                if value is None:
                    continue
                valid[i] = True
                if not law["turning"][i]:
                    y[i] = value - law["y0"][i]
                    continue
                zero = zeros[i]
                if zero is None:
                    zero = zeros[i] = value - y[i]
                angle = value - zero
                y[i] = angle + 2 * pi * round((y[i] - angle) / (2 * pi))
            w = [self.r[k], self.volts(k - law["input_delay"]) - law["u0"], *y]
            x = [ordered_sum([*a, *b], [*x, *w]) for a, b in zip(law["A"], law["B"], strict=True)]
            if monitored:
                monitored.take(y, valid, self.volts(k - self.monitor["input_delay"]))
            blind = 0 if any(valid) else blind + 1
            if law["tracked"] is not None and k >= self.prelude:
                error = self.r[k] - ordered_sum(law["tracked"], [*x, *y, 1.0])
                astray = astray + 1 if abs(error) > law["most_error"] else 0
        state = {"x": x, "y": y, "zeros": zeros, "blind": blind, "astray": astray}
        return state | ({"monitor": monitored.state()} if monitored else {})

    def alarm(self, k: int) -> dict[str, Any]:
        """Return the alarm after sample k, under a law with a monitor."""
        return {"alarm": self.course(k + 1)["monitor"]["alarm"]} if self.monitor else {}

    def volts(self, k: int) -> float:
        """Return the voltage of sample k at the pin."""
        return latched_volts(self.code(k), self.rig["pwm_bits"])

    def decide(self, k: int) -> dict[str, Any]:
        """Return the code for sample k, with how it came about."""
        law, rig = self.law, self.rig
        for skipped in range(k):  # the device holds the code before
            self.codes.setdefault(skipped, self.code(skipped - 1))
        newest = max(self.samples, default=-1)  # sample that the law has
        x = self.course(k)["x"]
        v = ordered_sum([*law["C"], law["D"]], [*x, self.r[k]]) + law["u0"]
        if k < self.prelude:
            v = self.monitor["forward"][0] * self.r[k] + self.monitor["forward"][1]
        low = max(law["lo_code"], rig["code_min"])
        high = min(law["hi_code"], rig["code_max"])
        if not isfinite(v):
            flags = [False, False, False]
            predicted = k - newest - 1
            return {"v": None, "code": rig["rest_code"], "flags": flags, "predicted": predicted}
        nearest = round(min(max(v * 13107.0, -1.0), 65536.0))
        code = min(max(nearest, low), high)
        slew = min((most for most in (law["slew"], rig["slew"]) if most), default=65536)
        held = [self.code(j) for j in range(newest, k)]
        within = min(max(code, max(held) - slew), min(held) + slew)
        self.codes[k] = within
        self.limited = self.limited + 1 if code != nearest else 0
        return {
            "v": v,
            "code": within,
            "flags": [nearest < low, nearest > high, within != code],
            "predicted": k - newest - 1,
        }


def drawn_law(rng: random.Random, order: int, ny: int, **changes: Any) -> dict[str, Any]:
    def row(n: int, size: float = 1.0) -> list[float]:
        return [round(rng.uniform(-size, size), 3) for _ in range(n)]

    return {
        "A": [row(order, 1.2 / max(order, 1)) for _ in range(order)],
        "B": [row(2 + ny, 0.5) for _ in range(order)],
        "C": row(order, 0.8),
        "D": round(rng.uniform(-0.5, 0.5), 3),
        "F": [row(order) for _ in range(ny)],
        "x0": row(order),
        "u0": 2.0,
        "channels": [*range(ny)],
        "y0": row(ny),
        "turning": [False] * ny,
        "lo_code": 0,
        "hi_code": 65535,
        "slew": 0,
        "input_delay": 0,
        "tracked": None,
        "most_error": 0.0,
        **changes,
    }


def drawn_monitor(rng: random.Random, order: int, ny: int, **changes: Any) -> dict[str, Any]:
    def row(n: int, size: float) -> list[float]:
        return [round(rng.uniform(-size, size), 3) for _ in range(n)]

    return {
        "A": [row(order, 1.0 / order) for _ in range(order)],
        "B": row(order, 0.3),
        "C": [row(order, 1.0) for _ in range(ny)],
        "L": [row(ny, 0.3) for _ in range(order)],
        "x0": row(order, 0.5),
        "u0": 1.5,
        "deviations": [0.1] * ny,
        "settling": [True] * ny,
        "input_delay": 0,
        "prelude": 0,
        "forward": [0.4, 0.7],
        "most_blind": 3,
        "most_turned": [None] * ny,
        **changes,
    }


def case(rng: random.Random, name: str, law: dict[str, Any], **rig: Any) -> dict[str, Any]:
    """Return a run: for each tick what arrives, and what follows from it."""
    rig = {"rest_code": 0, "pwm_bits": 16, "code_min": 0, "code_max": 65535, "slew": 0, **rig}
    r = [round(rng.uniform(0.0, 5.0), 3) for _ in range(24 if "gaps" in name else 12)]
    run, gaps, angle = Definition(law, rig, r), "gaps" in name, 0.0
    events: list[dict[str, Any]] = []
    waiting: Samples = {}
    for k in range(len(r)):
        angle += rng.uniform(-0.5, 2.5)
        if gaps and rng.random() < 0.15:
            continue  # a tick was skipped: the device takes no sample
        events.append({"decide": k, **run.decide(k)})
        values: list[Value] = [round(angle % (2 * pi), 3), round(rng.uniform(-1.0, 1.0), 3)]
        waiting[k] = [None if gaps and rng.random() < 0.3 else value for value in values]
        if gaps and rng.random() < 0.4:
            continue  # the sample is late, or lost
        for at, values in waiting.items():
            if at == k or rng.random() < 0.8:
                run.samples[at] = values
                events.append({"observe": at, "values": values} | run.alarm(at))
        waiting = {}
        if "v" in events[-2] and events[-2]["v"] is None:
            break  # the law has ended the run, and the device holds rest
    end = {"k": max(run.samples) + 1, **run.course(max(run.samples) + 1), "limited": run.limited}
    return {"name": name, "law": law, "rig": rig, "reference": r, "events": events, "end": end}


def vectors() -> list[dict[str, Any]]:
    rng = random.Random(89)
    turning = {"turning": [True, False], "y0": [0.0, 0.1]}
    tracked = [0.3] * 5 + [0.1, -0.1, 0.5]
    made = [case(rng, f"order {n}", drawn_law(rng, n, 1 + n % 2), pwm_bits=10) for n in range(9)]
    others: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
        "gaps": ({}, {}),
        "gaps without F": ({"F": None}, {}),
        "a turn, with gaps": (turning, {}),
        "a dead time": ({"input_delay": 3}, {"rest_code": 9000}),
        "a dead time with gaps": ({"input_delay": 2, "u0": 2.5}, {"rest_code": 30000}),
        "slew with gaps": ({"slew": 5000}, {"slew": 4000, "rest_code": 20000}),
        "the slew of the rig": ({}, {"slew": 7000}),
        "saturation": (
            {"lo_code": 13107, "hi_code": 39321, "u0": 0.9},
            {"code_min": 16000, "code_max": 30000},
        ),
        "a PWM of 8 bits": ({"input_delay": 1}, {"pwm_bits": 8}),
        "tracking with gaps": ({"tracked": tracked, "most_error": 0.4}, {}),
        "channels in the other order": ({"channels": [1, 0]}, {}),
        "overflow": ({"C": [1e308] * 5}, {"rest_code": 100}),
    }
    for name, (changes, rig) in others.items():
        made.append(case(rng, name, drawn_law(rng, 5, 2, **changes), **rig))
    no_F = {"F": None, **turning}
    newest = {"A": [[1.0]], "B": [0.0], "C": [[1.0], [0.0]], "L": [[1.0, 0.0]], "x0": [0.0]}
    gates: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any]]] = {
        "monitored": ({}, {}, {"pwm_bits": 10}),
        "monitored, with gaps": ({}, {}, {}),
        "monitored, without F, with gaps": ({"F": None}, {"deviations": [0.5, 0.1]}, {}),
        "monitored turns, with gaps": (
            no_F,
            {"deviations": [0.3, 0.2], "most_turned": [2.0, None]},
            {},
        ),
        "monitored, nothing settles": ({}, {"settling": [False, False]}, {}),
        "monitored, one settles, with gaps": ({}, {"settling": [False, True]}, {}),
        "innovations of the second output": ({}, {"deviations": [9.0, 0.001]}, {}),
        "a simulation that stays": (no_F, {**newest, "deviations": [0.5, 9.0]}, {}),
        "a wide range": ({}, {"B": [2.0] * 4, "deviations": [0.01, 9.0]}, {}),
        "dead times with gaps": ({"input_delay": 1}, {"input_delay": 4}, {"rest_code": 9000}),
        "a dead time of the law alone": ({"input_delay": 3}, {}, {"rest_code": 9000}),
        "prelude": (
            {"tracked": tracked[2:], "most_error": 0.1, "lo_code": 9000},
            {"prelude": 7, "forward": [1.1, -0.3]},
            {"code_max": 40000},
        ),
        "prelude, with gaps and a slew": (
            {"slew": 6000},
            {"prelude": 11, "forward": [-0.7, 3.1]},
            {"slew": 5000, "rest_code": 20000},
        ),
        "a prelude to the end": ({}, {"prelude": 50}, {}),
        "a monitor that overflows": ({}, {"A": [[1e160] * 4] * 4, "x0": [1.0] * 4}, {}),
        "a simulation that overflows": (
            {},
            {"A": [[1e200]], "B": [0.0], "C": [[1.0]] * 2, "L": [[1e200, 0.0]], "x0": [1e-200]},
            {},
        ),
    }
    for name, (changes, of_monitor, rig) in gates.items():
        monitor = drawn_monitor(rng, len(of_monitor.get("A", "abcd")), 2, **of_monitor)
        made.append(case(rng, name, drawn_law(rng, 3, 2, monitor=monitor, **changes), **rig))
    return made


def text() -> str:
    """Return the vectors, a line for each case."""
    return "[\n" + ",\n".join(json.dumps(one, allow_nan=False) for one in vectors()) + "\n]\n"


if __name__ == "__main__":
    VECTORS.write_text(text())
