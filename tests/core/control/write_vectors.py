"""Write vectors.json, the golden vectors of the evaluation of control laws.

The vectors follow from the equations of a law, without any code of armrig. Every value is computed
from the beginning of the run again: x[k] by k steps from x0. The sums are ordered: from 0, products
are added from left to right. Run `python -m tests.core.control.write_vectors`.
"""

from __future__ import annotations

import json
import random
from fractions import Fraction
from math import floor, isfinite, pi
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


class Definition:
    """The equations of a law in a run."""

    def __init__(self, law: dict[str, Any], rig: dict[str, Any], r: list[float]) -> None:
        self.law, self.rig, self.r = law, rig, r
        self.codes: dict[int, int] = {}
        self.samples: Samples = {}
        self.limited = 0

    def code(self, k: int) -> int:
        """Return u[k]: rest before the run, and after the law has ended it."""
        return self.codes.get(k, int(self.rig["rest_code"]))

    def course(self, end: int) -> dict[str, Any]:
        """Return x[end], and Δy and the counts before it."""
        law = self.law
        x, y = list(law["x0"]), [0.0] * len(law["y0"])
        zeros: list[Value] = [None] * len(y)
        blind = astray = 0
        for k in range(end):
            values = self.samples.get(k)
            if law["F"] is not None:
                y = [ordered_sum(row, x) for row in law["F"]]
            is_blind = True
            for i, channel in enumerate(law["channels"]):
                value = None if values is None else values[channel]
                if value is None:
                    continue
                is_blind = False
                if not law["turning"][i]:
                    y[i] = value - law["y0"][i]
                    continue
                zero = zeros[i]
                if zero is None:
                    zero = zeros[i] = value - y[i]
                angle = value - zero
                y[i] = angle + 2 * pi * round((y[i] - angle) / (2 * pi))
            late = self.code(k - law["input_delay"])
            w = [self.r[k], latched_volts(late, self.rig["pwm_bits"]) - law["u0"], *y]
            x = [ordered_sum([*a, *b], [*x, *w]) for a, b in zip(law["A"], law["B"], strict=True)]
            blind = blind + 1 if is_blind else 0
            if law["tracked"] is not None:
                error = self.r[k] - ordered_sum(law["tracked"], [*x, *y, 1.0])
                astray = astray + 1 if abs(error) > law["most_error"] else 0
        return {"x": x, "y": y, "zeros": zeros, "blind": blind, "astray": astray}

    def decide(self, k: int) -> dict[str, Any]:
        """Return the code for sample k, with how it came about."""
        law, rig = self.law, self.rig
        for skipped in range(k):  # the device holds the code before
            self.codes.setdefault(skipped, self.code(skipped - 1))
        newest = max(self.samples, default=-1)  # sample that the law has
        x = self.course(k)["x"]
        v = ordered_sum([*law["C"], law["D"]], [*x, self.r[k]]) + law["u0"]
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
                events.append({"observe": at, "values": values})
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
    return made


def text() -> str:
    """Return the vectors, a line for each case."""
    return "[\n" + ",\n".join(json.dumps(one, allow_nan=False) for one in vectors()) + "\n]\n"


if __name__ == "__main__":
    VECTORS.write_text(text())
